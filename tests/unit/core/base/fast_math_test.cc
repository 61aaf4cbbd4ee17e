#include "core/base/fast_math.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <random>

namespace omnihdr::fast_math_test {
namespace {

TEST(FastLog2, IsWithinTheStatedErrorOverTheWholeRangeOfFloats) {
  std::mt19937 generator(1);
  std::uniform_real_distribution<double> exponent(-126.0, 127.9);
  for (int i = 0; i < 200'000; ++i) {
    const auto x = static_cast<float>(std::exp2(exponent(generator)));
    const double exact = std::log2(static_cast<double>(x));
    // Rounding of the result to float is on top: half a unit in the last place of up to 128.
    EXPECT_NEAR(static_cast<double>(FastLog2(x)), exact, 3e-7 + 6e-8 * std::abs(exact)) << x;
  }
}

TEST(FastLog2, PowersOfTwoAreExact) {
  for (int e = -126; e < 128; ++e) {
    EXPECT_EQ(FastLog2(std::ldexp(1.0F, e)), static_cast<float>(e));
  }
}

TEST(FastLog2, IsFiniteWhateverItIsGiven) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  EXPECT_EQ(FastLog2(0.0F), -126.0F);
  EXPECT_EQ(FastLog2(-3.0F), -126.0F);
  EXPECT_EQ(FastLog2(1e-42F), -126.0F);
  EXPECT_EQ(FastLog2(kInfinity), 128.0F);
  EXPECT_TRUE(std::isfinite(FastLog2(std::numeric_limits<float>::quiet_NaN())));
}

TEST(FastExp2, IsWithinTheStatedRelativeError) {
  std::mt19937 generator(2);
  std::uniform_real_distribution<float> exponent(-126.0F, 127.0F);
  for (int i = 0; i < 200'000; ++i) {
    const float x = exponent(generator);
    const double exact = std::exp2(static_cast<double>(x));
    EXPECT_NEAR(static_cast<double>(FastExp2(x)) / exact, 1.0, 2.5e-7) << x;
  }
}

TEST(FastExp2, StopsAtItsLimits) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  EXPECT_NEAR(FastExp2(-1000.0F) / std::ldexp(1.0F, -126), 1.0F, 1e-6F);
  EXPECT_NEAR(FastExp2(1000.0F) / std::ldexp(1.0F, 127), 1.0F, 1e-6F);
  EXPECT_NEAR(FastExp2(kInfinity) / std::ldexp(1.0F, 127), 1.0F, 1e-6F);
  EXPECT_TRUE(std::isfinite(FastExp2(std::numeric_limits<float>::quiet_NaN())));
}

}  // namespace
}  // namespace omnihdr::fast_math_test
