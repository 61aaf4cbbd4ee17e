#include "core/capture/capture_state.h"

namespace omnihdr {

std::string_view ToString(CaptureState state) {
  switch (state) {
    case CaptureState::kStarting:
      return "starting";
    case CaptureState::kWaitingForCamera:
      return "waiting-for-camera";
    case CaptureState::kIdle:
      return "idle";
    case CaptureState::kArmed:
      return "armed";
    case CaptureState::kDegraded:
      return "degraded";
    case CaptureState::kStorageFull:
      return "storage-full";
    case CaptureState::kFault:
      return "fault";
    case CaptureState::kStopping:
      return "stopping";
  }
  return "unknown";
}

StateReport EvaluateState(const CaptureConditions& c) {
  if (!c.stopping.empty()) return {CaptureState::kStopping, c.stopping};
  if (!c.fault.empty()) return {CaptureState::kFault, c.fault};
  if (!c.started) return {CaptureState::kStarting, "starting"};
  if (!c.storage.empty()) return {CaptureState::kStorageFull, c.storage};
  if (!c.camera_ready) {
    return {CaptureState::kWaitingForCamera, c.waiting.empty() ? "opening the camera" : c.waiting};
  }
  if (!c.armed) return {CaptureState::kIdle, c.idle.empty() ? "disarmed" : c.idle};
  std::string degraded;
  for (const std::string* condition :
       {&c.frames_lost, &c.views_stalled, &c.storage_low, &c.links}) {
    if (!degraded.empty() && !condition->empty()) degraded += "; ";
    degraded += *condition;
  }
  if (!degraded.empty()) return {CaptureState::kDegraded, degraded};
  return {CaptureState::kArmed, "every trigger takes a picture"};
}

void CaptureStateMachine::Update(const std::function<void(CaptureConditions&)>& change) {
  StateReport report;
  {
    std::lock_guard lock(mutex_);
    change(conditions_);
    report = EvaluateState(conditions_);
    if (report == report_) return;
    report_ = report;
  }
  if (listener_) listener_(report);
}

StateReport CaptureStateMachine::report() const {
  std::lock_guard lock(mutex_);
  return report_;
}

CaptureConditions CaptureStateMachine::conditions() const {
  std::lock_guard lock(mutex_);
  return conditions_;
}

}  // namespace omnihdr
