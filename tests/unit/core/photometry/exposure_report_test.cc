#include "core/photometry/exposure_report.h"

#include <gtest/gtest.h>

#include <cmath>

#include "core/photometry/clipped.h"

namespace omnihdr::exposure_report_test {
namespace {

TEST(ExposureCount, CountsGreyLevelsBelow5AndAbove250) {
  Image<std::uint8_t> grey(6, 1);
  const std::array<std::uint8_t, 6> values = {0, 4, 5, 250, 251, 255};
  std::copy(values.begin(), values.end(), grey.data());
  const ExposureCount count = CountExposure({std::move(grey)}, 8, {});
  EXPECT_EQ(count.pixels, 6U);
  EXPECT_EQ(count.under, 2U);
  EXPECT_EQ(count.over, 2U);
  EXPECT_NEAR(count.UnderPercent(), 100.0 / 3.0, 1e-9);
}

TEST(ExposureCount, AColourPictureCountsByItsLuma) {
  Image<std::uint8_t> image(2, 1, 3);
  image.at(0, 0, 2) = 40;  // blue alone: luma 4.56
  for (int c = 0; c < 3; ++c) image.at(1, 0, c) = 255;
  image.at(1, 0, 2) = 200;  // luma 248.7
  const ExposureCount count = CountExposure({std::move(image)}, 8, {});
  EXPECT_EQ(count.under, 1U);
  EXPECT_EQ(count.over, 0U);
}

TEST(ExposureCount, SixteenBitPicturesCountInEightBitUnitsAndMaskedPixelsNotAtAll) {
  Image<std::uint16_t> image(3, 1, 1);
  image.at(0, 0) = 4095;
  image.at(1, 0) = 70;  // 4.36 of 255
  image.at(2, 0) = 4095;
  Image<std::uint8_t> mask(3, 1, 1, 255);
  mask.at(2, 0) = 0;
  const ExposureCount count = CountExposure({std::move(image)}, 12, mask.view());
  EXPECT_EQ(count.pixels, 2U);
  EXPECT_EQ(count.under, 1U);
  EXPECT_EQ(count.over, 1U);
}

TEST(RadianceRange, IsTheRatioOfThePercentilesInStopsAndDecades) {
  Image<float> radiance(2001, 1, 3);
  Image<std::uint8_t> counted(2001, 1, 1, 1);
  for (int x = 0; x < 2001; ++x) {
    for (int c = 0; c < 3; ++c) {
      radiance.at(x, 0, c) = static_cast<float>(std::pow(10.0, -2.0 + 4.0 * x / 2000.0));
    }
  }
  radiance.at(5, 0, 0) = radiance.at(5, 0, 1) = radiance.at(5, 0, 2) = 1e9F;
  counted.at(5, 0) = 0;
  const RadianceRange range = RangeOfRadiance(radiance, counted);
  EXPECT_EQ(range.pixels, 2000U);
  EXPECT_NEAR(range.min, 0.01, 1e-5);
  EXPECT_NEAR(range.max, 100.0, 1e-2);
  EXPECT_NEAR(range.Decades(), 4.0 * 0.998, 0.01);
  EXPECT_NEAR(range.Stops(), range.Decades() * std::log2(10.0), 1e-9);
}

TEST(RadianceRange, OfNothingIsNothing) {
  const RadianceRange range = RangeOfRadiance(Image<float>(4, 4, 3), Image<std::uint8_t>(4, 4));
  EXPECT_EQ(range.pixels, 0U);
  EXPECT_EQ(range.Stops(), 0.0);
}

TEST(Clipped, AllChannelsReadAsNeutralAtTheLargestBound) {
  std::array<float, 3> rgb = {2.0F, 1.0F, 1.5F};
  NeutraliseClipped(kSaturatedAny, rgb.data());
  EXPECT_EQ(rgb, (std::array<float, 3>{2.0F, 2.0F, 2.0F}));
}

TEST(Clipped, AClippedChannelIsRaisedToTheMeanOfTheMeasuredOnesButNeverLowered) {
  std::array<float, 3> pink = {1.5F, 1.0F, 1.3F};
  NeutraliseClipped(kSaturatedG, pink.data());
  EXPECT_NEAR(pink[1], 1.4F, 1e-6F);
  EXPECT_EQ(pink[0], 1.5F);
  std::array<float, 3> sky = {0.4F, 0.7F, 1.0F};
  NeutraliseClipped(kSaturatedB, sky.data());
  EXPECT_EQ(sky, (std::array<float, 3>{0.4F, 0.7F, 1.0F}));
}

TEST(Clipped, MeasuredPixelsKeepTheirColour) {
  std::array<float, 3> rgb = {2.0F, 1.0F, 1.5F};
  NeutraliseClipped(kDarkAny, rgb.data());
  EXPECT_EQ(rgb, (std::array<float, 3>{2.0F, 1.0F, 1.5F}));
}

}  // namespace
}  // namespace omnihdr::exposure_report_test
