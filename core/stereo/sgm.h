#pragma once

#include <cstdint>
#include <vector>

#include "core/image/image.h"
#include "core/stereo/stereo_view.h"
#include "core/stereo/sweep.h"

namespace omnihdr {

struct SgmOptions {
  int small_penalty = 6;         // P1: a change of one label
  int large_penalty = 60;        // P2: any larger change, on a flat surface
  int least_large_penalty = 18;  // P2 across the strongest edge
};

// A disparity map: lat-long in the world frame ("rotationally aligned"), centred on its view.
struct DisparityMap {
  Image<float> disparity;   // 1/r; NaN = unknown
  Image<float> confidence;  // 0..1, a score: confidence.h tells what it is worth
};

// Semi-global matching (Hirschmueller 2008) on the sphere, four paths; rows close round the globe.
// The large penalty falls with the reference's own log-luminance edges. Sub-pixel by a parabola
// through the sums; confidence from the margin of the best label over the best that is not its
// neighbour.
DisparityMap OptimiseSemiGlobal(const CostVolume& volume, const StereoView& reference,
                                const SgmOptions& options);
// The same with the brightness of the map's pixels, in codes, to find the edges by.
DisparityMap OptimiseSemiGlobal(const CostVolume& volume, const Image<std::uint8_t>& brightness,
                                const SgmOptions& options);

// Brightness (log code) of a stereo view at the pixel centres of its map: the mean of the lower
// ends of its two colour lanes.
Image<std::uint8_t> MapBrightness(const StereoView& view);

}  // namespace omnihdr
