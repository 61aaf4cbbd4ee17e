#include "core/sphere/fast_angle.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <random>

namespace omnihdr::fast_angle_test {
namespace {

constexpr double kTolerance = 1e-6;

void ExpectAngle(float y, float x) {
  EXPECT_NEAR(FastAtan2(y, x), std::atan2(static_cast<double>(y), static_cast<double>(x)),
              kTolerance)
      << "y = " << y << ", x = " << x;
}

TEST(FastAtan2, IsWithinAMicroradianAllAround) {
  for (int k = 0; k < 720'000; ++k) {
    // Half a step off the axes; they have tests of their own.
    const double angle = -std::numbers::pi + 2.0 * std::numbers::pi * (k + 0.5) / 720'000.0;
    const auto y = static_cast<float>(std::sin(angle));
    const auto x = static_cast<float>(std::cos(angle));
    const double exact = std::atan2(static_cast<double>(y), static_cast<double>(x));
    ASSERT_NEAR(FastAtan2(y, x), exact, kTolerance) << "at " << angle;
  }
}

TEST(FastAtan2, DoesNotDependOnLength) {
  std::mt19937 generator(1);
  std::uniform_real_distribution<float> coordinate(-1.0F, 1.0F);
  for (const float length : {1e-12F, 1e-3F, 1.0F, 1e4F, 1e15F}) {
    for (int k = 0; k < 2000; ++k) {
      ExpectAngle(length * coordinate(generator), length * coordinate(generator));
    }
  }
}

TEST(FastAtan2, IsRightOnTheAxesAndDiagonals) {
  for (const float s : {1e-6F, 1.0F, 3e5F}) {
    ExpectAngle(0.0F, s);
    ExpectAngle(s, 0.0F);
    ExpectAngle(-s, 0.0F);
    ExpectAngle(0.0F, -s);
    ExpectAngle(s, s);
    ExpectAngle(-s, s);
    ExpectAngle(s, -s);
    ExpectAngle(-s, -s);
  }
}

TEST(FastAtan2, OfNothingIsZero) { EXPECT_EQ(FastAtan2(0.0F, 0.0F), 0.0F); }

TEST(FastAtan2, StaysWithinPlusMinusPi) {
  for (const float y : {1e-30F, -1e-30F, 1e-10F, -1e-10F, 0.0F}) {
    EXPECT_LE(std::abs(FastAtan2(y, -1.0F)), std::numbers::pi_v<float>);
  }
}

}  // namespace
}  // namespace omnihdr::fast_angle_test
