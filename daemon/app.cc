#include "daemon/app.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <cstdlib>
#include <set>
#include <utility>

#include "core/base/parallel_for.h"
#include "core/session/session_reader.h"

namespace omnihdr {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr std::size_t kMaxListeners = 4;
constexpr std::size_t kListenerQueue = 1024;
constexpr auto kApiDeadline = seconds(2);
// Triggers handled before the loop looks after everything else again.
constexpr int kTriggersAtOnce = 64;
// The longest honest piece of work of each stage; beyond that it counts as stuck.
constexpr auto kCameraPatience = seconds(30);
constexpr auto kRecorderPatience = seconds(60);
constexpr auto kPipelinePatience = seconds(600);
// How long a stopping daemon waits for the pipeline's current step before it leaves: all state is
// on disk, so leaving costs no more than a step done again.
constexpr auto kPipelineGrace = seconds(30);
constexpr auto kViewsFirstRetry = seconds(1);
constexpr auto kViewsLongestRetry = seconds(30);

CaptureOptions MakeCaptureOptions(const DaemonConfig& config, const CameraInfo& info) {
  CaptureOptions options;
  options.frame_timeout = Nanoseconds(std::llround(config.camera.frame_timeout_s * 1e9));
  options.tolerance.relative = config.camera.exposure_tolerance;
  options.tolerance.quantum_s = info.exposure_quantum_s;
  return options;
}

RecorderOptions MakeRecorderOptions(const RecorderConfig& config) {
  RecorderOptions options;
  options.buffers = static_cast<std::size_t>(std::max(config.queue_frames, 1));
  options.png_compression = config.png_compression;
  return options;
}

// What is different between the camera of the session and the one found; empty when frames of both
// can be in one journal.
std::string Difference(const CameraDescription& session, const CameraDescription& camera) {
  if (session.layout != camera.layout || session.width != camera.width ||
      session.height != camera.height || session.bits != camera.bits ||
      session.projection != camera.projection || session.bayer != camera.bayer ||
      std::abs(session.z_min - camera.z_min) > 1e-6 ||
      std::abs(session.z_max - camera.z_max) > 1e-6) {
    return fmt::format(
        "the session has frames of {}x{} ({}, {} bits), the camera delivers {}x{} "
        "({}, {} bits) or another projection",
        session.width, session.height, ToString(session.layout), session.bits, camera.width,
        camera.height, ToString(camera.layout), camera.bits);
  }
  if (session.model != camera.model || session.serial != camera.serial) {
    return fmt::format("the session was begun with camera {} {}, found {} {}", session.model,
                       session.serial, camera.model, camera.serial);
  }
  return {};
}

// The lowest priority for the calling thread and, as they inherit it, the workers it starts.
void LowerPriority() { ::setpriority(PRIO_PROCESS, static_cast<id_t>(::syscall(SYS_gettid)), 19); }

void Rest(std::stop_token stop, Nanoseconds time) {
  std::mutex mutex;
  std::condition_variable_any never;
  std::unique_lock lock(mutex);
  never.wait_for(lock, stop, time, [] { return false; });
}

}  // namespace

BracketOptions MakeBracketOptions(const BracketConfig& config) {
  BracketOptions options;
  options.order = config.order;
  options.exposures = config.Exposures();
  options.gain = GainDb{config.gain_db};
  options.frames_per_position = config.frames_per_position;
  return options;
}

App::App(DaemonConfig config, SessionChoice choice, MakeParts make_parts)
    : config_(std::move(config)),
      choice_(std::move(choice)),
      make_parts_(std::move(make_parts)),
      hub_(kMaxListeners, kListenerQueue),
      state_([this](const StateReport& report) { OnStateChanged(report); }),
      recorder_(MakeRecorderOptions(config_.recorder),
                RecorderEvents{
                    .journaled = [this](const FrameRecord& record) { OnJournaled(record); },
                    .storage_failed =
                        [this](const Error& error) {
                          if (const auto count = storage_log_.Pass(clock_.Now())) {
                            spdlog::error("storage: {} ({} times)", error.message, *count);
                          }
                          state_.Update([&](CaptureConditions& c) { c.storage = error.message; });
                        },
                    .storage_recovered =
                        [this] {
                          spdlog::info("storage: frames are stored again");
                          state_.Update([](CaptureConditions& c) { c.storage.clear(); });
                        }}) {}

App::~App() = default;

