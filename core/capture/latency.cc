#include "core/capture/latency.h"

#include <algorithm>
#include <cmath>

namespace omnihdr {

std::string_view ToString(CaptureLatency latency) {
  switch (latency) {
    case CaptureLatency::kEdgeToCommand:
      return "edge_to_command";
    case CaptureLatency::kCommandToFrame:
      return "command_to_frame";
    case CaptureLatency::kFrameToDurable:
      return "frame_to_durable";
    case CaptureLatency::kTriggerToView:
      return "trigger_to_view";
    case CaptureLatency::kViewPose:
      return "view_pose";
    case CaptureLatency::kViewStereo:
      return "view_stereo";
    case CaptureLatency::kViewMerge:
      return "view_merge";
    case CaptureLatency::kViewWrite:
      return "view_write";
  }
  return "?";
}

void LatencyCounts::Add(Nanoseconds duration) {
  const double seconds = std::max(0.0, static_cast<double>(duration.count()) * 1e-9);
  const auto bound = std::lower_bound(kBounds.begin(), kBounds.end(), seconds);
  ++counts[static_cast<std::size_t>(bound - kBounds.begin())];
  sum_s += seconds;
  ++total;
}

void LatencyTracker::Commanded(TriggerId trigger, HostTime edge, HostTime now) {
  std::lock_guard lock(mutex_);
  Of(CaptureLatency::kEdgeToCommand).Add(now - edge);
  Times& times = triggers_[Value(trigger)];
  times.edge = edge;
  times.commanded = now;
  if (times.arrived) Of(CaptureLatency::kCommandToFrame).Add(*times.arrived - now);
  Bound();
}

void LatencyTracker::FrameArrived(TriggerId trigger, HostTime now) {
  std::lock_guard lock(mutex_);
  last_frame_ = now;
  // A quick frame may be here before the command that asked for it has returned.
  Times& times = triggers_[Value(trigger)];
  if (times.arrived) return;
  times.arrived = now;
  if (times.commanded) Of(CaptureLatency::kCommandToFrame).Add(now - *times.commanded);
  Bound();
}

void LatencyTracker::Bound() {
  if (triggers_.size() > kMaxTriggers) triggers_.erase(triggers_.begin());
}

void LatencyTracker::Durable(TriggerId trigger, PositionId position, bool usable, HostTime now) {
  std::lock_guard lock(mutex_);
  const auto found = triggers_.find(Value(trigger));
  if (found == triggers_.end()) return;
  const Times times = found->second;
  triggers_.erase(found);
  if (!usable || !times.commanded) return;
  if (times.arrived) Of(CaptureLatency::kFrameToDurable).Add(now - *times.arrived);
  if (const auto done = done_early_.find(Value(position)); done != done_early_.end()) {
    Of(CaptureLatency::kTriggerToView).Add(done->second - times.edge);
    done_early_.erase(done);
    return;
  }
  positions_.try_emplace(Value(position), times.edge);
  if (positions_.size() > kMaxPositions) positions_.erase(positions_.begin());
}

void LatencyTracker::ViewDone(PositionId position, HostTime now) {
  std::lock_guard lock(mutex_);
  const auto found = positions_.find(Value(position));
  if (found == positions_.end()) {
    done_early_[Value(position)] = now;
    if (done_early_.size() > kMaxEarly) done_early_.erase(done_early_.begin());
    return;
  }
  Of(CaptureLatency::kTriggerToView).Add(now - found->second);
  positions_.erase(found);
}

void LatencyTracker::Took(CaptureLatency part, double seconds) {
  std::lock_guard lock(mutex_);
  Of(part).Add(Nanoseconds(std::llround(seconds * 1e9)));
}

CaptureLatencies LatencyTracker::counts() const {
  std::lock_guard lock(mutex_);
  return counts_;
}

std::optional<HostTime> LatencyTracker::last_frame() const {
  std::lock_guard lock(mutex_);
  return last_frame_;
}

}  // namespace omnihdr
