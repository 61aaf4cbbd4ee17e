#pragma once

#include <array>
#include <cstdint>
#include <span>

#include "core/base/result.h"
#include "core/base/units.h"
#include "core/image/image.h"
#include "core/photometry/noise_model.h"
#include "core/photometry/response.h"
#include "core/sphere/projection.h"

namespace omnihdr {

// Why a pixel of a position is not a plain measurement, as bits. Channel bits are kept apart
// because outdoors blue clips first while red still measures.
enum PixelFlag : std::uint8_t {
  kSaturatedR = 1,  // true radiance is at least the value given
  kSaturatedG = 2,
  kSaturatedB = 4,
  kSaturatedAny = 7,
  kDarkR = 8,  // true radiance is at most about the value given: below the usable range
  kDarkG = 16,
  kDarkB = 32,
  kDarkAny = 56,
  kMasked = 64,  // the user's mask, the vehicle, outside the sensor: says nothing about the scene
  kMover = 128,  // measured, of something that moves, as a person marked: no other position's
};

// What all frames taken at one position say together about the light arriving there, per pixel of
// the panorama and channel: the only form in which pixels travel from here on, whatever the number
// of exposures, their order or the camera's response.
struct Measurement {
  Projection projection;
  // W×H×4, interleaved: linear relative radiance R, G, B (1.0 = value 128 at 1 s, 0 dB) and, in the
  // fourth place, 1 where all three channels are within the usable range, else 0. Saturated
  // channels hold the radiance of the clipping value (a lower bound); masked pixels hold 0.
  Image<float> radiance;
  // W×H×1: PixelFlag bits.
  Image<std::uint8_t> flags;
  // Radiance per channel at which the merged exposures clip: the bound of saturated pixels.
  std::array<float, 3> saturation{};
  // Variance of a measured radiance E (per channel): variance_floor + variance_per_radiance·E, from
  // the noise model of the frames merged here. Exact for one frame; for several, that of the frame
  // used most.
  std::array<float, 3> variance_floor{};
  std::array<float, 3> variance_per_radiance{};
  // The radiance below which noise hides the signal (SNR 1), for log-scaled pictures.
  float noise_floor = 0.0F;
  // Longest and shortest t·gain merged here, in seconds at 0 dB.
  double longest_exposure_s = 0.0;
  double shortest_exposure_s = 0.0;
};

}  // namespace omnihdr