Status App::Run() {
  SetWorkerCount(config_.pipeline.workers);
  if (choice_.exists) OMNIHDR_TRY(ResumeSession());
  PartsContext context;
  context.first_trigger = journaled_;
  context.room = [this] { return recorder_.free_buffers() > 0; };
  OMNIHDR_ASSIGN(parts_, make_parts_(context));
  OMNIHDR_TRY(StartLoop());
  ApiServerOptions api;
  api.socket = config_.api.socket;
  api.socket_mode = config_.api.socket_mode;
  OMNIHDR_ASSIGN(api_, ApiServer::Listen(api, *this, hub_));
  StartStages();
  state_.Update([](CaptureConditions& c) {
    c.started = true;
    c.waiting = "opening the camera";
  });
  notifier_.Ready();
  spdlog::info("omnihdrd {} serves on {}", OMNIHDR_VERSION, config_.api.socket);
  if (Status ran = loop_->Run(); !ran && outcome_) outcome_ = std::move(ran);
  return TearDown();
}

Status App::ResumeSession() {
  OMNIHDR_ASSIGN(SessionWriter writer, SessionWriter::Resume(choice_.directory));
  OMNIHDR_ASSIGN(const SessionContents contents, ReadSession(choice_.directory));
  for (const std::string& warning : writer.warnings()) spdlog::warn("{}", warning);
  std::set<std::int64_t> with_pixels;
  for (const FrameRecord& record : contents.journal.frames) {
    lines_.Add(record.status);
    if (record.status == FrameStatus::kOk) with_pixels.insert(Value(record.position));
  }
  journaled_ = writer.next_frame();
  positions_with_pixels_ = with_pixels.size();
  if (!with_pixels.empty()) last_position_with_pixels_ = *with_pixels.rbegin();
  auto session = std::make_shared<Session>(std::move(writer));
  session->directory = choice_.directory;
  session->info = contents.info;
  session->resumed = true;
  session_ = std::move(session);
  spdlog::info("session {}: continued after {} triggers{}", choice_.directory.string(), journaled_,
               choice_.ended ? "; it has ended" : "");
  if (choice_.ended) {
    phase_ = Phase::kEnded;
    ended_ = true;
    end_reason_ = "the session has ended";
    finish_views_ = true;
    state_.Update([&](CaptureConditions& c) { c.idle = end_reason_; });
  }
  return {};
}

Status App::StartLoop() {
  OMNIHDR_ASSIGN(loop_, EventLoop::Create());
  OMNIHDR_TRY(loop_->OnTermination([this](int signal) { OnSignal(signal); }));
  OMNIHDR_ASSIGN(trigger_timer_, loop_->AddTimer([this] { OnTriggersReady(); }));
  OMNIHDR_ASSIGN(capture_timer_, loop_->AddTimer([this] {
    if (CaptureController* capture = controller()) capture->OnTime();
    ScheduleCaptureTimer();
  }));
  OMNIHDR_ASSIGN(drain_timer_, loop_->AddTimer([this] { CheckDrained(); }));
  OMNIHDR_ASSIGN(supervise_timer_, loop_->AddTimer([this] { Supervise(); }));
  if (const auto interval = notifier_.WatchdogInterval()) {
    supervise_interval_ = std::min(supervise_interval_, *interval / 2);
  }
  supervise_timer_->Set(clock_.Now() + supervise_interval_);
  return {};
}

void App::StartStages() {
  CameraRunnerOptions options;
  options.longest_retry = Nanoseconds(std::llround(config_.camera.reconnect_s * 1e9));
  options.first_retry = std::min(options.first_retry, options.longest_retry);
  runner_ = std::make_unique<CameraRunner>(
      *parts_.camera, options,
      CameraRunnerEvents{.opened = [this](const CameraInfo& info) { return OnCameraOpened(info); },
                         .started =
                             [this] {
                               PostOrLog([this] {
                                 spdlog::info("camera: ready");
                                 state_.Update([](CaptureConditions& c) {
                                   c.camera_ready = true;
                                   c.fault.clear();
                                 });
                                 StartSource();
                               });
                             },
                         .frame =
                             [this](CameraFrame frame) {
                               if (CaptureController* capture = controller())
                                 capture->OnFrame(std::move(frame));
                             },
                         .away = [this](const Error& error) { OnCameraAway(error); }},
      clock_);
  if (session()) StartSessionStages();
  camera_stage_ = std::make_unique<Stage>(
      "camera", [this](std::stop_token stop, Stage& self) { return RunCamera(stop, self); });
  supervisor_.Watch(
      "camera", [this] { return camera_stage_->progress(); }, kCameraPatience, clock_.Now());
  if (config_.trigger.armed_at_start && phase_ == Phase::kRunning) {
    PostOrLog([this] { ArmNow(); });
  }
}

