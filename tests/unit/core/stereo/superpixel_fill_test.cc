#include "core/stereo/superpixel_fill.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/unit/core/stereo/drive.h"

namespace omnihdr::superpixel_fill_test {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr int kWidth = 128;
constexpr int kHeight = 64;

// Four vertical strips.
Superpixels Strips() {
  Superpixels s;
  s.label = Image<std::int32_t>(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) s.label.at(x, y) = x / 32;
  }
  s.count = 4;
  return s;
}

DisparityMap Even(float disparity) {
  DisparityMap map;
  map.disparity = Image<float>(kWidth, kHeight, 1, disparity);
  map.confidence = Image<float>(kWidth, kHeight, 1, 1.0F);
  return map;
}

TEST(FillSuperpixels, NothingFlowsAcrossAnOutline) {
  DisparityMap map = Even(kNan);
  for (int y = 0; y < kHeight; ++y) {
    map.disparity.at(31, y) = 0.5F;  // of the first strip, right beside the second
    map.disparity.at(60, y) = 0.1F;
  }
  FillSuperpixels(Strips(), &map);
  for (int y = 0; y < kHeight; ++y) {
    EXPECT_NEAR(map.disparity.at(0, y), 0.5F, 1e-5F);
    EXPECT_NEAR(map.disparity.at(32, y), 0.1F, 1e-5F);
    EXPECT_EQ(map.confidence.at(32, y), 0.0F);
  }
}

TEST(FillSuperpixels, ASuperpixelWithoutAKnownPixelStaysAHole) {
  DisparityMap map = Even(kNan);
  map.disparity.at(5, 5) = 0.3F;
  FillSuperpixels(Strips(), &map);
  EXPECT_NEAR(map.disparity.at(20, 50), 0.3F, 1e-5F);
  EXPECT_TRUE(std::isnan(map.disparity.at(40, 50)));
}

TEST(FillSuperpixels, TheNearerKnownPixelCountsMore) {
  DisparityMap map = Even(kNan);
  map.disparity.at(4, 32) = 0.2F;
  map.disparity.at(28, 32) = 0.6F;
  FillSuperpixels(Strips(), &map);
  // Weights 1/8² and 1/16².
  EXPECT_NEAR(map.disparity.at(12, 32), (0.2F * 4.0F + 0.6F) / 5.0F, 2e-3F);
}

TEST(FillSuperpixels, WhatIsKnownStays) {
  DisparityMap map = Even(0.4F);
  map.disparity.at(10, 10) = 0.7F;
  FillSuperpixels(Strips(), &map);
  EXPECT_EQ(map.disparity.at(10, 10), 0.7F);
  EXPECT_EQ(map.disparity.at(11, 10), 0.4F);
  EXPECT_EQ(map.confidence.at(11, 10), 1.0F);
}

// Grey ground of radiance 0.2; the upper half as given.
Image<float> UnderSky(float r, float g, float b) {
  Image<float> radiance(kWidth, kHeight, 3, 0.2F);
  for (int y = 0; y < kHeight / 2; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      radiance.at(x, y, 0) = r;
      radiance.at(x, y, 1) = g;
      radiance.at(x, y, 2) = b;
    }
  }
  return radiance;
}

TEST(FindSky, IsBrightAndBlue) {
  const Image<std::uint8_t> sky = FindSky(UnderSky(0.8F, 1.0F, 1.06F));
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) ASSERT_EQ(sky.at(x, y), y < kHeight / 2 ? 1 : 0);
  }
}

TEST(FindSky, IsNeitherDarkNorWhiteNorDeepBlueNorRed) {
  const auto none = [](const Image<std::uint8_t>& sky) {
    return std::all_of(sky.values().begin(), sky.values().end(), [](auto s) { return s == 0; });
  };
  EXPECT_TRUE(none(FindSky(UnderSky(0.08F, 0.10F, 0.106F))));  // darker than the mean
  EXPECT_TRUE(none(FindSky(UnderSky(1.0F, 1.0F, 1.0F))));      // saturated or a white wall
  EXPECT_TRUE(none(FindSky(UnderSky(0.4F, 0.8F, 1.6F))));      // r below 0.25
  EXPECT_TRUE(none(FindSky(UnderSky(0.8F, 0.9F, 1.1F))));      // g and b too far apart
  EXPECT_TRUE(none(FindSky(UnderSky(1.3F, 1.0F, 1.0F))));      // red exceeds the others
}

TEST(FindSky, MaskedPixelsAreNoSky) {
  Image<float> radiance = UnderSky(0.8F, 1.0F, 1.06F);
  for (int c = 0; c < 3; ++c) radiance.at(3, 3, c) = kNan;
  const Image<std::uint8_t> sky = FindSky(radiance);
  EXPECT_EQ(sky.at(3, 3), 0);
  EXPECT_EQ(sky.at(4, 3), 1);
}

TEST(PutSkyAtInfinity, OnlySuperpixelsOfWhichEnoughIsSky) {
  Image<std::uint8_t> sky(kWidth, kHeight);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < 32; ++x) sky.at(x, y) = y < 40 ? 1 : 0;   // 62 %
    for (int x = 32; x < 64; ++x) sky.at(x, y) = y < 20 ? 1 : 0;  // 31 %
  }
  DisparityMap map = Even(0.3F);
  EXPECT_EQ(PutSkyAtInfinity(Strips(), sky, 0.5, &map), 1);
  EXPECT_EQ(map.disparity.at(5, 60), 0.0F);
  EXPECT_EQ(map.disparity.at(40, 5), 0.3F);
  EXPECT_EQ(map.disparity.at(100, 5), 0.3F);
}

TEST(MapRadiance, IsThePictureOnTheMapsGrid) {
  const Projection projection = Projection::Equirectangular(2 * kWidth, kWidth);
  Image<float> radiance(2 * kWidth, kWidth, 3, 0.5F);
  Measurement m = testing::Perfect(radiance, projection);
  m.flags.at(100, 60) = m.flags.at(101, 60) = m.flags.at(100, 61) = m.flags.at(101, 61) = kMasked;
  const Image<float> map = MapRadiance(m, Eigen::Quaterniond::Identity(), kWidth);
  ASSERT_EQ(map.width(), kWidth);
  ASSERT_EQ(map.height(), kWidth / 2);
  EXPECT_TRUE(std::isnan(map.at(50, 30, 0)));
  EXPECT_NEAR(map.at(20, 30, 1), 0.5F, 1e-5F);
}

TEST(LogColours, EqualRatiosAreEqualSteps) {
  const LogScale scale = LogScale::For(1e-4F, 10.0F);
  Image<float> radiance(3, 1, 3);
  const std::array<float, 3> level = {0.1F, 0.4F, 1.6F};
  for (int x = 0; x < 3; ++x) {
    for (int c = 0; c < 3; ++c) radiance.at(x, 0, c) = level[static_cast<std::size_t>(x)];
  }
  const Image<std::uint8_t> colours = LogColours(radiance, scale);
  EXPECT_NEAR(colours.at(1, 0, 0) - colours.at(0, 0, 0), colours.at(2, 0, 0) - colours.at(1, 0, 0),
              1);
  for (int x = 0; x < 3; ++x) {
    EXPECT_NEAR(colours.at(x, 0, 1), 128, 1);
    EXPECT_NEAR(colours.at(x, 0, 2), 128, 1);
  }
}

}  // namespace
}  // namespace omnihdr::superpixel_fill_test
