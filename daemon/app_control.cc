#include "daemon/app.h"

#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <cmath>
#include <csignal>
#include <utility>

// What the daemon does on its main loop, and its answers to the API.
namespace omnihdr {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

constexpr auto kApiDeadline = seconds(2);
// Triggers handled before the loop looks after everything else again.
constexpr int kTriggersAtOnce = 64;
// More than any source keeps waiting.
constexpr int kMostDrained = 2048;
// After a trigger the state is "capturing" for so long.
constexpr auto kCapturingHold = seconds(2);

}  // namespace

// ---- main loop

void App::OnStateChanged(const StateReport& report) {
  const std::string text = fmt::format("{}: {}", ToString(report.state), report.reason);
  notifier_.StatusText(text);
  hub_.Publish({{"event", "state"},
                {"state", ToString(report.state)},
                {"reason", report.reason},
                {"remedy", report.remedy}});
  spdlog::debug("state {}; {}", text, report.remedy);
  ShowSoon();
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
  if (const auto deadline = controller_->NextDeadline()) {
    capture_timer_->Set(*deadline);
  } else {
    capture_timer_->Disarm();
  }
}

// Edges but no frames: the camera is opened anew. And what its clock has done.
void App::CheckFrameless() {
  const auto most = static_cast<std::uint64_t>(config_.trigger.rearm_after);
  const std::uint64_t frameless = controller_->frameless();
  if (most > 0 && frameless >= most &&
      runner_->Rearm(fmt::format("{} triggers in a row gave no frame: opened anew", frameless))) {
    ++rearmed_;
    hub_.Publish({{"event", "camera"}, {"what", "rearmed"}, {"triggers", frameless}});
  }
  const std::uint64_t jumps = controller_->counts().clock_jumps;
  if (jumps > clock_jumps_) {
    spdlog::warn("camera: its clock has jumped ({} times so far): fitted anew", jumps);
    hub_.Publish({{"event", "clock"}, {"what", "jumped"}, {"jumps", jumps}});
    clock_jumps_ = jumps;
  }
}

Result<AcceptedTrigger> App::HandleTrigger(const TriggerEvent& event) {
  Result<AcceptedTrigger> accepted = controller_->OnTrigger(event);
  CheckFrameless();
  ScheduleCaptureTimer();
  if (!accepted) {
    // Without a session it is not the storage that keeps the lines waiting.
    if (!session()) return accepted;
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
  last_trigger_ = clock_.Now();
  state_.Update([](CaptureConditions& c) { c.capturing = true; });
  ShowSoon();
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
    if (phase_ != Phase::kRunning || !armed_) {
      ++ignored_triggers_;
      continue;
    }
    // What is passed next ends the standing.
    standing_.reset();
    if ((*event)->standing && (*event)->lost_before == 0 &&
        (!state_.conditions().camera_ready || metering_)) {
      spdlog::info("trigger: the vehicle stands at a mark: its picture waits for the camera");
      standing_ = **event;
      continue;
    }
    // A refusal is counted and shown in the state.
    [[maybe_unused]] const auto accepted = HandleTrigger(**event);
    CheckSeriesEnd();
    if (!source_running_) return;
  }
  trigger_timer_->Set(clock_.Now());
}

// The picture of the place where the vehicle stood when its way began to be counted, now that there
// is a camera. It may have left the mark, and passed no other: where it is, the odometer says.
void App::TakeStanding() {
  if (!standing_ || !source_running_ || metering_) return;
  TriggerEvent event;
  event.time = clock_.Now();
  standing_.reset();
  [[maybe_unused]] const auto accepted = HandleTrigger(event);
  CheckSeriesEnd();
}

void App::DisarmBecause(const Error& error) {
  const std::string reason =
      fmt::format("trigger source {}: {}", parts_.triggers->kind(), error.message);
  spdlog::error("{}", reason);
  SetArmed(false);
  state_.Update([&](CaptureConditions& c) {
    c.armed = false;
    c.idle = reason;
  });
}

void App::SetArmed(bool armed) {
  armed_ = armed;
  controller_->SetArmed(armed);
}

void App::CheckSeriesEnd() {
  if (phase_ != Phase::kRunning) return;
  if (config_.trigger.limit > 0 && Value(controller_->next_trigger()) >= config_.trigger.limit) {
    EndSession(fmt::format("all {} triggers of the series have come", config_.trigger.limit),
               false);
  } else if (source_running_ && parts_.triggers->exhausted()) {
    EndSession("the trigger source has come to its end", false);
  }
}