void App::StartSessionStages() {
  pipeline_stage_ = std::make_unique<Stage>(
      "pipeline", [this](std::stop_token stop, Stage& self) { return RunPipeline(stop, self); });
  recorder_stage_ = std::make_unique<Stage>(
      "recorder", [this](std::stop_token stop, Stage& self) { return RunRecorder(stop, self); });
  supervisor_.Watch(
      "recorder", [this] { return recorder_stage_->progress(); }, kRecorderPatience, clock_.Now());
  supervisor_.Watch(
      "pipeline", [this] { return pipeline_stage_->progress(); }, kPipelinePatience, clock_.Now());
}

Status App::TearDown() {
  notifier_.Stopping();
  stopping_ = true;
  hub_.Close();
  api_.reset();
  if (source_running_) parts_.triggers->Stop();
  Status outcome = std::move(outcome_);
  const auto join = [&outcome](std::unique_ptr<Stage>& stage) {
    if (!stage) return;
    stage->RequestStop();
    if (Status ended = stage->Join(); !ended && outcome) outcome = std::move(ended);
    stage.reset();
  };
  join(camera_stage_);
  join(recorder_stage_);
  if (pipeline_stage_) {
    pipeline_stage_->RequestStop();
    const HostTime deadline = clock_.Now() + kPipelineGrace;
    while (!pipeline_stage_->finished() && clock_.Now() < deadline) {
      std::this_thread::sleep_for(milliseconds(10));
    }
    if (!pipeline_stage_->finished()) {
      spdlog::warn("pipeline: still busy after {} s: leaving its step to the next start",
                   kPipelineGrace.count());
      spdlog::shutdown();
      std::_Exit(outcome ? 0 : ExitCode(outcome.error().kind));
    }
    join(pipeline_stage_);
  }
  spdlog::info("stopped");
  return outcome;
}

std::shared_ptr<App::Session> App::session() const {
  std::lock_guard lock(mutex_);
  return session_;
}

void App::PostOrLog(EventLoop::Callback message) {
  if (!loop_->Post(std::move(message)) && !stopping_) {
    spdlog::error("the main loop does not keep up: a message to it is lost");
  }
}

// ---- camera thread

Status App::RunCamera(std::stop_token stop, Stage& self) {
  while (!stop.stop_requested()) {
    const Nanoseconds rest = runner_->Turn();
    self.Progress();
    if (rest > Nanoseconds(0)) Rest(stop, std::min<Nanoseconds>(rest, seconds(1)));
  }
  runner_->Close();
  return {};
}

Status App::OnCameraOpened(const CameraInfo& info) {
  const auto fault = [this](Error error) {
    state_.Update([&](CaptureConditions& c) { c.fault = error.message; });
    return tl::unexpected<Error>(std::move(error));
  };
  ExposureLimits limits;
  limits.shortest = info.shortest;
  limits.longest = info.longest;
  limits.quantum_s = info.exposure_quantum_s;
  Result<BracketPlan> plan = BracketPlan::Make(MakeBracketOptions(config_.bracket), limits);
  if (!plan) return fault(plan.error());

  std::shared_ptr<Session> session = this->session();
  if (session) {
    if (const std::string difference = Difference(session->info.camera, info.description);
        !difference.empty()) {
      return fault(Error{ErrorKind::kUnavailable,
                         fmt::format("session {}: {}", session->directory.string(), difference)});
    }
  } else {
    SessionInfo session_info;
    session_info.created = IsoUtc(clock_.NowUtc());
    session_info.camera = info.description;
    session_info.response = info.response;
    session_info.extra_json = info.extra_json;
    session_info.files = info.files;
    // Nobody asks a recorded frame for an exposure.
    if (info.proof != ExposureProof::kFile) session_info.bracket = plan->Description();
    Result<SessionWriter> writer = SessionWriter::Create(choice_.directory, session_info);
    if (!writer) return fault(writer.error());
    session = std::make_shared<Session>(std::move(*writer));
    session->directory = choice_.directory;
    session->info = std::move(session_info);
    spdlog::info("session {}: begun", choice_.directory.string());
    hub_.Publish(
        {{"event", "session"}, {"what", "begun"}, {"directory", session->directory.string()}});
    {
      std::lock_guard lock(mutex_);
      session_ = session;
    }
    PostOrLog([this] { StartSessionStages(); });
  }
  {
    std::lock_guard lock(mutex_);
    camera_model_ = info.description.model;
    camera_serial_ = info.description.serial;
  }
  if (!owned_controller_) {
    owned_controller_ = std::make_unique<CaptureController>(
        std::move(*plan), info.description, MakeCaptureOptions(config_, info),
        TriggerId{session->store.writer().next_frame()}, recorder_,
        [this](const ExposureRequest& request) { return runner_->Command(request); },
        parts_.positions.get(), clock_);
    controller_.store(owned_controller_.get(), std::memory_order_release);
  }
  return {};
}

