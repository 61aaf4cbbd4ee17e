#pragma once

#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "drivers/v4l2/exposure_control.h"
#include "drivers/v4l2/stream.h"

namespace omnihdr::v4l2 {

inline constexpr int kMaxLatency = 8;  // frames; what is slower cannot be measured

// The brightness of the frames after a step of the exposure, the first being the next one after it;
// frames that were lost or damaged are missing. `stops` = how much brighter (below 0: darker) the
// step makes them. Returns the number of the first frame that has the new brightness and is
// followed by such frames only; nothing when brightness does not follow or ends in no steady value.
struct StepSample {
  int frame = 0;  // from 1
  double level = 0.0;
};
std::optional<int> FindLatency(double level_before, std::span<const StepSample> after,
                               double stops);

// Whether a picture's brightness followed a step of the exposure. Nothing when the step is too
// small or a level says too little.
std::optional<bool> BrightnessFollowed(const Level& before, const Level& after, double stops);

struct LatencyMeasurement {
  std::optional<int> frames;  // from the write to the first frame it acts on; 1 = the next one
  int least = 1;              // the same, at the earliest
  std::string why_not;        // when not measured
  int steps = 0;
};
// Steps the exposure of a running stream up and down and sees when brightness follows. Takes about
// 80 frames; ends at `deadline` at the latest. Errors are of the device; a scene that does not
// allow it is a measurement without an answer.
Result<LatencyMeasurement> MeasureLatency(Stream& stream, const FrameLayout& layout,
                                          ExposureControl& control, const Clock& clock,
                                          Nanoseconds longest_wait, HostTime deadline);

}  // namespace omnihdr::v4l2
