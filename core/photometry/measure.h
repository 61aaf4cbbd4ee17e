#pragma once

#include <array>
#include <span>

#include "core/base/result.h"
#include "core/base/units.h"
#include "core/image/image.h"
#include "core/image/image_io.h"
#include "core/photometry/demosaic.h"
#include "core/photometry/measurement.h"
#include "core/photometry/merge_rows.h"
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
  MergeWeights weights = MergeWeights::kInverseVariance;
  // Gains on the radiance of R, G, B, positive: what makes a neutral surface neutral.
  std::array<double, 3> white_balance = {1.0, 1.0, 1.0};
  // Of the Bayer mosaics of a rig (Stitcher); finished pictures do not need it.
  Demosaic demosaic = Demosaic::kBilinear;
};

// Whether frames can be merged: what Measure refuses, without measuring.
Status CheckFrames(std::span<const ExposedFrame> frames, ImageView<const std::uint8_t> mask);

// Merges the frames taken at one place (one frame, or a bracket taken standing still: temporal HDR)
// into one measurement: per pixel and channel the weighted mean of E = f⁻¹(Z)/t over the frames in
// which the pixel is usable. Weights: by default the inverse variance, that of the signal the
// frames agree on (Granados et al. 2010), not of the single noisy value, so that noise does not
// bias the weights; or the hat of the thesis. A pixel saturated in every frame reads the shortest
// exposure's value, a lower bound, and is flagged; one dark in every frame reads the longest
// exposure's value (of those not saturated) and is flagged. Law: radiance is finite and not
// negative whatever the frames show, and the order of frames does not matter (to rounding). `bits`:
// significant bits of 16-bit images (ignored for 8). `mask`: empty, or the frames' size, below 128
// = do not use. Errors: no frames, sizes that differ, channels other than 1 or 3, an exposure that
// is not positive and finite.
Result<Measurement> Measure(std::span<const ExposedFrame> frames, const Projection& projection,
                            const Response& response, int bits, ImageView<const std::uint8_t> mask,
                            const MeasureOptions& options);

}  // namespace omnihdr