void App::OnCameraAway(const Error& error) {
  if (CaptureController* capture = controller()) capture->OnCameraLost(error.message);
  const bool was_ready = state_.conditions().camera_ready;
  const std::string before = state_.conditions().waiting;
  state_.Update([&](CaptureConditions& c) {
    c.camera_ready = false;
    c.waiting = error.message;
  });
  if (was_ready || before != error.message) spdlog::warn("camera: {}", error.message);
}

// ---- recorder thread

Status App::RunRecorder(std::stop_token stop, Stage& self) {
  const std::shared_ptr<Session> session = this->session();
  std::optional<HostTime> give_up;
  while (true) {
    const Recorder::Turn turn = recorder_.Step(session->store, milliseconds(100));
    self.Progress();
    if (stop.stop_requested()) {
      if (turn == Recorder::Turn::kIdle) return {};
      if (!give_up) give_up = clock_.Now() + seconds(10);
      if (turn == Recorder::Turn::kFailed && clock_.Now() > *give_up) {
        return Fail(ErrorKind::kIo, "{} triggers could not be journaled", recorder_.waiting());
      }
    }
    if (turn == Recorder::Turn::kFailed) std::this_thread::sleep_for(milliseconds(200));
  }
}

void App::OnJournaled(const FrameRecord& record) {
  {
    std::lock_guard lock(mutex_);
    lines_.Add(record.status);
    ++journaled_;
    views_caught_up_ = false;
    if (record.status == FrameStatus::kOk && Value(record.position) != last_position_with_pixels_) {
      last_position_with_pixels_ = Value(record.position);
      ++positions_with_pixels_;
    }
  }
  journal_grew_.notify_all();
  nlohmann::json event = {{"event", "frame"},
                          {"frame", Value(record.frame)},
                          {"position", Value(record.position)},
                          {"status", ToString(record.status)},
                          {"exposure_s", record.exposure.time.seconds()}};
  if (!record.detail.empty()) event["detail"] = record.detail;
  hub_.Publish(event);
  if (record.status != FrameStatus::kOk) {
    if (const auto count = drop_log_.Pass(clock_.Now())) {
      spdlog::warn("trigger {}: {}: {}{}", Value(record.frame), ToString(record.status),
                   record.detail, *count > 1 ? fmt::format(" ({} lost)", *count) : "");
    }
  }
  if (CaptureController* capture = controller()) {
    const CaptureController::RecentLosses losses = capture->recent_losses();
    state_.Update([&](CaptureConditions& c) {
      c.frames_lost = losses.lost == 0
                          ? ""
                          : fmt::format("{} of the last {} triggers gave no frame (last: {})",
                                        losses.lost, losses.of, losses.last_reason);
    });
  }
}

// ---- pipeline thread

void App::SetViewsError(const std::string& error) {
  {
    std::lock_guard lock(mutex_);
    if (views_error_ == error) return;
    views_error_ = error;
  }
  if (error.empty()) {
    spdlog::info("views: going on");
  } else {
    spdlog::error("views: {}", error);
  }
  state_.Update([&](CaptureConditions& c) {
    c.views_stalled = error.empty() ? "" : fmt::format("views: {}", error);
  });
}

void App::WaitForJournal(std::stop_token stop, Nanoseconds timeout, std::uint64_t known) {
  std::unique_lock lock(mutex_);
  journal_grew_.wait_for(lock, stop, timeout, [&] { return journaled_ != known || finish_views_; });
}

