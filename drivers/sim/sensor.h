#pragma once

#include <cstdint>

#include "core/base/result.h"
#include "core/base/units.h"
#include "core/image/image.h"

namespace omnihdr::sim {

// A linear 8-bit sensor: value 128 for radiance 1.0 at 1 s and 0 dB, 255 (or `white`) when full.
struct SensorOptions {
  double full_well_e = 20000.0;  // electrons at value 255 and 0 dB: photon noise, 100 to 1e7
  double read_noise = 0.5;  // rms code values at 0 dB, 0 to 20; amplified by gain like the signal
  double prnu = 0.003;      // spread of the pixels' sensitivity, a fraction, 0 to 0.1
  double white = 255.0;     // value that the analog side clips at, 64 to 255
  std::uint64_t seed = 1;   // of the noise
  Status Validate() const;  // kConfig error naming the option and its range
};

// Turns radiance (W×H×3) into pixel values: photon noise, read noise, fixed pattern, clipping,
// rounding. Law: the result depends only on the arguments; `frame` gives each picture noise of its
// own. Variance of a value Z between the clips: gain·(255/full_well)·Z + (gain·read_noise)² +
// (prnu·Z)² + 1/12, with gain = 10^(dB/20). Uses the worker pool.
Image<std::uint8_t> Expose(ImageView<const float> radiance, const Exposure& exposure,
                           const SensorOptions& options, std::uint64_t frame);

}  // namespace omnihdr::sim
