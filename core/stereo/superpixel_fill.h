#pragma once

#include <Eigen/Geometry>
#include <cstdint>

#include "core/image/image.h"
#include "core/photometry/measurement.h"
#include "core/stereo/sgm.h"
#include "core/stereo/slic.h"
#include "core/stereo/stereo_view.h"

namespace omnihdr {

// Radiance of a position on the lat-long grid of its disparity map (world-aligned), W×H×3; NaN
// where masked.
Image<float> MapRadiance(const Measurement& measurement,
                         const Eigen::Quaterniond& world_from_camera, int width);

// Radiance as three 8-bit channels in which equal steps are about equally visible: log luminance on
// `scale`, and the logs of red over green and of blue over green, 128 = grey. Masked reads 0, 128,
// 128.
Image<std::uint8_t> LogColours(const Image<float>& radiance, const LogScale& scale);

// Fills holes by inverse distance weighting (power 2) from the known pixels of the same superpixel
// alone, so that nothing flows across an outline (thesis 5.3.2). A superpixel without a known pixel
// stays a hole. Confidence of a filled pixel is 0.
void FillSuperpixels(const Superpixels& superpixels, DisparityMap* map);

// The thesis's colour model of the sky (eqs. 5.11 to 5.15): brighter than the mean over the sphere,
// and of the chromaticities r, g, b: r < g, r < b, 0.25 < r < 0.32, |g − b| < 0.04. W×H, 1 = sky.
// Colours are those of the sensor after white balance; a saturated sky is white and is not found.
Image<std::uint8_t> FindSky(const Image<float>& radiance);

// Superpixels of which at least `least_share` is sky lie at infinity: disparity 0, the smallest
// there is, confidence 0.5. Returns how many there were.
int PutSkyAtInfinity(const Superpixels& superpixels, const Image<std::uint8_t>& sky,
                     double least_share, DisparityMap* map);

}  // namespace omnihdr