void App::OnViewDone(const ViewDone& view) {
  if (!view.already_complete) {
    spdlog::info(
        "view {}: done in {:.2f} s (pose {:.2f}, stereo {:.2f}, merge {:.2f}, write {:.2f})",
        Value(view.position), view.pose_s + view.stereo_s + view.merge_s + view.write_s,
        view.pose_s, view.stereo_s, view.merge_s, view.write_s);
    for (const std::string& warning : view.warnings) {
      spdlog::warn("view {}: {}", Value(view.position), warning);
    }
  }
  {
    std::lock_guard lock(mutex_);
    last_view_ = Value(view.position);
  }
  hub_.Publish({{"event", "view"},
                {"position", Value(view.position)},
                {"already_complete", view.already_complete},
                {"seconds",
                 {{"pose", view.pose_s},
                  {"stereo", view.stereo_s},
                  {"merge", view.merge_s},
                  {"write", view.write_s}}},
                {"warnings", view.warnings}});
}

Status App::FinishViews(SessionProcessor* processor) {
  if (processor != nullptr) OMNIHDR_TRY(processor->Finish());
  const std::shared_ptr<Session> session = this->session();
  if (SessionEnded(session->directory)) return {};
  std::uint64_t frames = 0;
  {
    std::lock_guard lock(mutex_);
    frames = journaled_;
  }
  return MarkSessionEnded(session->directory, frames, clock_.NowUtc());
}

Status App::RunPipeline(std::stop_token stop, Stage& self) {
  LowerPriority();
  const std::shared_ptr<Session> session = this->session();
  std::unique_ptr<SessionProcessor> processor;
  Nanoseconds retry = kViewsFirstRetry;
  bool ended = false;
  const auto failed = [&](const Error& error) {
    SetViewsError(error.message);
    Rest(stop, retry);
    retry = std::min<Nanoseconds>(retry * 2, kViewsLongestRetry);
  };
  while (!stop.stop_requested()) {
    self.Progress();
    if (!processor && parts_.open_pipeline) {
      ProcessorCallbacks callbacks;
      callbacks.view_done = [this](const ViewDone& view) { OnViewDone(view); };
      callbacks.warning = [](const std::string& message) { spdlog::warn("{}", message); };
      auto opened = parts_.open_pipeline(session->directory, std::move(callbacks));
      if (!opened) {
        failed(opened.error());
        continue;
      }
      processor = std::move(*opened);
    }
    // Read before the step: what is journaled before the flag is set will then have been seen.
    bool finish = false;
    std::uint64_t journaled = 0;
    {
      std::lock_guard lock(mutex_);
      finish = finish_views_;
      journaled = journaled_;
    }
    SessionProcessor::Progress progress = SessionProcessor::Progress::kNothingNew;
    if (processor) {
      const Result<SessionProcessor::Progress> step = processor->Step();
      if (!step) {
        failed(step.error());
        continue;
      }
      progress = *step;
    }
    const bool idle = progress == SessionProcessor::Progress::kNothingNew;
    if (idle && finish && !ended) {
      if (const Status finished = FinishViews(processor.get()); !finished) {
        failed(finished.error());
        continue;
      }
      ended = true;
    }
    SetViewsError("");
    retry = kViewsFirstRetry;
    {
      std::lock_guard lock(mutex_);
      if (processor) views_ = processor->counts();
      views_caught_up_ = idle && journaled == journaled_;
    }
    if (ended && idle && finish) {
      PostOrLog([this] { OnSessionEnded(); });
      // Nothing comes any more: only the stop is waited for.
      while (!stop.stop_requested()) {
        self.Progress();
        Rest(stop, seconds(1));
      }
    }
    if (idle && !finish) WaitForJournal(stop, seconds(1), journaled);
  }
  return {};
}

// ---- main loop

void App::OnStateChanged(const StateReport& report) {
  const std::string text = fmt::format("{}: {}", ToString(report.state), report.reason);
  notifier_.StatusText(text);
  hub_.Publish({{"event", "state"}, {"state", ToString(report.state)}, {"reason", report.reason}});
  spdlog::debug("state {}", text);
}

void App::OnSignal(int signal) {
  if (phase_ == Phase::kStopping) {
    spdlog::warn("second signal: not waiting for what is on its way");
    loop_->Quit();
    return;
  }
  StopNow(signal == SIGINT ? "interrupted" : "asked to stop by SIGTERM");
}

void App::ScheduleCaptureTimer() {
  CaptureController* capture = controller();
  if (capture == nullptr) return;
  if (const auto deadline = capture->NextDeadline()) {
    capture_timer_->Set(*deadline);
  } else {
    capture_timer_->Disarm();
  }
}

