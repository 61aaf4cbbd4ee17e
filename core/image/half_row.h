#pragma once

#include <cstdint>

namespace omnihdr {

inline constexpr float kLargestHalf = 65504.0F;

// The bits of every `stride`-th of the values as halves (IEEE 754 binary16), `count` of them:
// rounded to the nearest, halfway to even; beyond their range the largest; NaN stays one. Any
// thread.
void HalfRow(const float* __restrict values, int stride, int count, std::uint16_t* __restrict out);

}  // namespace omnihdr
