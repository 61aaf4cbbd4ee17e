#include "core/stereo/wavelet_filter.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

#include "core/base/parallel_for.h"

namespace omnihdr::wavelet_filter_test {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr int kWidth = 256;
constexpr int kHeight = 128;

DisparityMap Even(float disparity) {
  DisparityMap map;
  map.disparity = Image<float>(kWidth, kHeight, 1, disparity);
  map.confidence = Image<float>(kWidth, kHeight, 1, 1.0F);
  return map;
}

// Near on the left half of the globe, far on the right.
DisparityMap Step() {
  DisparityMap map = Even(0.6F);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = kWidth / 2; x < kWidth; ++x) map.disparity.at(x, y) = 0.2F;
  }
  return map;
}

TEST(FilterWavelet, LeavesAnEvenMapAsItIs) {
  DisparityMap map = Even(0.3F);
  FilterWavelet({}, &map);
  for (const float d : map.disparity.values()) ASSERT_NEAR(d, 0.3F, 1e-5F);
  for (const float c : map.confidence.values()) ASSERT_EQ(c, 1.0F);
}

TEST(FilterWavelet, RemovesFarImpulsesAndSmallFarPatches) {
  DisparityMap map = Even(0.3F);
  map.disparity.at(50, 60) = 0.05F;
  map.disparity.at(0, 70) = 0.05F;  // at the seam
  for (int y = 30; y < 33; ++y) {
    for (int x = 150; x < 153; ++x) map.disparity.at(x, y) = 0.1F;
  }
  FilterWavelet({}, &map);
  EXPECT_TRUE(std::isnan(map.disparity.at(50, 60)));
  EXPECT_EQ(map.confidence.at(50, 60), 0.0F);
  EXPECT_TRUE(std::isnan(map.disparity.at(0, 70)));
  for (int y = 30; y < 33; ++y) {
    for (int x = 150; x < 153; ++x) EXPECT_TRUE(std::isnan(map.disparity.at(x, y)));
  }
  int unknown = 0;
  for (const float d : map.disparity.values()) unknown += std::isnan(d) ? 1 : 0;
  EXPECT_EQ(unknown, 11);
}

TEST(FilterWavelet, KeepsAStepWhereItIs) {
  DisparityMap map = Step();
  FilterWavelet({}, &map);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      ASSERT_NEAR(map.disparity.at(x, y), x < kWidth / 2 ? 0.6F : 0.2F, 1e-4F) << x;
    }
  }
}

TEST(FilterWavelet, TakesSmallNoiseAwayAndKeepsTheStep) {
  DisparityMap map = Step();
  const DisparityMap truth = Step();
  std::mt19937 random(7);
  std::normal_distribution<float> noise(0.0F, 0.002F);
  for (float& d : map.disparity.values()) d += noise(random);
  FilterWavelet({}, &map);
  double before = 0.0;
  double after = 0.0;
  double at_step = 0.0;
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const double e = map.disparity.at(x, y) - truth.disparity.at(x, y);
      after += e * e;
      before += 0.002 * 0.002;
      if (x == kWidth / 2 || x == kWidth / 2 - 1) at_step = std::max(at_step, std::abs(e));
    }
  }
  EXPECT_LT(after, 0.4 * before);
  EXPECT_LT(at_step, 0.015);
}

TEST(FilterWavelet, UnknownStaysUnknownAndSpoilsNothingAround) {
  DisparityMap map = Even(0.3F);
  for (int y = 50; y < 70; ++y) {
    for (int x = 90; x < 130; ++x) map.disparity.at(x, y) = kNan;
  }
  FilterWavelet({}, &map);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const bool hole = y >= 50 && y < 70 && x >= 90 && x < 130;
      if (hole) {
        ASSERT_TRUE(std::isnan(map.disparity.at(x, y)));
      } else {
        ASSERT_NEAR(map.disparity.at(x, y), 0.3F, 1e-5F);
      }
    }
  }
}

TEST(FilterWavelet, OfNothingIsNothing) {
  DisparityMap map = Even(kNan);
  FilterWavelet({}, &map);
  for (const float d : map.disparity.values()) ASSERT_TRUE(std::isnan(d));
}

TEST(FilterWavelet, IsTheSameBytesOnOneAndOnTwoWorkers) {
  const auto filtered = [](int workers) {
    SetWorkerCount(workers);
    DisparityMap map = Step();
    std::mt19937 random(3);
    std::normal_distribution<float> noise(0.0F, 0.02F);
    for (float& d : map.disparity.values()) d += noise(random);
    FilterWavelet({}, &map);
    SetWorkerCount(0);
    return map;
  };
  const DisparityMap one = filtered(1);
  const DisparityMap two = filtered(2);
  for (std::size_t k = 0; k < one.disparity.size(); ++k) {
    const float a = one.disparity.values()[k];
    const float b = two.disparity.values()[k];
    ASSERT_TRUE(a == b || (std::isnan(a) && std::isnan(b)));
  }
}

}  // namespace
}  // namespace omnihdr::wavelet_filter_test