Result<AcceptedTrigger> App::HandleTrigger(const TriggerEvent& event) {
  CaptureController* capture = controller();
  Result<AcceptedTrigger> accepted = capture->OnTrigger(event);
  ScheduleCaptureTimer();
  if (!accepted) {
    state_.Update([&](CaptureConditions& c) {
      if (c.storage.empty()) c.storage = accepted.error().message;
    });
    return accepted;
  }
  nlohmann::json json = {{"event", "trigger"},
                         {"trigger", Value(accepted->trigger)},
                         {"position", Value(accepted->position)},
                         {"step", accepted->step},
                         {"exposure_s", accepted->exposure.time.seconds()}};
  if (accepted->odometer_m) json["odometer_m"] = *accepted->odometer_m;
  hub_.Publish(json);
  return accepted;
}

void App::OnTriggersReady() {
  if (!source_running_) return;
  for (int i = 0; i < kTriggersAtOnce; ++i) {
    Result<std::optional<TriggerEvent>> event = parts_.triggers->Poll();
    if (!event) {
      StopSource();
      DisarmBecause(event.error());
      return;
    }
    if (!*event) {
      CheckSeriesEnd();
      if (!source_running_) return;
      if (const auto next = parts_.triggers->NextDeadline()) trigger_timer_->Set(*next);
      return;
    }
    if (phase_ != Phase::kRunning || !armed_ || controller() == nullptr) {
      ++ignored_triggers_;
      continue;
    }
    // A refusal is counted and shown in the state.
    [[maybe_unused]] const auto accepted = HandleTrigger(**event);
    CheckSeriesEnd();
    if (!source_running_) return;
  }
  trigger_timer_->Set(clock_.Now());
}

void App::DisarmBecause(const Error& error) {
  const std::string reason =
      fmt::format("trigger source {}: {}", parts_.triggers->kind(), error.message);
  spdlog::error("{}", reason);
  armed_ = false;
  state_.Update([&](CaptureConditions& c) {
    c.armed = false;
    c.idle = reason;
  });
}

void App::CheckSeriesEnd() {
  if (phase_ != Phase::kRunning) return;
  CaptureController* capture = controller();
  if (config_.trigger.limit > 0 && capture != nullptr &&
      Value(capture->next_trigger()) >= config_.trigger.limit) {
    EndSession(fmt::format("all {} triggers of the series have come", config_.trigger.limit),
               false);
  } else if (source_running_ && parts_.triggers->exhausted()) {
    EndSession("the trigger source has come to its end", false);
  }
}

void App::StartSource() {
  if (!armed_ || source_running_ || phase_ != Phase::kRunning || controller() == nullptr ||
      !state_.conditions().camera_ready) {
    return;
  }
  // A series that was complete before a restart stays complete.
  CheckSeriesEnd();
  if (phase_ != Phase::kRunning) return;
  if (const Status started = parts_.triggers->Start(); !started) {
    DisarmBecause(started.error());
    return;
  }
  source_running_ = true;
  const int fd = parts_.triggers->fd();
  if (fd >= 0) {
    if (const Status watched = loop_->OnReadable(fd, [this] { OnTriggersReady(); }); !watched) {
      StopSource();
      DisarmBecause(watched.error());
      return;
    }
    watched_fd_ = fd;
  }
  OnTriggersReady();
}

void App::StopSource() {
  if (!source_running_) return;
  if (watched_fd_ >= 0) loop_->StopWatching(watched_fd_);
  watched_fd_ = -1;
  trigger_timer_->Disarm();
  parts_.triggers->Stop();
  source_running_ = false;
}

void App::EndSession(const std::string& reason, bool exit_after) {
  exit_after_end_ = exit_after_end_ || exit_after;
  if (phase_ == Phase::kEnded) {
    if (exit_after_end_) StopNow(reason);
    return;
  }
  if (phase_ != Phase::kRunning) return;
  phase_ = Phase::kEnding;
  end_reason_ = reason;
  spdlog::info("session: ending: {}", reason);
  StopSource();
  armed_ = false;
  state_.Update([&](CaptureConditions& c) {
    c.armed = false;
    c.idle = fmt::format("{}: finishing the views", reason);
    if (exit_after_end_) c.stopping = c.idle;
  });
  hub_.Publish({{"event", "session"}, {"what", "ending"}, {"reason", reason}});
  CheckDrained();
}

