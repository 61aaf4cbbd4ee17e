#pragma once

#include <algorithm>
#include <cstdint>

#include "core/photometry/measurement.h"

namespace omnihdr {

// What a picture shows where `flags` says channels are saturated in every exposure. Each holds a
// lower bound, and bounds differ by channel (white-balance gains): shown as they are, the sun is
// pink. Clipped channels read as the neutral that agrees with what is known: the largest bound
// where all are clipped, the mean of the measured channels otherwise, and never less than their own
// bound. Measured channels keep their value.
inline void NeutraliseClipped(std::uint8_t flags, float* rgb) {
  const int clipped = flags & kSaturatedAny;
  if (clipped == 0) return;
  float sum = 0.0F;
  int measured = 0;
  for (int c = 0; c < 3; ++c) {
    if ((clipped & (kSaturatedR << c)) != 0) continue;
    sum += rgb[c];
    ++measured;
  }
  const float neutral =
      measured > 0 ? sum / static_cast<float>(measured) : std::max({rgb[0], rgb[1], rgb[2]});
  for (int c = 0; c < 3; ++c) {
    if ((clipped & (kSaturatedR << c)) != 0) rgb[c] = std::max(rgb[c], neutral);
  }
}

}  // namespace omnihdr
