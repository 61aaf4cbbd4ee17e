#pragma once

#include <cmath>

#include "core/base/simd.h"

namespace omnihdr {

// atan2 to within 3e-7 rad, without branches so that loops over it vectorise. FastAtan2(0, 0) = 0.
// Odd minimax polynomial of degree 15 on [0, 1] (Abramowitz and Stegun 4.4.49 is the same form),
// then the octant folded back.
OMNIHDR_ALWAYS_INLINE float FastAtan2(float y, float x) {
  constexpr float kHalfPi = 1.57079632679489662F;
  constexpr float kPi = 3.14159265358979324F;
  const float ax = std::fabs(x);
  const float ay = std::fabs(y);
  const float larger = ax > ay ? ax : ay;
  const float smaller = ax > ay ? ay : ax;
  const float t = smaller / (larger > 1e-30F ? larger : 1e-30F);
  const float s = t * t;
  float r = -0.0040540580F;
  r = r * s + 0.0218612288F;
  r = r * s - 0.0559098861F;
  r = r * s + 0.0964200441F;
  r = r * s - 0.1390853351F;
  r = r * s + 0.1994653599F;
  r = r * s - 0.3332985605F;
  r = r * s + 0.9999993329F;
  r = r * t;
  r = ay > ax ? kHalfPi - r : r;
  r = x < 0.0F ? kPi - r : r;
  return y < 0.0F ? -r : r;
}

}  // namespace omnihdr
