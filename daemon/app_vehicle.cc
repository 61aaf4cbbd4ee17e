#include <fmt/format.h>
#include <spdlog/spdlog.h>

#include <algorithm>
#include <utility>

#include "daemon/app.h"

// What the daemon has to do with the vehicle around it: connections, lamps, field bus, strobe.
namespace omnihdr {
namespace {

using std::chrono::milliseconds;

// A master on a field bus waits for its answer.
constexpr auto kCommandDeadline = milliseconds(250);

bool IsFault(CaptureState state) {
  return state == CaptureState::kFault || state == CaptureState::kStorageFull ||
         state == CaptureState::kWaitingForCamera || state == CaptureState::kDegraded;
}

}  // namespace

Status App::StartLinks() {
  shows_ = !parts_.outputs.empty();
  for (const auto& link : parts_.links) {
    if (Status started = link->Start(); !started) {
      started = std::move(started).Context(link->name());
      StopLinks();
      return started;
    }
    spdlog::info("{}: started", link->name());
  }
  return {};
}

void App::StopLinks() {
  shows_ = false;
  for (const auto& output : parts_.outputs) {
    ApplianceStatus stopping;
    stopping.state = CaptureState::kStopping;
    output->Show(stopping);
  }
  // Their threads may call the loop, which goes before the parts do.
  parts_.strobe.reset();
  parts_.outputs.clear();
  parts_.links.clear();
}

void App::CheckLinks() {
  std::string missing;
  for (const auto& link : parts_.links) {
    const LinkReport report = link->report();
    const bool starting = report.opened == 0 && report.errors == 0;
    auto& [logged, gate] = link_logs_[std::string(link->name())];
    const std::string problem = starting ? "" : report.problem;
    if (!report.up && !problem.empty()) {
      missing += fmt::format("{}{}: {}", missing.empty() ? "" : "; ", link->name(), problem);
    }
    if (problem == logged) continue;
    if (problem.empty()) {
      spdlog::info("{}: works again", link->name());
      logged = problem;
    } else if (const auto count = gate.Pass(clock_.Now())) {
      spdlog::warn("{}: {}{}", link->name(), problem,
                   *count > 1 ? fmt::format(" ({} such messages)", *count) : "");
      logged = problem;
    }
  }
  state_.Update([&](CaptureConditions& c) { c.links = missing; });
}

void App::ShowSoon() {
  if (!shows_ || show_wanted_.exchange(true)) return;
  const bool posted = loop_->Post([this] {
    show_wanted_ = false;
    ShowStatus();
  });
  // The supervisor's timer shows it within a second.
  if (!posted) show_wanted_ = false;
}

void App::ShowStatus() {
  const StateReport report = state_.report();
  if (IsFault(report.state)) last_fault_ = report.reason;
  if (parts_.outputs.empty()) return;
  const StatusReport from = BuildStatus();
  ApplianceStatus status;
  status.state = report.state;
  status.reason = report.reason;
  status.remedy = report.remedy;
  status.armed = armed_;
  status.camera_ready = from.camera_ready;
  status.busy = controller_->open_triggers() > 0;
  status.session_ended = ended_;
  status.uptime_s = from.uptime_s;
  status.triggers = from.triggers;
  status.frames_recorded = from.lines[FrameStatus::kOk];
  status.frames_lost = from.lines.total() - from.lines[FrameStatus::kOk];
  status.views_finished = from.views_finished;
  status.views_waiting = static_cast<std::uint64_t>(std::max<std::int64_t>(from.backlog, 0));
  status.quality_level = from.quality_level;
  status.minutes_left = from.storage.minutes_left;
  status.storage_free_bytes = from.storage.free_bytes;
  status.storage_level = !from.storage.error.empty()     ? StorageLevel::kUnreadable
                         : !from.storage.stop.empty()    ? StorageLevel::kStop
                         : !from.storage.warning.empty() ? StorageLevel::kWarning
                                                         : StorageLevel::kEnough;
  status.odometer_m = from.odometer_m;
  status.gnss_fix = from.gnss.has_value();
  status.last_fault = last_fault_;
  for (const auto& output : parts_.outputs) output->Show(status);
}

// Main loop, from within the controller.
Status App::CommandCamera(const ExposureRequest& request) {
  {
    std::lock_guard lock(mutex_);
    if (!storage_report_.stop.empty()) {
      return Fail(ErrorKind::kCannotCreate, "storage: {}", storage_report_.stop);
    }
  }
  if (metering_) {
    return Fail(ErrorKind::kTemporary, "the first look at the scene is being taken");
  }
  OMNIHDR_TRY(runner_->Command(request));
  ++commanded_;
  latency_.Commanded(request.trigger, request.trigger_time, clock_.Now());
  // A pulse that cannot be given is counted by its line; the picture is taken all the same.
  if (parts_.strobe) [[maybe_unused]]
    const Status pulsed = parts_.strobe->Pulse();
  return {};
}

Status App::Command(ApplianceCommand command) {
  const Result<ApiReply> reply = loop_->Call(
      [this, command] {
        switch (command) {
          case ApplianceCommand::kArm:
            return ArmNow();
          case ApplianceCommand::kDisarm:
            return DisarmNow();
          case ApplianceCommand::kTrigger:
            break;
        }
        return TriggerNow();
      },
      kCommandDeadline);
  if (!reply) return tl::unexpected<Error>(reply.error());
  if (reply->http_status == 200) return {};
  return Fail(ErrorKind::kUnavailable, "{}",
              reply->body.is_object() ? reply->body.value("error", "refused") : "refused");
}

}  // namespace omnihdr
