#include "core/base/units.h"

#include <gtest/gtest.h>

#include <concepts>
#include <limits>
#include <numbers>

#include "core/base/clock.h"

namespace omnihdr::units_test {
namespace {

template <typename A, typename B>
concept Subtracts = requires(A a, B b) {
  a - b;
};
template <typename A, typename B>
concept Compares = requires(A a, B b) {
  a < b;
};
template <typename A, typename B>
concept Equals = requires(A a, B b) {
  a == b;
};

// Clocks do not mix: neither subtraction nor comparison nor conversion compiles.
static_assert(Subtracts<HostTime, HostTime>);
static_assert(Compares<CameraTime, CameraTime>);
static_assert(!Subtracts<HostTime, CameraTime>);
static_assert(!Subtracts<HostTime, UtcTime>);
static_assert(!Subtracts<CameraTime, UtcTime>);
static_assert(!Subtracts<UtcTime, HostTime>);
static_assert(!Compares<HostTime, CameraTime>);
static_assert(!Compares<HostTime, UtcTime>);
static_assert(!Equals<CameraTime, UtcTime>);
static_assert(!std::convertible_to<HostTime, UtcTime>);
static_assert(!std::convertible_to<std::int64_t, HostTime>);
static_assert(!std::assignable_from<HostTime&, CameraTime>);
// Nor do units and numbers.
static_assert(!std::convertible_to<double, ExposureTime>);
static_assert(!std::convertible_to<double, Radians>);
static_assert(!std::convertible_to<FrameId, PositionId>);
static_assert(!std::convertible_to<std::uint64_t, TriggerId>);
static_assert(!Compares<FrameId, TriggerId>);

TEST(Units, AStopDoublesTheTime) {
  const ExposureTime time = ExposureTime::Seconds(0.01);
  EXPECT_DOUBLE_EQ((time + Stops{1.0}).seconds(), 0.02);
  EXPECT_DOUBLE_EQ((time + Stops{-2.0}).seconds(), 0.0025);
  EXPECT_DOUBLE_EQ(((time + Stops{1.6}) - time).value, 1.6);
}

TEST(Units, OnlyAPositiveFiniteTimeIsAnExposure) {
  EXPECT_TRUE(ExposureTime::Seconds(1e-6).IsValid());
  EXPECT_FALSE(ExposureTime::Seconds(0.0).IsValid());
  EXPECT_FALSE(ExposureTime::Seconds(-1.0).IsValid());
  EXPECT_FALSE(ExposureTime::Seconds(std::numeric_limits<double>::infinity()).IsValid());
  EXPECT_FALSE(ExposureTime::Seconds(std::numeric_limits<double>::quiet_NaN()).IsValid());
}

TEST(Units, TwentyDecibelsAreAFactorOfTen) {
  EXPECT_DOUBLE_EQ(GainDb{20.0}.Factor(), 10.0);
  EXPECT_DOUBLE_EQ((Exposure{ExposureTime::Seconds(0.5), GainDb{-20.0}}).EffectiveSeconds(), 0.05);
}

TEST(Units, HalfATurnIsPi) {
  EXPECT_DOUBLE_EQ(Radians::FromDegrees(180.0).value(), std::numbers::pi);
  EXPECT_DOUBLE_EQ(Radians(std::numbers::pi / 2).degrees(), 90.0);
}

TEST(Units, TheSystemsMonotonicClockDoesNotGoBack) {
  const SystemClock clock;
  HostTime last = clock.Now();
  for (int i = 0; i < 1000; ++i) {
    const HostTime now = clock.Now();
    ASSERT_GE(now, last);
    last = now;
  }
  EXPECT_GT(clock.NowUtc().ns(), 1'600'000'000'000'000'000);
}

}  // namespace
}  // namespace omnihdr::units_test
