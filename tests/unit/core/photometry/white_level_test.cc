#include "core/photometry/white_level.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>

#include "core/photometry/measure.h"

namespace omnihdr::white_level_test {
namespace {

constexpr int kWidth = 160;
constexpr int kHeight = 100;

// A scene over three decades, or one bright wall; noise of a value; what lies above `white` is cut.
DecodedImage Picture(double seconds, double white, bool is_wall, int bits = 8, int hot = 0) {
  std::mt19937 random(static_cast<unsigned>(1000.0 * seconds) + 1);
  std::normal_distribution<double> noise(0.0, 1.0);
  const double largest = (1 << bits) - 1;
  Image<std::uint16_t> wide(kWidth, kHeight, 1);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const double light =
          is_wall ? (x < kWidth / 2 ? 0.3 : 0.8) : std::pow(10.0, 3.0 * x / kWidth - 1.5);
      double value = std::clamp(128.0 * seconds * light + noise(random), 0.0, white);
      if (y == 0 && x < hot) value = 255.0;
      wide.at(x, y) = static_cast<std::uint16_t>(std::lround(value / 255.0 * largest));
    }
  }
  if (bits > 8) return {std::move(wide)};
  Image<std::uint8_t> narrow(kWidth, kHeight, 1);
  std::copy_n(wide.data(), wide.size(), narrow.data());
  return {std::move(narrow)};
}

std::optional<WhiteLevel> Found(double white, bool is_wall, int bits = 8, int hot = 0) {
  WhiteLevelFinder finder;
  for (const double seconds : {0.25, 0.75, 2.2}) {
    finder.Add(Picture(seconds, white, is_wall, bits, hot), bits, seconds, 0, kHeight);
  }
  return finder.Find();
}

TEST(WhiteLevel, IsWhereDifferentExposuresHeapUp) {
  for (const double white : {200.0, 242.0, 255.0}) {
    const auto found = Found(white, false);
    ASSERT_TRUE(found) << white;
    EXPECT_NEAR(found->value, white, 1.0);
    EXPECT_GE(found->exposures, 2);
    EXPECT_GT(found->share, 0.1);
  }
}

TEST(WhiteLevel, OfTwelveBitsIsAsFineAsTheyAre) {
  const auto found = Found(241.7, false, 12);
  ASSERT_TRUE(found);
  EXPECT_NEAR(found->value, 241.7, 0.5);
}

TEST(WhiteLevel, AnEvenlyBrightWallIsNoneForItMovesWithTheExposure) {
  EXPECT_FALSE(Found(255.0, true));
}

TEST(WhiteLevel, HotPixelsAboveItDoNotHideIt) {
  const auto found = Found(242.0, false, 8, 6);
  ASSERT_TRUE(found);
  EXPECT_NEAR(found->value, 242.0, 1.0);
}

TEST(WhiteLevel, OneExposureProvesNothing) {
  WhiteLevelFinder finder;
  for (int k = 0; k < 4; ++k) finder.Add(Picture(2.2, 242.0, false), 8, 2.2, 0, kHeight);
  EXPECT_FALSE(finder.Find());
}

TEST(WhiteLevel, MaskedAndOtherSensorsRowsDoNotCount) {
  Image<std::uint8_t> mask(kWidth, kHeight);
  for (std::size_t k = 0; k < mask.size(); ++k) mask.data()[k] = k % kWidth < kWidth / 4 ? 255 : 0;
  WhiteLevelFinder masked;
  for (const double seconds : {0.75, 2.2}) {
    masked.Add(Picture(seconds, 242.0, false), 8, seconds, 0, kHeight, mask.view());
  }
  EXPECT_FALSE(masked.Find());  // the dark quarter
  WhiteLevelFinder beyond;
  for (const double seconds : {0.75, 2.2}) {
    beyond.Add(Picture(seconds, 242.0, false), 8, seconds, kHeight, kHeight);
  }
  EXPECT_FALSE(beyond.Find());
}

// Wrong by 5 %, as users of other programs met it: the clipped lamp counted as measured, and red.
TEST(WhiteLevel, OfFivePercentLessMakesHighlightsSaturatedInsteadOfRed) {
  const DecodedImage image{Image<std::uint8_t>(1, 1, 3, 242)};
  const Projection projection = Projection::Equirectangular(1, 1);
  MeasureOptions options;
  options.white_balance = {1.9, 1.0, 1.4};
  const Response wrong = *Response::Linear();
  const ExposedFrame frame{&image, {ExposureTime::Seconds(1.0), {}}};
  const auto red = Measure({&frame, 1}, projection, wrong, 8, {}, options);
  ASSERT_TRUE(red);
  EXPECT_EQ(red->flags.at(0, 0) & kSaturatedAny, 0);
  const Response right = wrong.WithWhite(242.0).value();
  const auto clipped = Measure({&frame, 1}, projection, right, 8, {}, options);
  ASSERT_TRUE(clipped);
  EXPECT_EQ(clipped->flags.at(0, 0) & kSaturatedAny, kSaturatedAny);
  // What is below stays measured.
  const DecodedImage wall{Image<std::uint8_t>(1, 1, 3, 225)};
  const ExposedFrame lit{&wall, {ExposureTime::Seconds(1.0), {}}};
  const auto measured = Measure({&lit, 1}, projection, right, 8, {}, options);
  ASSERT_TRUE(measured);
  EXPECT_EQ(measured->flags.at(0, 0) & kSaturatedAny, 0);
}

}  // namespace
}  // namespace omnihdr::white_level_test
