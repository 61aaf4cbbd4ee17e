#include "drivers/iidc/camera_clock.h"

#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <limits>

#include "drivers/iidc/frame_info.h"

namespace omnihdr::iidc {

CameraTime CameraClock::Unwrap(std::int64_t cycle_ns, HostTime arrived) {
  if (last_cycle_ns_) {
    // Whole turns of the counter since the frame before, as the host's clock tells them.
    const std::int64_t elapsed = (arrived - last_arrived_).count();
    std::int64_t step = (cycle_ns - *last_cycle_ns_) % kCycleTimeWrap;
    const auto turns =
        std::llround(static_cast<double>(elapsed - step) / static_cast<double>(kCycleTimeWrap));
    step += turns * kCycleTimeWrap;
    last_camera_ns_ += step;
  } else {
    last_camera_ns_ = cycle_ns;
  }
  last_cycle_ns_ = cycle_ns;
  last_arrived_ = arrived;
  return CameraTime::FromNanoseconds(last_camera_ns_);
}

bool CameraClock::Contradict(const Bounds& added, const std::deque<Bounds>& frames) {
  if (frames.empty()) return false;
  const Bounds known = At(frames, added.camera);
  return added.high_ns < known.low_ns || added.low_ns > known.high_ns;
}

void CameraClock::Add(CameraTime camera, HostTime earliest, HostTime latest) {
  const Bounds added{camera, earliest.ns() - camera.ns(), latest.ns() - camera.ns()};
  if (Contradict(added, frames_)) {
    if (Contradict(added, suspects_)) {
      outliers_ += suspects_.size();
      suspects_.clear();
    }
    suspects_.push_back(added);
    if (suspects_.size() < kJumpFrames) return;
    frames_.swap(suspects_);
    suspects_.clear();
    ++jumps_;
    return;
  }
  outliers_ += suspects_.size();
  suspects_.clear();
  frames_.push_back(added);
  if (frames_.size() > kMaxFrames) frames_.pop_front();
}

CameraClock::Bounds CameraClock::At(const std::deque<Bounds>& frames, CameraTime camera) {
  Bounds all{camera, std::numeric_limits<std::int64_t>::min(),
             std::numeric_limits<std::int64_t>::max()};
  for (const Bounds& frame : frames) {
    const double age = std::abs(static_cast<double>((camera - frame.camera).count()));
    const auto drift = static_cast<std::int64_t>(std::ceil(age * kMaxDriftPpm * 1e-6));
    all.low_ns = std::max(all.low_ns, frame.low_ns - drift);
    all.high_ns = std::min(all.high_ns, frame.high_ns + drift);
  }
  return all;
}

std::optional<HostTime> CameraClock::ToHost(CameraTime camera) const {
  if (frames_.empty() || !suspects_.empty()) return std::nullopt;
  const Bounds range = At(frames_, camera);
  return HostTime::FromNanoseconds(camera.ns() + range.low_ns + (range.high_ns - range.low_ns) / 2);
}

Nanoseconds CameraClock::uncertainty(CameraTime camera) const {
  if (frames_.empty()) return Nanoseconds(0);
  const Bounds range = At(frames_, camera);
  return Nanoseconds(std::max<std::int64_t>(0, (range.high_ns - range.low_ns + 1) / 2));
}

void CameraClock::Reset() {
  frames_.clear();
  suspects_.clear();
  last_cycle_ns_.reset();
}

}  // namespace omnihdr::iidc