void App::StartSource() {
  if (!armed_ || source_running_ || phase_ != Phase::kRunning ||
      (parts_.triggers->needs_camera() && !state_.conditions().camera_ready)) {
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

// What came before the source is stopped is accounted for like everything else.
void App::DrainSource() {
  for (int i = 0; i < kMostDrained && source_running_; ++i) {
    const Result<std::optional<TriggerEvent>> event = parts_.triggers->Poll();
    if (!event || !*event) break;
    [[maybe_unused]] const auto accepted = HandleTrigger(**event);
    CheckSeriesEnd();
  }
  if (source_running_) controller_->OnLost(parts_.triggers->TakeLost());
}

void App::StopSource() {
  if (!source_running_) return;
  if (watched_fd_ >= 0) loop_->StopWatching(watched_fd_);
  watched_fd_ = -1;
  trigger_timer_->Disarm();
  parts_.triggers->Stop();
  source_running_ = false;
  standing_.reset();
}

void App::EndSession(const std::string& reason, bool exit_after) {
  exit_after_end_ = exit_after_end_ || exit_after;
  if (phase_ == Phase::kEnded) {
    if (exit_after_end_) StopNow(reason);
    return;
  }
  if (phase_ != Phase::kRunning) return;
  phase_ = Phase::kEnding;
  ending_ = true;
  end_reason_ = reason;
  spdlog::info("session: ending: {}", reason);
  StopSource();
  SetArmed(false);
  state_.Update([&](CaptureConditions& c) {
    c.armed = false;
    c.idle = fmt::format("{}: finishing the views", reason);
    c.ended = true;
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
  DrainSource();
  phase_ = Phase::kStopping;
  ending_ = true;
  spdlog::info("stopping: {}", reason);
  StopSource();
  SetArmed(false);
  state_.Update([&](CaptureConditions& c) {
    c.armed = false;
    c.stopping = reason;
  });
  // Every frame on its way has a deadline of its own; the rest is for the disk.
  double longest_s = config_.camera.frame_timeout_s;
  double burst_s = 0.0;
  for (const ExposureTime exposure : config_.bracket.Exposures()) {
    longest_s = std::max(longest_s, config_.camera.frame_timeout_s + exposure.seconds());
    burst_s += config_.camera.frame_timeout_s + exposure.seconds();
  }
  if (config_.trigger.burst) longest_s = std::max(longest_s, burst_s);
  stop_deadline_ =
      clock_.Now() + Nanoseconds(std::llround(longest_s * 1e9)) + Nanoseconds(seconds(5));
  CheckDrained();
}

bool App::Drained() const {
  if (controller_->open_triggers() > 0) return false;
  // Lines without a session have nowhere to go: a stop does not wait for one.
  return recorder_.reserved_lines() == 0 || (phase_ == Phase::kStopping && !session());
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
  CheckLinks();
  TellNotes();
  if (clock_.Now() - last_trigger_ > kCapturingHold && controller_->open_triggers() == 0) {
    state_.Update([](CaptureConditions& c) { c.capturing = false; });
  }
  ShowStatus();
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
    if (stall_log_.Pass(clock_.Now())) {
      spdlog::critical("{}: the watchdog is not fed", *stalled);
    }
    stalled_ = *stalled;
    state_.Update([&](CaptureConditions& c) { c.fault = stalled_; });
    return;
  }
  if (!stalled_.empty()) {
    spdlog::info("every stage makes progress again");
    state_.Update([&](CaptureConditions& c) {
      if (c.fault == stalled_) c.fault.clear();
    });
    stalled_.clear();
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
  for (CameraCounter& counter : parts_.camera->Counters()) {
    s.camera_counters.emplace_back(std::move(counter.name), counter.value);
  }
  s.armed = armed_;
  s.trigger_source = std::string(parts_.triggers->kind());
  s.trigger_wired = config_.trigger.wired;
  s.camera_pulsed = config_.gpio.camera_trigger.configured();
  s.orientation = orientation_->state();
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
      s.session_first_frame = session_->first_frame;
    }
    s.camera_model = camera_model_;
    s.camera_serial = camera_serial_;
    s.camera_abilities = camera_abilities_;
    s.bracket_changes = bracket_changes_;
    s.metering = metering_report_;
    s.lines = lines_;
    s.triggers = journaled_;
    s.session_rotations = rotations_;
    const std::int64_t finished = std::max(
        std::int64_t{views_before_.views_complete} + views_.views_complete, std::int64_t{0});
    s.views_finished = static_cast<std::uint64_t>(finished);
    const auto expected = views_caught_up_ ? std::int64_t{views_before_.positions_seen} +
                                                 std::int64_t{views_.positions_seen}
                                           : static_cast<std::int64_t>(positions_with_pixels_);
    s.backlog = parts_.open_pipeline ? std::max<std::int64_t>(0, expected - finished) : 0;
    s.quality_level = views_.quality_level;
    s.quality = DescribeQuality(views_.quality_level);
    s.views_reduced =
        static_cast<std::uint64_t>(std::max(views_before_.views_reduced + views_.views_reduced, 0));
    s.last_view = last_view_;
    s.views_error = views_error_;
    s.storage = storage_report_;
    s.durability = config_.recorder.durability;
    s.max_loss_s = s.durability == Durability::kInterval ? config_.recorder.sync_interval_s : 0.0;
  }
  const TriggerId next = controller_->next_trigger();
  const std::uint64_t triggers = std::max(Value(next), s.triggers);
  s.triggers_in_flight = triggers - s.triggers;
  if (s.session_directory.empty()) s.triggers_without_session = s.triggers_in_flight;
  s.triggers = triggers;
  s.capture = controller_->counts();
  if (controller_->camera_known()) {
    const BracketPlan plan = controller_->plan();
    const CaptureController::Upcoming upcoming = controller_->upcoming();
    s.bracket_step = upcoming.step;
    s.bracket_steps = static_cast<int>(plan.exposures().size());
    s.bracket_order = std::string(ToString(plan.order()));
    s.exposure = upcoming.exposure;
  }
  if (s.triggers > 0) {
    const int frames =
        MakeBracketOptions(config_.bracket, config_.trigger.burst).frames_per_position;
    s.positions_triggered =
        static_cast<std::int64_t>((s.triggers - 1) / static_cast<std::uint64_t>(frames)) + 1;
  }
  s.unsynced_frames = unsynced_;
  s.storage_errors = storage_errors_;
  s.deleted = deleted_;
  if (api_) {
    const ApiServerCounts api = api_->counts();
    s.api_requests = api.requests;
    s.api_refused = {{"malformed", api.malformed},
                     {"late", api.late},
                     {"unauthorized", api.unauthorized},
                     {"too_many", api.too_many}};
  }
  s.reloads = reloads_;
  s.reloads_refused = reloads_refused_;
  s.reload_error = reload_error_;
  s.restart_needed = restart_needed_;
  s.camera_rearmed = rearmed_;
  s.utc = utc_.Quality();
  const HostTime now = clock_.Now();
  s.latencies = latency_.counts();
  if (const auto frame = latency_.last_frame()) {
    s.last_frame_age_s = std::chrono::duration<double>(now - *frame).count();
  }
  if (parts_.positions) s.odometer_m = parts_.positions->OdometerMetres(now);
  if (parts_.place) {
    s.gnss = parts_.place->Fix(now);
    s.heading_deg = parts_.place->HeadingDeg(now);
  }
  for (const auto& link : parts_.links) {
    s.links.emplace_back(std::string(link->name()), link->report());
  }
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
  SetArmed(true);
  state_.Update([](CaptureConditions& c) {
    c.armed = true;
    c.idle.clear();
  });
  WantMeter();
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

ApiReply App::DisarmNow() {
  DrainSource();
  StopSource();
  SetArmed(false);
  state_.Update([](CaptureConditions& c) {
    c.armed = false;
    c.capturing = false;
  });
  spdlog::info("disarmed");
  return {200, {{"armed", false}, {"state", ToString(state_.report().state)}}};
}

ApiReply App::Disarm() {
  return OnLoop([this] { return DisarmNow(); });
}

ApiReply App::TriggerNow() {
  if (phase_ == Phase::kStopping) return ApiReply::Refused(409, "the daemon is stopping");
  if (phase_ != Phase::kRunning) return ApiReply::Refused(409, "the session has ended");
  if (!armed_) return ApiReply::Refused(409, "disarmed: arm first");
  if (config_.trigger.wired) {
    return ApiReply::Refused(409, "trigger.wired: the camera exposes at pulses of its wire only");
  }
  if (!session()) {
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
}

ApiReply App::Trigger() {
  return OnLoop([this] { return TriggerNow(); });
}

ApiReply App::Finish() {
  return OnLoop([this]() -> ApiReply {
    if (phase_ == Phase::kStopping) return ApiReply::Refused(409, "the daemon is stopping");
    if (!session()) return ApiReply::Refused(409, "there is no session yet");
    DrainSource();
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
      DrainSource();
      EndSession("asked to stop", true);
      state_.Update([](CaptureConditions& c) {
        if (c.stopping.empty()) c.stopping = "finishing the views";
      });
    }
    return {200, {{"stopping", true}}};
  });
}

}  // namespace omnihdr
