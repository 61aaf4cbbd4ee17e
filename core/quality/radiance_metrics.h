#pragma once

#include <limits>

#include "core/image/image.h"
#include "core/quality/comparison_area.h"

namespace omnihdr {

// Luminance (Rec. 709 weights) of W×H×3 or more channels, RGB first → W×H×1.
Image<float> LuminanceOf(ImageView<const float> rgb);

// How far a radiance map is from the truth, in log10 of luminance: 0.301 is a factor of two, one
// stop. e(p) = log10 L_tested(p) − log10 L_truth(p), over the pixels of the area where both are
// finite and positive; averages are weighted by the area's weights. NaN when no pixel can be
// compared.
struct RadianceErrors {
  // Factor on the tested map that makes the median of e zero, or 1 when none is fitted (one factor
  // for the whole picture: relative radiance has no absolute scale).
  double scale = std::numeric_limits<double>::quiet_NaN();
  double log10_rmse = std::numeric_limits<double>::quiet_NaN();  // of scale · tested
  // Percentiles of |e| after scale: the median, 95 %, 99 % and the largest.
  double log10_p50 = std::numeric_limits<double>::quiet_NaN();
  double log10_p95 = std::numeric_limits<double>::quiet_NaN();
  double log10_p99 = std::numeric_limits<double>::quiet_NaN();
  double log10_max = std::numeric_limits<double>::quiet_NaN();
  double log10_rmse_unscaled = std::numeric_limits<double>::quiet_NaN();  // of tested as it is
  // Share of the area's weight that could be compared: what is missing from 1 is unknown in the
  // tested map or the truth.
  double compared = 0.0;
};
// The factor on the tested map: the one above, or 1.
enum class ScaleFit { kMedian, kNone };
// Both W×H×3 or more channels (RGB first), of equal size. NaN = unknown.
RadianceErrors CompareRadiance(ImageView<const float> tested, ImageView<const float> truth,
                               const ComparisonArea& area, ScaleFit fit = ScaleFit::kMedian);

}  // namespace omnihdr
