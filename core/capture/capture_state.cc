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
    case CaptureState::kCapturing:
      return "capturing";
  }
  return "unknown";
}

StateReport EvaluateState(const CaptureConditions& c) {
  constexpr const char* kNothing = "nothing to do";
  if (!c.stopping.empty()) {
    return {CaptureState::kStopping, c.stopping, "wait; a second SIGTERM does not wait for views"};
  }
  if (!c.fault.empty()) {
    return {CaptureState::kFault, c.fault,
            "put right what the reason names, in the configuration or at the camera; what is not "
            "taken up by itself needs a restart of omnihdrd"};
  }
  if (!c.started) return {CaptureState::kStarting, "starting", "wait"};
  if (!c.storage.empty()) {
    return {CaptureState::kStorageFull, c.storage,
            "make room on the volume of the session, or mend it; pictures are stored again by "
            "themselves"};
  }
  if (!c.camera_ready) {
    return {CaptureState::kWaitingForCamera, c.waiting.empty() ? "opening the camera" : c.waiting,
            "see that the camera is plugged in and has power (omnihdr camera list); it is taken up "
            "by itself"};
  }
  if (!c.armed) {
    return {CaptureState::kIdle, c.idle.empty() ? "disarmed" : c.idle,
            c.ended          ? "a new session begins with a restart of omnihdrd"
            : c.idle.empty() ? "omnihdr arm"
                             : "put right what the reason names, then omnihdr arm"};
  }
  std::string degraded;
  std::string remedy;
  const auto add = [&](const std::string& condition, const char* what) {
    if (condition.empty()) return;
    degraded += (degraded.empty() ? "" : "; ") + condition;
    remedy += (remedy.empty() ? "" : "; ") + std::string(what);
  };
  add(c.frames_lost,
      "drive slower or trigger less often when the camera was busy, else look at the camera and "
      "its cable");
  add(c.views_stalled, "make room where the views are written; they go on by themselves");
  add(c.storage_low, "see to room on the volume of the session before it is full (omnihdr doctor)");
  add(c.links, "look at the connection that is named; it is made again by itself");
  add(c.orientation,
      "compare order and rotations of the rig file's sensors with the head, and a picture of a "
      "text "
      "(omnihdr calibrate verify); frames are kept and can be processed with the right rig.toml");
  if (!degraded.empty()) return {CaptureState::kDegraded, degraded, remedy};
  if (c.capturing) return {CaptureState::kCapturing, "pictures are being taken", kNothing};
  return {CaptureState::kArmed, "every trigger takes a picture", kNothing};
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
