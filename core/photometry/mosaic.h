#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/base/result.h"
#include "core/base/units.h"
#include "core/image/image.h"
#include "core/image/image_io.h"
#include "core/photometry/measure.h"
#include "core/photometry/response.h"
#include "core/sphere/rig.h"

namespace omnihdr {

// One frame of a rig: the sensors' pictures stacked top to bottom in the rig's order, in one image
// of 1 channel (Bayer mosaics, or grey) or 3 (finished colour). The image is borrowed.
struct RigFrame {
  const DecodedImage* image = nullptr;
  // One for all sensors, or one each.
  std::vector<Exposure> exposures;
  const Exposure& ExposureOf(std::size_t sensor) const {
    return exposures.size() == 1 ? exposures.front() : exposures[sensor];
  }
};

// What the frames of one place say of one value of the mosaic. The order is that of the maximum
// taken over the values a pixel is interpolated from: saturated when any of them is, dark when all
// are.
enum MosaicState : std::uint8_t { kMosaicDark = 0, kMosaicUsable = 1, kMosaicSaturated = 2 };

// Noise and range of one sensor's mosaic, in the radiance of its own counts (before gain and
// vignetting), per channel. Variance of a value E: variance_floor + variance_per_radiance·E.
struct MosaicNoise {
  std::array<float, 3> variance_floor{};
  std::array<float, 3> variance_per_radiance{};
  std::array<float, 3> saturation{};  // radiance at which the shortest exposure clips
  double longest_exposure_s = 0.0;
  double shortest_exposure_s = 0.0;
};

// Linear radiance at the sensors, before any interpolation mixes values: a pixel knows by itself
// whether it clipped.
struct RadianceMosaic {
  // The stacked frame's size and channels: relative radiance (1.0 = value 128 at 1 s, 0 dB).
  Image<float> radiance;
  // The same size: a MosaicState each.
  Image<std::uint8_t> state;
  std::vector<MosaicNoise> noise;  // per sensor
};

// Rows of the stacked frame: sensor s occupies [rows[s], rows[s+1]). Errors: the sensors' widths
// differ (they cannot be stacked).
Result<std::vector<int>> StackedRows(const Rig& rig);

// Checks that frames fit the rig and each other: size, channels (1 for a Bayer rig; 1 or 3 without
// Bayer), number and validity of exposures. Errors (kData) name what was found and expected.
Status CheckRigFrames(std::span<const RigFrame> frames, const Rig& rig);

// Noise and range of every sensor, its read noise estimated from the frames where `options` asks
// for it (from the green values of a mosaic alone, since neighbours of another colour are no
// noise). `responses`: one for all sensors or one each. Frames as checked by CheckRigFrames.
std::vector<MosaicNoise> NoiseOfRigFrames(std::span<const RigFrame> frames, const Rig& rig,
                                          std::span<const Response> responses, int bits,
                                          const MeasureOptions& options);

// Linearises and merges the frames of one place value by value, as Measure does for finished
// panoramas: inverse-variance mean over the frames in which the value is usable; saturated in every
// frame = the shortest exposure's value; dark in every unsaturated one = that of the longest of
// them. A mosaic value stands for itself; of finished colour a channel saturated excludes the pixel
// (thesis 5.2.2). `mosaic` is overwritten, its memory used again when the size is the same. Uses
// the worker pool. Errors as CheckRigFrames.
Status MergeMosaic(std::span<const RigFrame> frames, const Rig& rig,
                   std::span<const Response> responses, int bits, const MeasureOptions& options,
                   RadianceMosaic* mosaic);

}  // namespace omnihdr
