#include "core/photometry/tonemap.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

namespace omnihdr::tonemap_test {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

double Srgb(double linear) {
  return 255.0 *
         (linear <= 0.0031308 ? 12.92 * linear : 1.055 * std::pow(linear, 1.0 / 2.4) - 0.055);
}

TEST(EncodeSrgb, IsTheStandardsCurveRounded) {
  for (int k = 0; k <= 100'000; ++k) {
    const double linear = k / 100'000.0;
    EXPECT_NEAR(EncodeSrgb(static_cast<float>(linear)), Srgb(linear), 0.502) << linear;
  }
}

TEST(EncodeSrgb, InvertsTheDecodingOfEveryCode) {
  for (int code = 0; code < 256; ++code) {
    const double v = code / 255.0;
    const double linear = v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
    EXPECT_EQ(EncodeSrgb(static_cast<float>(linear)), code);
  }
}

TEST(EncodeSrgb, ClampsWhatIsOutside) {
  EXPECT_EQ(EncodeSrgb(-1.0F), 0);
  EXPECT_EQ(EncodeSrgb(kNan), 0);
  EXPECT_EQ(EncodeSrgb(-kInfinity), 0);
  EXPECT_EQ(EncodeSrgb(1.0F), 255);
  EXPECT_EQ(EncodeSrgb(7.0F), 255);
  EXPECT_EQ(EncodeSrgb(kInfinity), 255);
  EXPECT_EQ(EncodeSrgb(std::nextafter(1.0F, 0.0F)), 255);
}

Image<float> Grey(int width, int height, float value, int channels = 3) {
  return {width, height, channels, value};
}

TEST(ToneMapReinhard, MapsTheLogAverageToTheKey) {
  // Even grey: its own log average; L = key, Ld = L(1 + L/white²)/(1 + L) with white = 1.
  const Image<std::uint8_t> out = ToneMapReinhard(Grey(32, 32, 57.0F), {});
  const double expected = Srgb(0.18 * (1.0 + 0.18) / 1.18);
  EXPECT_NEAR(out.at(16, 16, 0), expected, 1.0);
  EXPECT_EQ(out.at(16, 16, 0), out.at(16, 16, 2));
}

TEST(ToneMapReinhard, TheScaleOfTheRadianceDoesNotMatter) {
  Image<float> a(64, 32, 3);
  Image<float> b(64, 32, 3);
  for (std::size_t k = 0; k < a.size(); ++k) {
    a.data()[k] = 0.01F * static_cast<float>(1 + k % 997);
    b.data()[k] = 1024.0F * a.data()[k];
  }
  const Image<std::uint8_t> ta = ToneMapReinhard(a, {});
  const Image<std::uint8_t> tb = ToneMapReinhard(b, {});
  for (std::size_t k = 0; k < ta.size(); ++k) EXPECT_NEAR(ta.data()[k], tb.data()[k], 1);
}

TEST(ToneMapReinhard, BrighterStaysBrighter) {
  Image<float> ramp(256, 8, 3);
  for (int y = 0; y < 8; ++y) {
    for (int x = 0; x < 256; ++x) {
      for (int c = 0; c < 3; ++c) ramp.at(x, y, c) = std::pow(10.0F, static_cast<float>(x) / 64.0F);
    }
  }
  const Image<std::uint8_t> out = ToneMapReinhard(ramp, {});
  for (int x = 1; x < 256; ++x) EXPECT_GE(out.at(x, 4, 1), out.at(x - 1, 4, 1));
  EXPECT_GT(out.at(255, 4, 1), 240);
}

TEST(ToneMapReinhard, HueSurvives) {
  Image<float> image = Grey(32, 32, 1.0F);
  image.at(10, 10, 0) = 0.8F;
  image.at(10, 10, 1) = 0.4F;
  image.at(10, 10, 2) = 0.2F;
  const Image<std::uint8_t> out = ToneMapReinhard(image, {});
  const auto linear = [](int code) {
    const double v = code / 255.0;
    return v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
  };
  EXPECT_NEAR(linear(out.at(10, 10, 0)) / linear(out.at(10, 10, 1)), 2.0, 0.08);
  EXPECT_NEAR(linear(out.at(10, 10, 1)) / linear(out.at(10, 10, 2)), 2.0, 0.12);
}

TEST(ToneMapReinhard, NanAndNegativeReadAsBlackAndSpoilNothing) {
  const Image<float> clean = Grey(64, 32, 2.0F);
  Image<float> dirty = clean.Clone();
  dirty.at(5, 5, 0) = kNan;
  dirty.at(9, 9, 1) = -50.0F;
  for (int c = 0; c < 3; ++c) {
    dirty.at(13, 13, c) = -3.0F;
    dirty.at(17, 17, c) = kInfinity;
    dirty.at(21, 21, c) = 0.0F;
  }
  const Image<std::uint8_t> expected = ToneMapReinhard(clean, {});
  const Image<std::uint8_t> out = ToneMapReinhard(dirty, {});
  for (int c = 0; c < 3; ++c) {
    EXPECT_EQ(out.at(5, 5, c), 0);
    EXPECT_EQ(out.at(13, 13, c), 0);
    EXPECT_EQ(out.at(21, 21, c), 0);
    EXPECT_EQ(out.at(30, 20, c), expected.at(30, 20, c));
  }
  EXPECT_EQ(out.at(9, 9, 1), 0);
}

TEST(ToneMapReinhard, PicturesWithNothingInThemAreBlack) {
  for (const float v : {0.0F, -1.0F, kNan}) {
    const Image<std::uint8_t> out = ToneMapReinhard(Grey(16, 16, v), {});
    for (const std::uint8_t code : out.values()) EXPECT_EQ(code, 0);
  }
  EXPECT_EQ(ToneMapReinhard(Grey(1, 1, 1.0F), {}).size(), 3U);
  EXPECT_TRUE(ToneMapReinhard(Image<float>(0, 0, 3), {}).empty());
}

TEST(ToneMapReinhard, TheFourthChannelIsIgnored) {
  Image<float> four = Grey(16, 16, 2.0F, 4);
  for (int y = 0; y < 16; ++y) {
    for (int x = 0; x < 16; ++x) four.at(x, y, 3) = 1e6F;
  }
  const Image<std::uint8_t> a = ToneMapReinhard(four, {});
  const Image<std::uint8_t> b = ToneMapReinhard(Grey(16, 16, 2.0F), {});
  ASSERT_EQ(a.channels(), 3);
  for (std::size_t k = 0; k < a.size(); ++k) EXPECT_EQ(a.data()[k], b.data()[k]);
}

}  // namespace
}  // namespace omnihdr::tonemap_test
