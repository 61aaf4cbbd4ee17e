#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <mutex>
#include <optional>
#include <string_view>

#include "core/base/clock.h"
#include "core/base/units.h"

namespace omnihdr {

// From one end of a stage to the other.
enum class CaptureLatency {
  kEdgeToCommand,   // the trigger's event to the command that the camera got
  kCommandToFrame,  // that command to the arrival of its frame
  kFrameToDurable,  // that arrival to the frame's line on disk
  kTriggerToView,   // the first trigger of a position to its finished view
  // The parts of that view's work.
  kViewPose,
  kViewStereo,
  kViewMerge,
  kViewWrite,
};
inline constexpr std::size_t kCaptureLatencyCount = 8;
std::string_view ToString(CaptureLatency latency);  // "edge_to_command", ..., "view_write"

// How often a duration was how long: counts up to each bound, in seconds, and beyond the last.
struct LatencyCounts {
  static constexpr std::array<double, 16> kBounds = {0.0001, 0.0005, 0.001, 0.0025, 0.005, 0.01,
                                                     0.025,  0.05,   0.1,   0.25,   0.5,   1.0,
                                                     2.5,    10.0,   60.0,  600.0};
  std::array<std::uint64_t, kBounds.size() + 1> counts{};
  double sum_s = 0.0;
  std::uint64_t total = 0;

  void Add(Nanoseconds duration);  // less than none counts as none
};
using CaptureLatencies = std::array<LatencyCounts, kCaptureLatencyCount>;

// Follows triggers through the appliance and counts how long each stage took. What it remembers is
// bounded: a trigger or a position that is forgotten before its end is not counted. Any thread.
class LatencyTracker {
 public:
  static constexpr std::size_t kMaxTriggers = 4096;
  static constexpr std::size_t kMaxPositions = 65536;
  static constexpr std::size_t kMaxEarly = 64;

  void Commanded(TriggerId trigger, HostTime edge, HostTime now);
  void FrameArrived(TriggerId trigger, HostTime now);
  // The line of a trigger is durable; `usable` = with pixels.
  void Durable(TriggerId trigger, PositionId position, bool usable, HostTime now);
  void ViewDone(PositionId position, HostTime now);
  // A part of a view's work.
  void Took(CaptureLatency part, double seconds);

  CaptureLatencies counts() const;
  // When the newest frame arrived.
  std::optional<HostTime> last_frame() const;

 private:
  struct Times {
    HostTime edge;
    std::optional<HostTime> commanded;
    std::optional<HostTime> arrived;
  };
  void Bound();
  LatencyCounts& Of(CaptureLatency latency) { return counts_[static_cast<std::size_t>(latency)]; }

  mutable std::mutex mutex_;
  std::map<std::uint64_t, Times> triggers_;
  std::map<std::int64_t, HostTime> positions_;  // first trigger of those without a view
  // When views were done whose line has not been told of: one sync can make several lines durable,
  // and the last of them may be worked on before it is told of.
  std::map<std::int64_t, HostTime> done_early_;
  CaptureLatencies counts_;
  std::optional<HostTime> last_frame_;
};

}  // namespace omnihdr
