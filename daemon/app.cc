#include "daemon/app.h"

#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <set>
#include <thread>
#include <utility>

#include "core/base/background.h"
#include "core/base/parallel_for.h"
#include "core/base/realtime.h"
#include "core/session/session_reader.h"
#include "daemon/api/token.h"

// Building the daemon and taking it down. Its threads: app_stages.cc; main loop and API:
// app_control.cc.
namespace omnihdr {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr std::size_t kMaxListeners = 4;
constexpr std::size_t kListenerQueue = 1024;
// How long a stopping daemon waits for the pipeline's current step before it leaves: all state is
// on disk, so leaving costs no more than a step done again.
constexpr auto kPipelineGrace = seconds(30);

RecorderOptions MakeRecorderOptions(const RecorderConfig& config) {
  RecorderOptions options;
  options.buffers = static_cast<std::size_t>(std::max(config.queue_frames, 1));
  options.png_compression = config.png_compression;
  return options;
}

}  // namespace

BracketOptions MakeBracketOptions(const BracketConfig& bracket, bool burst) {
  BracketOptions options;
  options.order = bracket.order;
  options.exposures = bracket.Exposures();
  options.gain = GainDb{bracket.gain_db};
  options.frames_per_position =
      burst ? static_cast<int>(options.exposures.size()) : bracket.frames_per_position;
  options.flicker_hz = bracket.flicker_hz;
  options.max_blur_px = bracket.max_blur_px;
  options.speed_m_s = bracket.speed_m_s;
  options.near_m = bracket.near_m;
  return options;
}

App::App(DaemonConfig config, SessionChoice choice, MakeParts make_parts, ReadConfig read_config)
    : config_(std::move(config)),
      choice_(std::move(choice)),
      make_parts_(std::move(make_parts)),
      read_config_(std::move(read_config)),
      hub_(kMaxListeners, kListenerQueue),
      state_([this](const StateReport& report) { OnStateChanged(report); }),
      recorder_(
          MakeRecorderOptions(config_.recorder),
          RecorderEvents{.journaled = [this](const FrameRecord& record) { OnJournaled(record); },
                         .storage_failed =
                             [this](const Error& error) {
                               if (const auto count = storage_log_.Pass(clock_.Now())) {
                                 const LogContext about({.error = "storage"});
                                 spdlog::error("storage: {} ({} times)", error.message, *count);
                               }
                               ++storage_errors_;
                               SetStorageProblem(StorageProblem::kFrames, error.message);
                             },
                         .storage_recovered =
                             [this] {
                               spdlog::info("storage: frames are stored again");
                               SetStorageProblem(StorageProblem::kFrames, "");
                             }}) {}

App::~App() = default;

Status App::Run() {
  const LogContext stage({.stage = "main"});
  SetWorkerCount(config_.pipeline.workers);
  if (choice_.exists) OMNIHDR_TRY(ResumeSession());
  ReadStorage(choice_.directory);
  PartsContext context;
  context.first_trigger = journaled_;
  context.room = [this] { return recorder_.free_buffers() > 0; };
  context.last_odometer_m = last_odometer_m_;
  context.command = [this](ApplianceCommand command) { return Command(command); };
  OMNIHDR_ASSIGN(parts_, make_parts_(context));
  OMNIHDR_TRY(MakeController());
  OMNIHDR_TRY(StartLoop());
  ApiServerOptions api;
  api.socket = config_.api.socket;
  api.socket_mode = config_.api.socket_mode;
  api.socket_group = config_.api.socket_group;
  if (const auto tcp = ParseTcpEndpoint(config_.api.tcp)) {
    api.tcp.address = tcp->address;
    api.tcp.port = tcp->port;
    OMNIHDR_ASSIGN(api.tcp.token, FindToken(config_.api.token_file));
  }
  OMNIHDR_ASSIGN(api_, ApiServer::Listen(api, *this, hub_));
  OMNIHDR_TRY(StartLinks());
  orientation_ = std::make_unique<OrientationWatch>(
      [this](const OrientationState& found) { OnOrientation(found); });
  StartStages();
  state_.Update([](CaptureConditions& c) {
    c.started = true;
    c.waiting = "opening the camera";
  });
  notifier_.Ready();
  spdlog::info("omnihdrd {} serves on {}{}", OMNIHDR_VERSION, config_.api.socket,
               config_.api.tcp.empty() ? "" : " and " + config_.api.tcp);
  {
    const RealtimeThread realtime(RealtimePriority::kTriggers);
    if (Status ran = loop_->Run(); !ran && outcome_) outcome_ = std::move(ran);
  }
  return TearDown();
}

