#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <vector>

#include "core/base/large_memory.h"
#include "core/image/image.h"
#include "core/photometry/measurement.h"

namespace omnihdr {

// How log radiance becomes an 8-bit code, common to every view that is to be compared.
struct LogScale {
  float floor = 1e-6F;      // added to a radiance before its logarithm: noise below it is flattened
  float ln_black = -14.0F;  // ln(E + floor) of code 1
  float codes_per_ln =
      20.0F;  // code = 1 + (ln(E + floor) - ln_black)·codes_per_ln, clamped to 1..254
  // Codes of a log-luminance derivative (over one pixel of a map) per unit. More tells weaker
  // texture apart, where noise leaves any: pictures of little noise are matched better with 200.
  float gradient_codes_per_ln = 60.0F;
  // A scale from the lowest noise floor to the highest saturation among the views.
  static LogScale For(float lowest_noise_floor, float highest_saturation);
  bool operator==(const LogScale&) const = default;
};

// One position's panorama prepared for matching: an equirectangular lattice of directions in the
// world frame ("rotationally aligned", so that only translation is left between views), each texel
// an interval per lane, eight bytes:
//   R lo, R hi, B lo, B hi    log radiance; lo = hi for a measured value, hi = 255 where saturated
//   (the
//                             truth is at least lo), lo = 0 where dark (at most hi)
//   gx lo, gx hi, gy lo, gy hi  horizontal and vertical log-luminance derivative, 128 = flat; of
//                             the channels that both sides have measured, 0..255 where there is
//                             none
// An impossible R interval (lo > hi) marks a texel that says nothing (masked, not covered).
// Texel (i, j) looks along equirectangular image point (x = j, y = i) of a lattice of `width`
// columns and `height` rows: not the pixel centre, so that every centre of a map of half that size
// is a texel. Row `height` (the south pole) exists, and column `width` repeats column 0.
struct StereoView {
  int width = 0;
  int height = 0;
  std::vector<std::uint64_t, LargeAllocator<std::uint64_t>>
      texels;  // (height + 1) rows of (width + 1)
  const std::uint64_t* row(int i) const {
    return texels.data() + static_cast<std::ptrdiff_t>(i) * (width + 1);
  }
};

// `world_from_camera` rotates the measurement into the world frame.
StereoView MakeStereoView(const Measurement& measurement,
                          const Eigen::Quaterniond& world_from_camera, int width,
                          const LogScale& scale);

// The view on a lattice of half the size: of each interval the mean over the texels around, ends
// for themselves, which is what the mean radiance (geometric) lies between.
StereoView HalveStereoView(const StereoView& view);

// The measurement reduced to half size (2×2 means of what is usable; flags where any was set).
Measurement HalveMeasurement(const Measurement& measurement);

}  // namespace omnihdr
