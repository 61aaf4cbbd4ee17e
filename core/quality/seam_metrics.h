#pragma once

#include <cstddef>
#include <cstdint>
#include <limits>

#include "core/image/image.h"
#include "core/quality/comparison_area.h"

namespace omnihdr {

// How visible the borders are at which a merged picture changes the views it is made of.
//
// e(p) = ln L_tested(p) − ln L_truth(p) has no steps of its own. At a border between two
// neighbouring pixels of different sources the means of e over up to 3×5 pixels of each side with
// that side's sources are compared: their difference is the border's step. Borders without at least
// 9 such pixels on each side are no lines an eye could follow and do not count. In units of noise
// the square of a step is ((difference)² − s²(1/n + 1/m)) / s², s² the variance of e within the two
// sides and n and m their pixels: 0 on average where nothing but noise changes.
struct SeamErrors {
  std::size_t borders = 0;  // pairs of pixels that count
  // Root of the mean of those squares over all borders, less their mean beside the borders, inside
  // one set of sources, where e has steps of another cause; 0 when that is more. NaN without
  // borders.
  double excess_noise = std::numeric_limits<double>::quiet_NaN();
  // The same of the plain steps, in log10 of luminance: what remains above noise and beside.
  double excess_log10 = std::numeric_limits<double>::quiet_NaN();
  // Share of the borders whose step is more than one unit of noise, less the share beside them.
  double visible = std::numeric_limits<double>::quiet_NaN();
};

// `tested` and `truth`: W×H×3 or more channels (RGB first), NaN or 0 = unknown. `sources`: W×H, a
// value for every set of contributing views. Rows wrap round when `wraps` (panorama). Every border
// counts by the area's weight of its row.
SeamErrors FindSeams(ImageView<const float> tested, ImageView<const float> truth,
                     ImageView<const std::uint8_t> sources, const ComparisonArea& area, bool wraps);

}  // namespace omnihdr
