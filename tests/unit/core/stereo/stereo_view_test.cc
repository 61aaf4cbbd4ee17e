#include "core/stereo/stereo_view.h"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <numbers>

#include "tests/unit/core/stereo/drive.h"

namespace omnihdr::stereo_view_test {
namespace {

constexpr LogScale kScale = {.floor = 1e-3F, .ln_black = -6.9F, .codes_per_ln = 20.0F};

std::array<int, 8> Bytes(std::uint64_t texel) {
  std::array<int, 8> bytes{};
  for (std::size_t k = 0; k < 8; ++k) bytes[k] = static_cast<int>((texel >> (8 * k)) & 0xFFU);
  return bytes;
}

Measurement Even(float value, std::uint8_t flags = 0) {
  const Image<float> radiance(64, 32, 3, value);
  Measurement m = testing::Perfect(radiance, Projection::Equirectangular(64, 32));
  for (std::uint8_t& f : m.flags.values()) f = flags;
  return m;
}

StereoView View(const Measurement& m) {
  return MakeStereoView(m, Eigen::Quaterniond::Identity(), 64, kScale);
}

TEST(StereoView, AMeasuredTexelIsOneCodeOfItsLogarithm) {
  const StereoView view = View(Even(0.5F));
  ASSERT_EQ(view.width, 64);
  ASSERT_EQ(view.height, 32);
  ASSERT_EQ(view.texels.size(), 33U * 65U);
  const int code = static_cast<int>(std::lround(1.0 + (std::log(0.5 + 1e-3) + 6.9) * 20.0));
  for (const std::uint64_t texel : view.texels) {
    EXPECT_EQ(Bytes(texel), (std::array<int, 8>{code, code, code, code, 128, 128, 128, 128}));
  }
}

TEST(HalvedStereoView, OfAnEvenViewIsTheSame) {
  const StereoView view = View(Even(0.5F));
  const StereoView halved = HalveStereoView(view);
  ASSERT_EQ(halved.width, 32);
  ASSERT_EQ(halved.height, 16);
  ASSERT_EQ(halved.texels.size(), 17U * 33U);
  for (const std::uint64_t texel : halved.texels) EXPECT_EQ(texel, view.row(3)[3]);
}

TEST(HalvedStereoView, HoldsTheMeanOfTheIntervalsAround) {
  StereoView view = View(Even(0.5F));
  const auto set = [&](int x, int y, int lo, int hi) {
    std::uint64_t& texel = view.texels[static_cast<std::size_t>(y * (view.width + 1) + x)];
    texel = (texel & ~0xFFFFULL) | static_cast<std::uint64_t>(lo) |
            static_cast<std::uint64_t>(hi) << 8U;
  };
  for (int y = 9; y <= 11; ++y) {
    for (int x = 19; x <= 21; ++x) set(x, y, 100, 100);
  }
  set(20, 10, 200, 255);  // at least: a quarter of the weight
  const std::array<int, 8> b = Bytes(HalveStereoView(view).row(5)[10]);
  EXPECT_NEAR(b[0], 125, 1);
  EXPECT_NEAR(b[1], 138, 2);
}

TEST(HalvedStereoView, SaysNothingNextToWhatSaysNothing) {
  StereoView view = View(Even(0.5F));
  view.texels[static_cast<std::size_t>(10 * (view.width + 1) + 20)] = 0x00FF00FF00FF00FFULL;
  const StereoView halved = HalveStereoView(view);
  const std::array<int, 8> there = Bytes(halved.row(5)[10]);
  EXPECT_GT(there[0], there[1]);
  const std::array<int, 8> apart = Bytes(halved.row(5)[12]);
  EXPECT_EQ(apart[0], apart[1]);
}

TEST(HalvedStereoView, RowsCloseRoundTheGlobe) {
  StereoView view = View(Even(0.5F));
  view.texels[static_cast<std::size_t>(10 * (view.width + 1) + view.width - 1)] =
      0x00FF00FF00FF00FFULL;
  const StereoView halved = HalveStereoView(view);
  const std::array<int, 8> first = Bytes(halved.row(5)[0]);
  EXPECT_GT(first[0], first[1]);
  EXPECT_EQ(halved.row(5)[0], halved.row(5)[halved.width]);
}

TEST(StereoView, ASaturatedChannelSaysAtLeast) {
  const std::array<int, 8> b = Bytes(View(Even(0.5F, kSaturatedB)).row(16)[20]);
  EXPECT_EQ(b[0], b[1]);
  EXPECT_EQ(b[2], b[0]);
  EXPECT_EQ(b[3], 255);
  EXPECT_EQ(b[4], 128);  // of the others
  EXPECT_EQ(b[5], 128);
}

TEST(StereoView, AChannelLostInNoiseSaysAtMost) {
  const std::array<int, 8> b = Bytes(View(Even(1.5e-3F, kDarkR | kDarkG)).row(16)[20]);
  EXPECT_EQ(b[0], 0);
  EXPECT_GT(b[1], 0);
  EXPECT_LT(b[1], 255);
  EXPECT_EQ(b[2], b[3]);
}

TEST(StereoView, ADarkChannelWellAboveTheNoiseStillCounts) {
  const std::array<int, 8> b = Bytes(View(Even(0.5F, kDarkAny)).row(16)[20]);
  EXPECT_EQ(b[0], b[1]);
}

TEST(StereoView, AMaskedTexelSaysNothing) {
  for (const std::uint64_t texel : View(Even(0.5F, kMasked)).texels) {
    const std::array<int, 8> b = Bytes(texel);
    EXPECT_GT(b[0], b[1]) << "an impossible interval";
  }
}

TEST(StereoView, OutsideACylinderSaysNothing) {
  const Image<float> radiance(64, 32, 3, 0.5F);
  const Measurement m = testing::Perfect(radiance, Projection::Cylindrical(64, 32, -1.0, 1.0));
  const StereoView view = View(m);
  const std::array<int, 8> pole = Bytes(view.row(0)[5]);
  EXPECT_GT(pole[0], pole[1]);
  const std::array<int, 8> horizon = Bytes(view.row(16)[5]);
  EXPECT_EQ(horizon[0], horizon[1]);
}

TEST(StereoView, TheLastColumnRepeatsTheFirst) {
  const testing::Room room = testing::FurnishedRoom();
  const Projection projection = Projection::Equirectangular(64, 32);
  const StereoView view =
      View(testing::Perfect(Render(room, projection, Pose{}).radiance, projection));
  for (int i = 0; i <= view.height; ++i) EXPECT_EQ(view.row(i)[view.width], view.row(i)[0]);
}

TEST(StereoView, GradientsFollowTheLogLuminance) {
  // Luminance grows by a constant factor a column, and falls by another a row.
  Image<float> radiance(64, 32, 3);
  for (int y = 0; y < 32; ++y) {
    for (int x = 0; x < 64; ++x) {
      for (int c = 0; c < 3; ++c) {
        radiance.at(x, y, c) =
            std::exp(0.02F * static_cast<float>(x) - 0.05F * static_cast<float>(y));
      }
    }
  }
  const StereoView view = View(testing::Perfect(radiance, Projection::Equirectangular(64, 32)));
  const std::array<int, 8> b = Bytes(view.row(16)[30]);
  EXPECT_NEAR(b[4], 128 + 60.0 * 0.5 * 4 * 0.02, 1.0);
  EXPECT_NEAR(b[6], 128 - 60.0 * 0.5 * 4 * 0.05, 1.0);
  EXPECT_EQ(b[4], b[5]);
  EXPECT_EQ(b[6], b[7]);
}

TEST(StereoView, GradientsAreOfTheChannelsThatBothSidesHaveMeasured) {
  Image<float> radiance(64, 32, 3);
  for (int y = 0; y < 32; ++y) {
    for (int x = 0; x < 64; ++x) {
      radiance.at(x, y, 0) = std::exp(0.01F * static_cast<float>(x));
      radiance.at(x, y, 1) = std::exp(0.03F * static_cast<float>(x));
      radiance.at(x, y, 2) = std::exp(0.02F * static_cast<float>(x));
    }
  }
  Measurement m = testing::Perfect(radiance, Projection::Equirectangular(64, 32));
  const auto gradient = [&] { return Bytes(View(m).row(16)[30]); };
  const auto expected = [](double per_column) { return 128 + 60.0 * 0.5 * 4 * per_column; };
  EXPECT_NEAR(gradient()[4], expected(0.2126 * 0.01 + 0.7152 * 0.03 + 0.0722 * 0.02), 1.0);
  std::fill_n(m.flags.data(), m.flags.size(), std::uint8_t{kSaturatedG});
  EXPECT_NEAR(gradient()[4], expected((0.2126 * 0.01 + 0.0722 * 0.02) / (0.2126 + 0.0722)), 1.0);
  EXPECT_EQ(gradient()[4], gradient()[5]);
  std::fill_n(m.flags.data(), m.flags.size(), std::uint8_t{kSaturatedAny});
  EXPECT_EQ(gradient()[4], 0);
  EXPECT_EQ(gradient()[5], 255);
}

TEST(StereoView, TwoCamerasTurnedDifferentlyAtOnePlaceGiveTheSameView) {
  const testing::Room room = testing::FurnishedRoom();
  const Projection projection = Projection::Equirectangular(512, 256);
  Pose turned;
  turned.rotation = Eigen::AngleAxisd(0.7, Eigen::Vector3d(0.2, -0.1, 1.0).normalized());
  const StereoView a =
      MakeStereoView(testing::Perfect(Render(room, projection, Pose{}).radiance, projection),
                     Eigen::Quaterniond::Identity(), 256, kScale);
  const StereoView b =
      MakeStereoView(testing::Perfect(Render(room, projection, turned).radiance, projection),
                     turned.rotation, 256, kScale);
  const double same = testing::Share(
      256, 128, [](int, int) { return true; },
      [&](int x, int y) { return std::abs(Bytes(a.row(y)[x])[0] - Bytes(b.row(y)[x])[0]) <= 6; });
  EXPECT_GT(same, 0.9);
}

TEST(LogScale, SpansFromTheNoiseFloorToTheSaturation) {
  const LogScale scale = LogScale::For(0.01F, 500.0F);
  EXPECT_FLOAT_EQ(scale.floor, 0.01F);
  const auto code = [&](float e) {
    return 1.0F + (std::log(e + scale.floor) - scale.ln_black) * scale.codes_per_ln;
  };
  EXPECT_NEAR(code(0.0F), 1.0F, 1e-3F);
  EXPECT_LE(code(500.0F), 254.0F);
  EXPECT_GT(code(500.0F), 240.0F);
}

TEST(LogScale, IsFiniteForAnySensor) {
  for (const auto& [floor, high] : std::vector<std::pair<float, float>>{
           {0.0F, 0.0F}, {1.0F, 0.5F}, {1e-20F, 1e20F}, {5.0F, 5.0F}}) {
    const LogScale scale = LogScale::For(floor, high);
    EXPECT_TRUE(std::isfinite(scale.ln_black));
    EXPECT_GT(scale.codes_per_ln, 0.0F);
    EXPECT_LE(scale.codes_per_ln, 60.0F);
  }
}

TEST(HalveMeasurement, IsTheMeanOfFourAndTheirFlagsTogether) {
  Image<float> radiance(4, 2, 3, 1.0F);
  for (int c = 0; c < 3; ++c) radiance.at(1, 1, c) = 5.0F;
  Measurement m = testing::Perfect(radiance, Projection::Equirectangular(4, 2));
  m.flags.at(2, 0) = kSaturatedR;
  m.flags.at(3, 1) = kDarkB;
  m.radiance.at(2, 0, 0) = 9.0F;
  const Measurement half = HalveMeasurement(m);
  ASSERT_EQ(half.radiance.width(), 2);
  ASSERT_EQ(half.radiance.height(), 1);
  EXPECT_EQ(half.projection, Projection::Equirectangular(2, 1));
  EXPECT_FLOAT_EQ(half.radiance.at(0, 0, 1), 2.0F);
  EXPECT_EQ(half.radiance.at(0, 0, 3), 1.0F);
  EXPECT_EQ(half.flags.at(1, 0), kSaturatedR | kDarkB);
  EXPECT_FLOAT_EQ(half.radiance.at(1, 0, 0), 3.0F);
  EXPECT_EQ(half.radiance.at(1, 0, 3), 0.0F);
}

TEST(HalveMeasurement, LeavesMaskedPixelsOut) {
  Image<float> radiance(4, 2, 3, 1.0F);
  Measurement m = testing::Perfect(radiance, Projection::Equirectangular(4, 2));
  m.flags.at(0, 0) = kMasked;
  m.radiance.at(0, 0, 1) = 1e6F;
  for (const auto& [x, y] : {std::pair{2, 0}, {3, 0}, {2, 1}, {3, 1}}) m.flags.at(x, y) = kMasked;
  const Measurement half = HalveMeasurement(m);
  EXPECT_FLOAT_EQ(half.radiance.at(0, 0, 1), 1.0F);
  EXPECT_EQ(half.flags.at(0, 0), 0);
  EXPECT_EQ(half.flags.at(1, 0), kMasked);
  EXPECT_EQ(half.radiance.at(1, 0, 1), 0.0F);
}

}  // namespace
}  // namespace omnihdr::stereo_view_test