void App::OnSessionEnded() {
  if (phase_ == Phase::kStopping) return;
  const bool news = !ended_;
  ended_ = true;
  phase_ = Phase::kEnded;
  if (news) {
    state_.Update([&](CaptureConditions& c) {
      c.idle = fmt::format("the session has ended ({})", end_reason_);
    });
    spdlog::info("session: ended, all views are finished");
    hub_.Publish({{"event", "session"}, {"what", "ended"}, {"reason", end_reason_}});
  }
  if (exit_after_end_) StopNow("the session has ended");
}

void App::StopNow(const std::string& reason) {
  if (phase_ == Phase::kStopping) return;
  phase_ = Phase::kStopping;
  spdlog::info("stopping: {}", reason);
  StopSource();
  armed_ = false;
  state_.Update([&](CaptureConditions& c) {
    c.armed = false;
    c.stopping = reason;
  });
  // Every frame on its way has a deadline of its own; the rest is for the disk.
  double longest_s = config_.camera.frame_timeout_s;
  for (const ExposureTime exposure : config_.bracket.Exposures()) {
    longest_s = std::max(longest_s, config_.camera.frame_timeout_s + exposure.seconds());
  }
  stop_deadline_ =
      clock_.Now() + Nanoseconds(std::llround(longest_s * 1e9)) + Nanoseconds(seconds(5));
  CheckDrained();
}

bool App::Drained() const {
  const CaptureController* capture = controller();
  return capture == nullptr || (capture->open_triggers() == 0 && recorder_.reserved_lines() == 0);
}

void App::CheckDrained() {
  if (phase_ == Phase::kStopping) {
    if (Drained() || clock_.Now() >= stop_deadline_) {
      loop_->Quit();
      return;
    }
  } else if (phase_ == Phase::kEnding) {
    if (Drained()) {
      {
        std::lock_guard lock(mutex_);
        finish_views_ = true;
      }
      journal_grew_.notify_all();
      return;
    }
  } else {
    return;
  }
  drain_timer_->Set(clock_.Now() + Nanoseconds(milliseconds(10)));
}

void App::Supervise() {
  supervise_timer_->Set(clock_.Now() + supervise_interval_);
  for (const auto* stage : {&camera_stage_, &recorder_stage_, &pipeline_stage_}) {
    if (!*stage || !(*stage)->finished() || phase_ == Phase::kStopping) continue;
    outcome_ = (*stage)->Join();
    if (outcome_) outcome_ = Fail(ErrorKind::kSoftware, "stage {} ended", (*stage)->name());
    spdlog::critical("stage {}: {}", (*stage)->name(), outcome_.error().message);
    state_.Update([&](CaptureConditions& c) { c.fault = outcome_.error().message; });
    loop_->Quit();
    return;
  }
  if (const auto stalled = supervisor_.Stalled(clock_.Now())) {
    spdlog::critical("{}: the watchdog is not fed", *stalled);
    state_.Update([&](CaptureConditions& c) { c.fault = *stalled; });
    return;
  }
  notifier_.FeedWatchdog();
}

// ---- API

StatusReport App::BuildStatus() const {
  StatusReport s;
  s.version = OMNIHDR_VERSION;
  s.uptime_s = std::chrono::duration<double>(clock_.Now() - started_).count();
  s.state = state_.report();
  s.camera_ready = state_.conditions().camera_ready;
  s.armed = armed_;
  s.trigger_source = std::string(parts_.triggers->kind());
  s.triggers_ignored = ignored_triggers_;
  s.session_ended = ended_;
  s.pipeline_enabled = static_cast<bool>(parts_.open_pipeline);
  s.buffers = static_cast<std::uint64_t>(std::max(config_.recorder.queue_frames, 1));
  s.buffers_free = recorder_.free_buffers();
  {
    std::lock_guard lock(mutex_);
    if (session_) {
      s.session_directory = session_->directory.string();
      s.session_resumed = session_->resumed;
    }
    s.camera_model = camera_model_;
    s.camera_serial = camera_serial_;
    s.lines = lines_;
    s.triggers = journaled_;
    s.views_finished = static_cast<std::uint64_t>(std::max(views_.views_complete, 0));
    const auto expected = views_caught_up_ ? static_cast<std::int64_t>(views_.positions_seen)
                                           : static_cast<std::int64_t>(positions_with_pixels_);
    s.backlog =
        parts_.open_pipeline ? std::max<std::int64_t>(0, expected - views_.views_complete) : 0;
    s.last_view = last_view_;
    s.views_error = views_error_;
  }
  if (const CaptureController* capture = controller()) {
    const TriggerId next = capture->next_trigger();
    const std::uint64_t triggers = std::max(Value(next), s.triggers);
    s.triggers_in_flight = triggers - s.triggers;
    s.triggers = triggers;
    s.capture = capture->counts();
    s.bracket_step = capture->plan().StepForTrigger(next);
    s.bracket_steps = static_cast<int>(capture->plan().exposures().size());
    s.bracket_order = std::string(ToString(capture->plan().order()));
    s.exposure = capture->plan().ForTrigger(next);
  }
  if (s.triggers > 0) {
    s.positions_triggered =
        static_cast<std::int64_t>((s.triggers - 1) /
                                  static_cast<std::uint64_t>(config_.bracket.frames_per_position)) +
        1;
  }
  if (parts_.positions) s.odometer_m = parts_.positions->OdometerMetres(clock_.Now());
  return s;
}

