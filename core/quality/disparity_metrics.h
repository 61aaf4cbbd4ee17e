#pragma once

#include <limits>
#include <numbers>

#include "core/image/image.h"
#include "core/quality/comparison_area.h"

namespace omnihdr {

// Radians: a pixel of a panorama 1536 wide. An error Δd moves a point seen at a right angle to a
// baseline b by Δd·b.
inline constexpr double kOnePixelOfParallax = 2.0 * std::numbers::pi / 1536.0;

// How far a disparity map (1/distance; 0 = infinity; NaN = unknown) is from the truth. Averages are
// weighted by the area's weights; pixels without truth do not count.
struct DisparityErrors {
  // Share of the area that is unknown or off by more than one pixel of parallax.
  double bad1 = std::numeric_limits<double>::quiet_NaN();
  // The same share among the pixels that are known.
  double bad1_of_known = std::numeric_limits<double>::quiet_NaN();
  double unknown = std::numeric_limits<double>::quiet_NaN();  // share of the area without a value
  // Median of |d − d_truth| / d_truth over known pixels with d_truth > 0.
  double median_relative = std::numeric_limits<double>::quiet_NaN();
};
// Both W×H×1, of equal size and in 1/(the unit of `baseline`). `baseline`: mean distance to the
// neighbouring positions.
DisparityErrors CompareDisparity(ImageView<const float> tested, ImageView<const float> truth,
                                 double baseline, const ComparisonArea& area);

}  // namespace omnihdr
