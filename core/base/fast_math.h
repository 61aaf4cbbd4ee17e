#pragma once

#include <bit>
#include <cstdint>

#include "core/base/simd.h"

namespace omnihdr {

// log2 to within 2e-7 absolute plus float rounding, without branches so that loops over it
// vectorise. Law: finite for every argument; zero, negative and denormal numbers read as the
// smallest normal number (−126), infinity as 128; NaN gives some finite number.
// The mantissa is brought into [√½, √2) and its logarithm is t·P(t), t = m − 1, P the minimax
// polynomial of degree 7.
OMNIHDR_ALWAYS_INLINE float FastLog2(float x) {
  const float positive = x > 1.17549435e-38F ? x : 1.17549435e-38F;
  const auto bits = std::bit_cast<std::int32_t>(positive);
  const std::int32_t exponent = (bits - 0x3F3504F3) >> 23;
  const auto t = std::bit_cast<float>(bits - exponent * (1 << 23)) - 1.0F;
  float p = -0.149733081F;
  p = p * t + 0.235709563F;
  p = p * t - 0.248322845F;
  p = p * t + 0.2868689F;
  p = p * t - 0.360263467F;
  p = p * t + 0.480931163F;
  p = p * t - 0.721352458F;
  p = p * t + 1.4426949F;
  return static_cast<float>(exponent) + p * t;
}

// 2^x to within 2e-7 relative for −126 ≤ x ≤ 127; beyond, the value at the limit. NaN reads as
// −126. Minimax polynomial of degree 5 on [−½, ½].
OMNIHDR_ALWAYS_INLINE float FastExp2(float x) {
  const float low = x > -126.0F ? x : -126.0F;
  const float limited = low < 127.0F ? low : 127.0F;
  constexpr float kRound = 12582912.0F;  // 1.5·2^23: adding it rounds to a whole number
  const float shifted = limited + kRound;
  const float f = limited - (shifted - kRound);
  const std::int32_t exponent = std::bit_cast<std::int32_t>(shifted) - 0x4B400000;
  float p = 0.00134100043F;
  p = p * f + 0.00967603642F;
  p = p * f + 0.0555029735F;
  p = p * f + 0.240221068F;
  p = p * f + 0.693147242F;
  p = p * f + 1.00000012F;
  return p * std::bit_cast<float>((exponent + 127) * (1 << 23));
}

}  // namespace omnihdr
