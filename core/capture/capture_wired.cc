#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <utility>

#include "core/capture/capture_controller.h"

// What the controller does for a camera that hangs on the trigger's wire.
namespace omnihdr {
namespace {

// Frames that may wait for their edge; of more, the oldest is taken without one.
constexpr std::size_t kMostWaitingFrames = 4;

}  // namespace

void CaptureController::SetArmed(bool armed) {
  std::lock_guard lock(mutex_);
  if (!armed) {
    armed_since_.reset();
  } else if (!armed_since_) {
    armed_since_ = clock_.Now();
  }
}

void CaptureController::ObserveEdge(const ExposureRequest& request, HostTime earliest) {
  const HostTime latest = request.trigger_time;
  last_edge_ = latest;
  if (!sink_.TryReserveBuffer()) {
    OpenMissed(request, MissReason::kNoBuffer,
               "no free frame buffer: the storage is slower than the triggers");
  } else if (Status told = command_(request); !told) {
    sink_.ReleaseBuffer();
    OpenMissed(request, ReasonOf(told.error().kind), told.error().message);
    // Without a camera there is no frame that could be taken for it.
    if (told.error().kind == ErrorKind::kUnavailable) return;
  } else {
    ledger_.Open(request, FrameDeadline(request), true);
  }
  // A frame that cannot be kept is known by its edge all the same.
  edges_.AddEdge(request.trigger, earliest, latest);
}

void CaptureController::ObserveLostEdge(HostTime time, const std::string& reason) {
  const HostTime earliest = std::min(last_edge_, time);
  TriggerEvent event;
  event.time = time;
  ExposureRequest request = NextRequest(event);
  request.odometer_m.reset();
  request.unseen_edge =
      fmt::format("the trigger source lost this edge{}{}", reason.empty() ? "" : ": ", reason);
  ObserveEdge(request, earliest);
}

std::optional<TriggerId> CaptureController::OnWiredFrame(CameraFrame frame, std::uint64_t gap) {
  std::optional<TriggerId> trigger;
  if (const auto match = edges_.Take(frame.wired->at, frame.wired->error)) {
    trigger = match->trigger;
    TakePaired(std::move(frame), *match, gap);
  } else if (!armed_since_ || frame.wired->at + frame.wired->error < *armed_since_) {
    ++counts_.frames_disarmed;
  } else {
    if (waiting_frames_.size() >= kMostWaitingFrames) {
      GiveUpWaitingFrames(waiting_frames_.front().until);
    }
    waiting_frames_.push_back({std::move(frame), gap, clock_.Now() + options_.edge_patience});
  }
  SubmitEnded();
  return trigger;
}

void CaptureController::PairWaitingFrames() {
  for (auto waiting = waiting_frames_.begin(); waiting != waiting_frames_.end();) {
    const WiredStart start = *waiting->frame.wired;
    const auto match = edges_.Take(start.at, start.error);
    if (!match) {
      ++waiting;
      continue;
    }
    TakePaired(std::move(waiting->frame), *match, waiting->gap);
    waiting = waiting_frames_.erase(waiting);
  }
}

void CaptureController::GiveUpWaitingFrames(HostTime until) {
  while (!waiting_frames_.empty() && waiting_frames_.front().until <= until) {
    CameraFrame frame = std::move(waiting_frames_.front().frame);
    waiting_frames_.pop_front();
    TakeWithoutEdge(std::move(frame));
  }
}

void CaptureController::TakePaired(CameraFrame frame, const EdgePairing::Match& match,
                                   std::uint64_t gap) {
  // Frames come in order: those of the edges before will not come any more.
  for (const TriggerId passed : match.passed) {
    if (ledger_.FindOpen(passed) == nullptr) continue;
    ++counts_.edges_without_frame;
    if (gap == 0) {
      ++counts_.missed[static_cast<std::size_t>(MissReason::kNotExposed)];
      ledger_.Resolve(passed, FrameStatus::kMissedTrigger,
                      "the camera took no picture at this edge: its counter has no gap",
                      std::nullopt);
    } else {
      ledger_.Resolve(
          passed, FrameStatus::kCameraTimeout,
          fmt::format("no frame for this edge: the camera's counter says that {} of {} "
                      "frames were lost on their way",
                      std::min<std::uint64_t>(gap, match.passed.size()), match.passed.size()),
          std::nullopt);
    }
  }
  frame.trigger = match.trigger;
  TakeFrame(std::move(frame));
}

void CaptureController::TakeWithoutEdge(CameraFrame frame) {
  if (!sink_.TryReserveLine()) {
    ++counts_.refused;
    return;
  }
  ++counts_.frames_without_edge;
  TriggerEvent event;
  event.time = frame.wired->at;
  ExposureRequest request = NextRequest(event);
  request.unseen_edge = "no edge was seen for this frame: its time is the camera's";
  if (!sink_.TryReserveBuffer()) {
    OpenMissed(request, MissReason::kNoBuffer,
               "no free frame buffer: the storage is slower than the triggers");
    return;
  }
  ledger_.Open(request, FrameDeadline(request), true);
  frame.trigger = request.trigger;
  TakeFrame(std::move(frame));
}

// The next pulse takes the step behind this one in the camera's cycle: so does the plan.
void CaptureController::FollowCycle(const ExposureRequest& request, int step) {
  const Planned* planned = FindPlanned(request.trigger);
  // One before it has put the plan off already.
  if (planned == nullptr || planned->retakes != retakes_) return;
  for (std::uint64_t back = 1; back < plan_.Period() && back <= planned->index; ++back) {
    if (plan_.StepForTrigger(TriggerId{planned->index - back}) != step) continue;
    retakes_ += back;
    return;
  }
}

bool CaptureController::TakeAsAnotherStep(const ExposureRequest& request,
                                          const CameraFrame& frame) {
  const std::vector<ExposureTime>& steps = plan_.exposures();
  for (std::size_t step = 0; step < steps.size(); ++step) {
    const Exposure exposure{steps[step], request.exposure.gain};
    if (!VerifyExposure(exposure, frame.measured_exposure, frame.proof, options_.tolerance)
             .usable) {
      continue;
    }
    if (frame.wired && frame.cycled) {
      FollowCycle(request, static_cast<int>(step));
    } else {
      // Its own step is due still.
      [[maybe_unused]] const bool again = TakeAgain(request);
    }
    if (Planned* planned = FindPlanned(request.trigger)) planned->step = static_cast<int>(step);
    return true;
  }
  return false;
}

}  // namespace omnihdr
