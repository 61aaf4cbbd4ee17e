#include "daemon/evaluation/false_colour.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdlib>
#include <limits>
#include <string>

namespace omnihdr::false_colour_test {
namespace {

constexpr float kNaN = std::numeric_limits<float>::quiet_NaN();

std::array<int, 3> Pixel(const Image<std::uint8_t>& image, int x, int y = 0) {
  return {image.at(x, y, 0), image.at(x, y, 1), image.at(x, y, 2)};
}

TEST(DisparityColours, NearIsWarmFarIsCoolUnknownIsGrey) {
  Image<float> disparity(4, 1, 1);
  disparity.at(0, 0) = 1.0F;
  disparity.at(1, 0) = 0.02F;
  disparity.at(2, 0) = kNaN;
  disparity.at(3, 0) = 0.0F;
  const Image<std::uint8_t> colours = DisparityColours(disparity, 1.2);
  EXPECT_GT(colours.at(0, 0, 0), colours.at(0, 0, 2));
  EXPECT_LT(colours.at(1, 0, 0), colours.at(1, 0, 2));
  const std::array<int, 3> unknown = Pixel(colours, 2);
  EXPECT_EQ(unknown[0], unknown[1]);
  EXPECT_EQ(unknown[1], unknown[2]);
  EXPECT_GT(unknown[0], 60);  // not taken for infinitely far, which is nearly black
  EXPECT_NE(Pixel(colours, 3), unknown);
}

TEST(DisparityColours, NothingKnownIsAllHatched) {
  const Image<float> disparity(16, 8, 1, kNaN);
  EXPECT_EQ(NearDisparity(disparity), 0.0);
  const Image<std::uint8_t> colours = DisparityColours(disparity, 0.0);
  for (int x = 0; x < 16; ++x) EXPECT_EQ(colours.at(x, 3, 0), colours.at(x, 3, 2));
}

TEST(RadianceLevels, AreTheShareOfTheDecades) {
  Image<float> luminance(5, 1, 1);
  luminance.at(0, 0) = 0.01F;
  luminance.at(1, 0) = 1.0F;
  luminance.at(2, 0) = 1e9F;
  luminance.at(3, 0) = -2.0F;
  luminance.at(4, 0) = kNaN;
  const Image<float> levels = RadianceLevels(luminance, 0.01, 100.0);
  EXPECT_NEAR(levels.at(0, 0), 0.0F, 1e-6F);
  EXPECT_NEAR(levels.at(1, 0), 0.5F, 1e-6F);
  EXPECT_EQ(levels.at(2, 0), 1.0F);
  EXPECT_EQ(levels.at(3, 0), 0.0F);
  EXPECT_TRUE(std::isnan(levels.at(4, 0)));
}

TEST(RangeOf, IsAtLeastADecadeAndIgnoresWhatHasNoLogarithm) {
  Image<float> luminance(10, 10, 1, 3.0F);
  luminance.at(0, 0) = kNaN;
  luminance.at(1, 0) = 0.0F;
  luminance.at(2, 0) = std::numeric_limits<float>::infinity();
  const LuminanceRange range = RangeOf(luminance);
  EXPECT_NEAR(range.high / range.low, 10.0, 1e-9);
  EXPECT_NEAR(std::sqrt(range.high * range.low), 3.0, 1e-6);
  const LuminanceRange nothing = RangeOf(Image<float>(3, 3, 1, kNaN));
  EXPECT_GT(nothing.high, nothing.low);
}

TEST(ErrorColours, RightIsWhiteBrightIsRedDarkIsBlueUnknownIsGrey) {
  const Image<float> truth(4, 1, 3, 1.0F);
  Image<float> tested(4, 1, 3, 1.0F);
  for (int c = 0; c < 3; ++c) {
    tested.at(1, 0, c) = 2.5F;
    tested.at(2, 0, c) = 0.4F;
    tested.at(3, 0, c) = kNaN;
  }
  const Image<std::uint8_t> colours = ErrorColours(tested, truth, 0.3);
  EXPECT_EQ(Pixel(colours, 0), (std::array<int, 3>{255, 255, 255}));
  EXPECT_EQ(Pixel(colours, 1), (std::array<int, 3>{255, 0, 0}));
  EXPECT_EQ(Pixel(colours, 2), (std::array<int, 3>{0, 0, 255}));
  EXPECT_EQ(Pixel(colours, 3), (std::array<int, 3>{96, 96, 96}));
}

TEST(KindColours, EachKindHasItsColourAndAStrangerIsMagenta) {
  const std::vector<Kind> legend = {{0.0F, "none", 1, 2, 3}, {1.0F, "some", 4, 5, 6}};
  Image<float> kinds(3, 1, 1);
  kinds.at(1, 0) = 1.0F;
  kinds.at(2, 0) = 7.0F;
  const Image<std::uint8_t> colours = KindColours(kinds, legend);
  EXPECT_EQ(Pixel(colours, 0), (std::array<int, 3>{1, 2, 3}));
  EXPECT_EQ(Pixel(colours, 1), (std::array<int, 3>{4, 5, 6}));
  EXPECT_EQ(Pixel(colours, 2), (std::array<int, 3>{255, 0, 255}));
}

// A colour on the bar must be the colour of the value its tick names.
TEST(ScaleBar, ATickStandsUnderTheColourOfItsValue) {
  constexpr int kWidth = 1000;
  const double nearest = 3.7;
  const std::vector<ScaleBar::Tick> ticks = DisparityTicks(nearest, "m");
  ASSERT_GE(ticks.size(), 4U);
  ScaleBar bar;
  bar.ticks = ticks;
  const Image<std::uint8_t> picture = WithScaleBar(Image<std::uint8_t>(kWidth, 50, 3).view(), bar);
  ASSERT_GT(picture.height(), 80);
  // The bar is found as the first row below the picture whose ends differ from the paper.
  int bar_row = -1;
  for (int y = 51; y < picture.height() && bar_row < 0; ++y) {
    if (picture.at(kWidth / 2, y, 1) > 200 && picture.at(kWidth / 2, y, 2) < 120) bar_row = y + 2;
  }
  ASSERT_GT(bar_row, 0) << "the middle of Turbo is green";
  int left = 0;
  while (picture.at(left, bar_row, 0) == 24 && picture.at(left, bar_row, 1) == 24) ++left;
  const int length = kWidth - 2 * left;
  for (const ScaleBar::Tick& tick : ticks) {
    if (tick.level == 0.0) continue;
    const double value = std::strtod(tick.label.c_str(), nullptr);
    EXPECT_NEAR(tick.level, std::sqrt(value / nearest), 1e-9) << tick.label;
    const Image<std::uint8_t> wanted =
        DisparityColours(Image<float>(1, 1, 1, static_cast<float>(value)), nearest);
    const int x = left + static_cast<int>(std::lround(tick.level * (length - 1)));
    for (int c = 0; c < 3; ++c) {
      EXPECT_NEAR(picture.at(x, bar_row, c), wanted.at(0, 0, c), 6) << tick.label;
    }
  }
}

TEST(RadianceTicks, AreRoundNumbersAtTheirPlaces) {
  const std::vector<ScaleBar::Tick> ticks = RadianceTicks(0.013, 420.0);
  ASSERT_GE(ticks.size(), 4U);
  for (const ScaleBar::Tick& tick : ticks) {
    const double value = std::strtod(tick.label.c_str(), nullptr);
    EXPECT_NEAR(tick.level, std::log10(value / 0.013) / std::log10(420.0 / 0.013), 1e-4);
    EXPECT_GE(tick.level, 0.0);
    EXPECT_LE(tick.level, 1.0);
  }
  EXPECT_GE(RadianceTicks(1.0, 10.0).size(), 3U);
}

TEST(ScaleBar, FitsUnderASmallPicture) {
  for (const int width : {1, 16, 60}) {
    ScaleBar bar;
    bar.title = "a title that is wider than the picture";
    bar.ticks = RadianceTicks(0.001, 1000.0);
    const auto picture = WithScaleBar(Image<std::uint8_t>(width, 4, 3).view(), bar);
    EXPECT_EQ(picture.width(), width);
    EXPECT_GT(picture.height(), 20);
  }
}

}  // namespace
}  // namespace omnihdr::false_colour_test
