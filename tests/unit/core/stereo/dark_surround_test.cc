#include "core/stereo/dark_surround.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <limits>
#include <random>
#include <vector>

namespace omnihdr::dark_surround_test {
namespace {

constexpr int kWidth = 32;
constexpr int kHeight = 16;
constexpr float kInfinity = std::numeric_limits<float>::infinity();

// Noise of standard deviation 1 whatever the radiance.
Measurement Even(float radiance) {
  Measurement m;
  m.radiance = Image<float>(kWidth, kHeight, 4, radiance);
  m.flags = Image<std::uint8_t>(kWidth, kHeight);
  m.variance_floor = {1.0F, 1.0F, 1.0F};
  return m;
}

struct Limits {
  float least = 0.0F;
  float most = 0.0F;
};
Limits At(const Measurement& m, float x, float y) {
  std::vector<float> least;
  std::vector<float> most;
  DarkSurround(m).LimitsOfRow({{x}, {y}}, &least, &most);
  return {least.at(0), most.at(0)};
}

TEST(DarkSurround, HasAThirdOfAPixelsNoise) {
  const Limits limits = At(Even(2.0F), 10.5F, 8.5F);
  EXPECT_FLOAT_EQ(limits.least, 0.9F * (2.0F - 1.0F));
  EXPECT_FLOAT_EQ(limits.most, 1.1F * (2.0F + 1.0F));
}

TEST(DarkSurround, GoesOnRoundTheGlobe) {
  Measurement m = Even(2.0F);
  for (int y = 0; y < kHeight; ++y) m.radiance.pixel(kWidth - 1, y)[1] = 3.5F;
  EXPECT_FLOAT_EQ(At(m, 0.5F, 8.5F).most, 1.1F * (2.5F + 1.0F));
  EXPECT_FLOAT_EQ(At(m, 1.5F, 8.5F).most, 1.1F * (2.5F + 1.0F));
  EXPECT_FLOAT_EQ(At(m, 2.5F, 8.5F).most, 1.1F * (2.0F + 1.0F));
}

TEST(DarkSurround, BesideAnEdgeTheOwnSideMayBe) {
  Measurement m = Even(0.2F);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 16; x < kWidth; ++x) m.radiance.pixel(x, y)[1] = 4.0F;
  }
  EXPECT_LT(At(m, 15.5F, 8.5F).least, 0.2F);
  EXPECT_GT(At(m, 16.5F, 8.5F).most, 4.0F);
  EXPECT_GT(At(m, 18.5F, 8.5F).least, 2.0F);
  EXPECT_LT(At(m, 13.5F, 8.5F).most, 2.0F);
}

TEST(DarkSurround, LeavesWhatIsThereAndDropsTheOtherSide) {
  constexpr float kTruth = 2.5F;
  std::mt19937 random(3);
  std::normal_distribution<float> noise(0.0F, 1.0F);
  Measurement m = Even(kTruth);
  for (int y = 0; y < kHeight; ++y) {
    for (int x = 0; x < kWidth; ++x) m.radiance.pixel(x, y)[1] += noise(random);
  }
  int pixels = 0;
  int told = 0;
  for (int y = 2; y < kHeight - 2; ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const Limits limits = At(m, static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F);
      EXPECT_LE(limits.least, kTruth);
      EXPECT_GE(limits.most, kTruth);
      ++pixels;
      told += limits.least > 0.1F ? 1 : 0;
    }
  }
  // Of single pixels one in six is as dark as .1 within 1.5 standard deviations.
  EXPECT_GT(told, pixels * 95 / 100);
}

TEST(DarkSurround, SaysNothingOfWhatIsBrightOrNotMeasured) {
  const auto has_none = [](const Limits& l) {
    return l.least == -kInfinity && l.most == kInfinity;
  };
  EXPECT_TRUE(has_none(At(Even(10.0F), 10.5F, 8.5F)));
  Measurement m = Even(2.0F);
  m.flags.at(10, 8) = kSaturatedB;
  for (const float x : {8.5F, 10.5F, 12.5F}) EXPECT_TRUE(has_none(At(m, x, 8.5F))) << x;
  EXPECT_FALSE(has_none(At(m, 13.5F, 8.5F)));
  for (const float y : {0.5F, 1.5F, kHeight - 1.5F, kHeight - 0.5F}) {
    EXPECT_TRUE(has_none(At(m, 20.5F, y))) << y;
  }
}

}  // namespace
}  // namespace omnihdr::dark_surround_test