Status App::ResumeSession() {
  OMNIHDR_ASSIGN(SessionWriter writer, SessionWriter::Resume(choice_.directory));
  OMNIHDR_ASSIGN(const SessionContents contents, ReadSession(choice_.directory));
  for (const std::string& warning : writer.warnings()) spdlog::warn("{}", warning);
  std::set<std::int64_t> with_pixels;
  std::set<std::int64_t> positions;
  for (const FrameRecord& record : contents.journal.frames) {
    lines_.Add(record.status);
    positions.insert(Value(record.position));
    if (record.status == FrameStatus::kOk) with_pixels.insert(Value(record.position));
    if (record.odometer_m) last_odometer_m_ = record.odometer_m;
    last_retakes_ = record.retakes;
  }
  journaled_ = writer.next_frame();
  durable_bytes_ = writer.durable_bytes();
  positions_with_pixels_ = with_pixels.size();
  if (!with_pixels.empty()) last_position_with_pixels_ = *with_pixels.rbegin();
  auto session = std::make_shared<Session>(std::move(writer));
  session->directory = choice_.directory;
  session->info = contents.info;
  session->resumed = true;
  if (contents.info.bracket && contents.info.bracket->metered) {
    metered_ = contents.info.bracket->exposures;
  }
  if (const auto continuation = ContinuationOf(contents.info)) {
    session->first_frame = continuation->first_frame;
  }
  session->extent = {PixelBytes(choice_.directory), positions.size(), clock_.Now()};
  journaled_ = session->next_frame();
  // Sessions before it in a series whose views were not finished when the daemon went away.
  for (const std::filesystem::path& before : UnfinishedBefore(choice_.directory)) {
    OMNIHDR_ASSIGN(const SessionContents earlier, ReadSession(before));
    std::set<std::int64_t> pixels;
    for (const FrameRecord& record : earlier.journal.frames) {
      if (record.status == FrameStatus::kOk) pixels.insert(Value(record.position));
    }
    positions_with_pixels_ += pixels.size();
    views_queue_.push_back(before);
    spdlog::info("session {}: its views are finished first", before.string());
  }
  session_ = std::move(session);
  SetLogSession(choice_.directory.string());
  spdlog::info("session {}: continued after {} triggers{}", choice_.directory.string(), journaled_,
               choice_.ended ? "; it has ended" : "");
  if (choice_.ended) {
    phase_ = Phase::kEnded;
    ended_ = true;
    end_reason_ = "the session has ended";
    finish_views_ = true;
    state_.Update([&](CaptureConditions& c) {
      c.idle = end_reason_;
      c.ended = true;
    });
  }
  return {};
}

// Before there is a camera, so that triggers are numbered and get their lines from the first one
// on; without a session the lines wait in the recorder.
Status App::MakeController() {
  OMNIHDR_ASSIGN(BracketPlan plan, BracketPlan::Make(WantedBracket(config_.bracket), {}));
  CaptureOptions options;
  options.frame_timeout = Nanoseconds(std::llround(config_.camera.frame_timeout_s * 1e9));
  options.tolerance.relative = config_.camera.exposure_tolerance;
  options.retake = config_.bracket.retake;
  options.retakes = last_retakes_;
  options.burst = config_.trigger.burst;
  options.busy_patience = Nanoseconds(std::llround(config_.trigger.busy_wait_s * 1e9));
  options.wired = config_.trigger.wired;
  controller_ = std::make_unique<CaptureController>(
      std::move(plan), session_ ? session_->info.camera : CameraDescription{}, options,
      TriggerId{journaled_}, recorder_,
      [this](const ExposureRequest& request) { return CommandCamera(request); },
      parts_.positions.get(), clock_, parts_.place.get(), &utc_);
  return {};
}

