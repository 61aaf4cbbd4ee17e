#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/sphere/rig.h"
#include "core/sphere/sphere_grid.h"

namespace omnihdr {

// One pixel of the panorama in one sensor. A pixel is interpolated from the block of 4×4 mosaic
// values round it: two columns and two rows of each colour of the tile, so that every colour is
// bilinear at its own (half) density, without a demosaiced picture in between.
//   block    index of the block's first value in the stacked frame
//   packed   bits 0-7, 8-15: the point's place between the middle columns and rows in 1/256;
//            16-29: share of the blend, kFullShare = all; 30, 31: parity of the block's first
//            column and row in the sensor
inline constexpr std::uint32_t kFullShare = (1U << 14U) - 1U;
constexpr std::uint32_t ShareOf(std::uint32_t packed) { return packed >> 16U & kFullShare; }

// Consecutive pixels of a panorama's row that the same sensors see: sensor k's samples are at
// first + k·(x1 − x0) …. Pixels in no segment are seen by nobody.
struct StitchSegment {
  int x0 = 0;
  int x1 = 0;
  std::uint32_t first = 0;
  std::uint8_t count = 0;  // of sensors
  std::array<std::uint8_t, 4> sensors{};
};

// How much a sensor's pixel noise counts in the panorama, averaged over its pixels: mean of
// (share·gain/vignetting)²·Σw² and of share²·gain/vignetting·Σw² (w: the weights of the values
// interpolated), times the part of the panorama. Multiplied by variance_floor and
// variance_per_radiance and summed over sensors they give the panorama's.
struct StitchNoiseGain {
  std::array<double, 3> floor{};
  std::array<double, 3> per_radiance{};
};

// Where every pixel of a panorama comes from; built once for a rig and the grid of a picture in any
// projection. Immutable; thread-safe to read.
struct StitchTable {
  int width = 0;
  int height = 0;
  std::vector<std::vector<StitchSegment>> rows;
  // Samples, with kStitchPadding idle ones at the end.
  std::vector<std::uint32_t> block;
  std::vector<std::uint32_t> packed;
  std::vector<float> shade;                 // 1/vignetting
  std::vector<StitchNoiseGain> noise_gain;  // per sensor
  std::vector<float> largest_shade;         // per sensor
  double covered = 0.0;                     // share of the panorama's pixels
};
inline constexpr std::size_t kStitchPadding = 64;

struct StitchMasks {
  // The stacked frame's size, white (128 and more) = use; empty = all. Blends fade out towards it.
  ImageView<const std::uint8_t> sensors;
  // The panorama's size; cut out as it is, without a feather.
  ImageView<const std::uint8_t> panorama;
};

// At a pixel the sensor that sees it farthest from its own picture's edge (border, mask, end of the
// lens) is in charge; its neighbours fade in over blend_width_deg round the line of equal distance,
// and every share falls to 0 at the sensor's edge. Points at sphere_radius_m along the camera's
// rays: there the pictures meet. Uses the worker pool. Errors: an invalid rig, sensors that cannot
// be stacked, masks of another size.
Result<StitchTable> BuildStitchTable(const Rig& rig, const SphereGrid& grid,
                                     const StitchMasks& masks);

}  // namespace omnihdr
