#pragma once

#include <span>

#include "core/base/result.h"
#include "core/base/units.h"
#include "core/image/image.h"
#include "core/image/image_io.h"
#include "core/photometry/measurement.h"
#include "core/photometry/noise_model.h"
#include "core/photometry/response.h"
#include "core/sphere/projection.h"

namespace omnihdr {

// One picture and how long it was exposed. The picture is borrowed.
struct ExposedFrame {
  const DecodedImage* image = nullptr;
  Exposure exposure;
};

struct MeasureOptions {
  // Usable range of pixel values in 8-bit units (thesis 5.2.2). Above `value_high` in any channel
  // the pixel is saturated (its colour is not to be trusted); below `value_low` a channel is dark.
  double value_low = 10.0;
  double value_high = 245.0;
  NoiseModel noise;
};

// Merges the frames taken at one place (one frame, or a bracket taken standing still: temporal HDR)
// into one measurement: per pixel and channel the inverse-variance mean of E = f⁻¹(Z)/t over the
// frames in which the pixel is usable, the variance being that of the signal the frames agree on
// (Granados et al. 2010), not of the single noisy value, so that noise does not bias the weights. A
// pixel saturated in every frame reads the shortest exposure's value and is flagged; one dark in
// every frame reads the longest exposure's value and is flagged. Law: the order of frames does not
// matter (to rounding). `bits`: significant bits of 16-bit images (ignored for 8). `mask`: empty,
// or the frames' size, 0 = do not use. Errors: no frames, sizes that differ, channels other than 1
// or 3, an exposure that is not positive and finite.
Result<Measurement> Measure(std::span<const ExposedFrame> frames, const Projection& projection,
                            const Response& response, int bits, ImageView<const std::uint8_t> mask,
                            const MeasureOptions& options);

}  // namespace omnihdr