Result<StatusReport> App::GetStatus() {
  return loop_->Call([this] { return BuildStatus(); }, kApiDeadline);
}

ApiReply App::OnLoop(std::function<ApiReply()> function) {
  Result<ApiReply> reply = loop_->Call(std::move(function), kApiDeadline);
  return reply ? *reply : ApiReply::Refused(503, reply.error().message);
}

ApiReply App::ArmNow() {
  if (phase_ != Phase::kRunning) {
    return ApiReply::Refused(
        409, phase_ == Phase::kStopping ? "the daemon is stopping" : "the session has ended");
  }
  armed_ = true;
  state_.Update([](CaptureConditions& c) {
    c.armed = true;
    c.idle.clear();
  });
  StartSource();
  // A source that cannot start, or a series that is complete, disarms again.
  if (!armed_) return ApiReply::Refused(409, state_.conditions().idle);
  return {200, {{"armed", true}, {"state", ToString(state_.report().state)}}};
}

ApiReply App::Arm() {
  return OnLoop([this] {
    ApiReply reply = ArmNow();
    if (reply.http_status == 200) spdlog::info("armed");
    return reply;
  });
}

ApiReply App::Disarm() {
  return OnLoop([this]() -> ApiReply {
    StopSource();
    armed_ = false;
    state_.Update([](CaptureConditions& c) { c.armed = false; });
    spdlog::info("disarmed");
    return {200, {{"armed", false}, {"state", ToString(state_.report().state)}}};
  });
}

ApiReply App::Trigger() {
  return OnLoop([this]() -> ApiReply {
    if (phase_ == Phase::kStopping) return ApiReply::Refused(409, "the daemon is stopping");
    if (phase_ != Phase::kRunning) return ApiReply::Refused(409, "the session has ended");
    if (!armed_) return ApiReply::Refused(409, "disarmed: arm first");
    if (controller() == nullptr) {
      return ApiReply::Refused(503, fmt::format("no session yet: {}", state_.report().reason));
    }
    TriggerEvent event;
    event.time = clock_.Now();
    const Result<AcceptedTrigger> accepted = HandleTrigger(event);
    if (!accepted) return ApiReply::Refused(503, accepted.error().message);
    CheckSeriesEnd();
    return {200,
            {{"trigger", Value(accepted->trigger)},
             {"position", Value(accepted->position)},
             {"step", accepted->step},
             {"exposure_s", accepted->exposure.time.seconds()}}};
  });
}

ApiReply App::Finish() {
  return OnLoop([this]() -> ApiReply {
    if (phase_ == Phase::kStopping) return ApiReply::Refused(409, "the daemon is stopping");
    if (!session()) return ApiReply::Refused(409, "there is no session yet");
    EndSession("asked to finish", false);
    return {200, {{"ending", true}}};
  });
}

ApiReply App::Stop(bool leave_session_open) {
  return OnLoop([this, leave_session_open]() -> ApiReply {
    if (leave_session_open || !session()) {
      StopNow("asked to stop");
    } else {
      if (phase_ == Phase::kStopping) return {200, {{"stopping", true}}};
      EndSession("asked to stop", true);
      state_.Update([](CaptureConditions& c) {
        if (c.stopping.empty()) c.stopping = "finishing the views";
      });
    }
    return {200, {{"stopping", true}}};
  });
}

}  // namespace omnihdr