Status App::StartLoop() {
  OMNIHDR_ASSIGN(loop_, EventLoop::Create());
  OMNIHDR_TRY(loop_->OnTermination([this](int signal) { OnSignal(signal); }));
  OMNIHDR_TRY(loop_->OnHangup([this] { OnHangup(); }));
  OMNIHDR_ASSIGN(trigger_timer_, loop_->AddTimer([this] { OnTriggersReady(); }));
  OMNIHDR_ASSIGN(capture_timer_, loop_->AddTimer([this] {
    controller_->OnTime();
    CheckFrameless();
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
                               // No trigger comes before the look at the scene.
                               if (meter_due_) metering_ = true;
                               PostOrLog([this] {
                                 spdlog::info("camera: ready");
                                 state_.Update([](CaptureConditions& c) {
                                   c.camera_ready = true;
                                   c.fault.clear();
                                 });
                                 StartSource();
                                 TakeStanding();
                               });
                               PrepareNext();
                             },
                         .frame =
                             [this](CameraFrame frame) {
                               const HostTime now = clock_.Now();
                               const bool wired = frame.wired.has_value();
                               if (!wired) latency_.FrameArrived(frame.trigger, now);
                               const auto trigger = controller_->OnFrame(std::move(frame));
                               if (wired && trigger) latency_.FrameArrived(*trigger, now);
                               PrepareNext();
                               TellNotes();
                               // The next one of a burst, and a frame that waits for its edge, have
                               // a deadline of their own.
                               if (config_.trigger.burst || wired) {
                                 PostOrLog([this] { ScheduleCaptureTimer(); });
                               }
                             },
                         .away = [this](const Error& error) { OnCameraAway(error); }},
      clock_);
  if (session()) StartSessionStages();
  camera_stage_ = std::make_unique<Stage>(
      "camera", [this](std::stop_token stop, Stage& self) { return RunCamera(stop, self); });
  supervisor_.Watch(
      "camera", [this] { return camera_stage_->progress(); }, parts_.patience.camera, clock_.Now());
  retention_stage_ = std::make_unique<Stage>(
      "retention", [this](std::stop_token stop, Stage& self) { return RunRetention(stop, self); });
  if (config_.trigger.armed_at_start && phase_ == Phase::kRunning) {
    PostOrLog([this] { ArmNow(); });
  }
}

void App::TellPlan() { parts_.camera->Plan({controller_->plan().Turn(), config_.trigger.burst}); }

void App::TellNotes() {
  while (const auto note = parts_.camera->TakeNote()) spdlog::info("camera: {}", *note);
}

void App::PrepareNext() { parts_.camera->Prepare(controller_->upcoming().exposure); }

void App::StartSessionStages() {
  {
    std::lock_guard lock(mutex_);
    views_queue_.push_back(session_->directory);
  }
  pipeline_stage_ = std::make_unique<Stage>(
      "pipeline", [this](std::stop_token stop, Stage& self) { return RunPipeline(stop, self); });
  recorder_stage_ = std::make_unique<Stage>(
      "recorder", [this](std::stop_token stop, Stage& self) { return RunRecorder(stop, self); });
  supervisor_.Watch(
      "recorder", [this] { return recorder_stage_->progress(); }, parts_.patience.recorder,
      clock_.Now());
  supervisor_.Watch(
      "pipeline", [this] { return pipeline_stage_->progress(); }, parts_.patience.pipeline,
      clock_.Now(), BackgroundWait);
}

Status App::TearDown() {
  notifier_.Stopping();
  stopping_ = true;
  hub_.Close();
  api_.reset();
  if (source_running_) parts_.triggers->Stop();
  StopLinks();
  Status outcome = std::move(outcome_);
  const auto join = [&outcome](std::unique_ptr<Stage>& stage) {
    if (!stage) return;
    stage->RequestStop();
    if (Status ended = stage->Join(); !ended && outcome) outcome = std::move(ended);
    stage.reset();
  };
  join(reload_stage_);
  join(retention_stage_);
  join(camera_stage_);
  join(recorder_stage_);
  orientation_.reset();
  if (pipeline_stage_) {
    pipeline_stage_->RequestStop();
    const HostTime deadline = clock_.Now() + kPipelineGrace;
    while (!pipeline_stage_->finished() && clock_.Now() < deadline) {
      notifier_.Retry();
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
  if (const std::size_t lost = session() ? 0 : recorder_.reserved_lines(); lost > 0) {
    spdlog::error("{} triggers came while there was no session and are in no journal", lost);
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

}  // namespace omnihdr
