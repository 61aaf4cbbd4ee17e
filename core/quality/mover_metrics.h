#pragma once

#include <cstddef>
#include <limits>
#include <span>

#include "core/image/image.h"
#include "core/quality/comparison_area.h"

namespace omnihdr {

// What a pixel may show where something moved: the scene at one instant.
struct Instance {
  ImageView<const float> radiance;        // W×H×3 or more channels, RGB first; NaN = not known
  ImageView<const std::uint8_t> allowed;  // W×H, non-zero = accepted there; empty = everywhere
};

struct InstanceErrors {
  // Share of the area's weight whose luminance is off by more than the limit from every instance
  // accepted there: it shows none of them, but a blend. An instance is all between the least and
  // the largest luminance that it has at the pixel and its eight neighbours: resampling a picture
  // moves edges by up to a pixel. NaN for an empty area.
  double share_off = std::numeric_limits<double>::quiet_NaN();
  double weight = 0.0;  // of the area: those of its pixels where an accepted instance is known
  std::size_t pixels = 0;
};

// `tested`: W×H×3 or more channels, multiplied by `scale`; a pixel without a positive value is off.
// `limit_log10`: of the distance of log10 L_tested from that interval; 0.3 is a factor of two.
// Columns wrap round when `wraps` (panorama).
InstanceErrors CompareInstances(ImageView<const float> tested, double scale,
                                std::span<const Instance> instances, double limit_log10,
                                const ComparisonArea& area, bool wraps);

}  // namespace omnihdr
