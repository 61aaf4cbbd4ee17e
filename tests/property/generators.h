#pragma once

#include <rapidcheck.h>
#include <Eigen/Geometry>
#include <cmath>
#include <cstdlib>
#include <numbers>

#include "core/sphere/pose.h"

namespace omnihdr::testing {

// The same cases in every run, unless RC_PARAMS says otherwise.
inline const int kSeedIsSet = setenv("RC_PARAMS", "seed=1906 max_success=200", 0);

// Even numbers over [low, high].
inline rc::Gen<double> Between(double low, double high) {
  constexpr int kSteps = 1 << 30;
  return rc::gen::map(rc::gen::inRange(0, kSteps + 1),
                      [=](int k) { return low + (high - low) * k / kSteps; });
}

// To be called inside a property.
inline Eigen::Vector3d AnyUnitVector() {
  const double z = *Between(-1.0, 1.0);
  const double angle = *Between(-std::numbers::pi, std::numbers::pi);
  const double rho = std::sqrt(1.0 - z * z);
  return {rho * std::cos(angle), rho * std::sin(angle), z};
}

inline Pose AnyPose() {
  const Eigen::Vector3d axis = AnyUnitVector();
  const double angle = *Between(-std::numbers::pi, std::numbers::pi);
  return {Eigen::Quaterniond(Eigen::AngleAxisd(angle, axis)),
          *Between(0.0, 20.0) * AnyUnitVector()};
}

}  // namespace omnihdr::testing
