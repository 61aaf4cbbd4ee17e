#pragma once

#include "core/image/image_io.h"
#include "core/photometry/noise_model.h"

namespace omnihdr {

// Read noise of a frame (8-bit code values rms), measured on the frame itself: the residual of a
// mask that cancels planes (Immerkaer 1996) over small blocks of dark pixels, lower quartile over
// the blocks so that texture does not count, less shot noise and quantisation as `model` has them.
// Falls back to kTypicalReadNoise where the frame has too few dark blocks. `black` and 16-bit
// values in 8-bit units; `bits` are the significant bits of a 16-bit frame. Deterministic.
inline constexpr double kTypicalReadNoise = 0.5;
double EstimateReadNoise(const DecodedImage& image, int bits, double black,
                         const NoiseModel& model);

}  // namespace omnihdr
