#include "core/capture/camera_runner.h"

#include <algorithm>
#include <utility>

namespace omnihdr {

CameraRunner::CameraRunner(Camera& camera, const CameraRunnerOptions& options,
                           CameraRunnerEvents events, const Clock& clock)
    : camera_(camera),
      options_(options),
      events_(std::move(events)),
      clock_(clock),
      retry_(options.first_retry),
      next_attempt_(clock.Now()) {}

CameraRunner::~CameraRunner() { Close(); }

void CameraRunner::GoAway(const Error& error) {
  {
    std::lock_guard lock(gate_);
    running_ = false;
    rearm_.clear();
    away_reason_ = error.message;
  }
  if (open_) {
    camera_.Stop();
    camera_.Close();
    open_ = false;
  }
  next_attempt_ = clock_.Now() + retry_;
  retry_ = std::min(retry_ * 2, options_.longest_retry);
  if (events_.away) events_.away(error);
}

Nanoseconds CameraRunner::Turn() {
  if (!open_) {
    const Nanoseconds rest = next_attempt_ - clock_.Now();
    if (rest > Nanoseconds(0)) return rest;
    Result<CameraInfo> info = camera_.Open();
    if (!info) {
      GoAway(info.error());
      return next_attempt_ - clock_.Now();
    }
    open_ = true;
    Status ready = events_.opened ? events_.opened(*info) : Status{};
    if (ready) ready = camera_.Start();
    if (!ready) {
      GoAway(ready.error());
      return next_attempt_ - clock_.Now();
    }
    {
      std::lock_guard lock(gate_);
      running_ = true;
    }
    if (events_.started) events_.started();
    return Nanoseconds(0);
  }
  std::string rearm;
  {
    std::lock_guard lock(gate_);
    rearm.swap(rearm_);
  }
  if (!rearm.empty()) {
    GoAway(Error{ErrorKind::kUnavailable, std::move(rearm)});
    next_attempt_ = clock_.Now();
    return Nanoseconds(0);
  }
  Result<CameraFrame> frame = camera_.Receive(options_.receive_timeout);
  if (frame) {
    // A camera that delivers is well: only then is the patience of the next search short again.
    retry_ = options_.first_retry;
    if (events_.frame) events_.frame(std::move(*frame));
  } else if (frame.error().kind != ErrorKind::kTemporary) {
    GoAway(frame.error());
    return std::max(next_attempt_ - clock_.Now(), Nanoseconds(0));
  }
  return Nanoseconds(0);
}

void CameraRunner::Close() {
  {
    std::lock_guard lock(gate_);
    running_ = false;
    away_reason_ = "the camera is closed";
  }
  if (!open_) return;
  camera_.Stop();
  camera_.Close();
  open_ = false;
}

Status CameraRunner::Command(const ExposureRequest& request) {
  std::lock_guard lock(gate_);
  if (!running_) return Fail(ErrorKind::kUnavailable, "no camera: {}", away_reason_);
  return camera_.Trigger(request);
}

bool CameraRunner::Rearm(std::string reason) {
  std::lock_guard lock(gate_);
  if (!running_ || !rearm_.empty()) return false;
  rearm_ = std::move(reason);
  return true;
}

bool CameraRunner::running() const {
  std::lock_guard lock(gate_);
  return running_;
}

}  // namespace omnihdr
