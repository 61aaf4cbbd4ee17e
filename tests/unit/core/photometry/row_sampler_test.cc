#include "core/photometry/row_sampler.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace omnihdr::row_sampler_test {
namespace {

// Noise with clipped, dark and masked areas, so that every rim occurs.
Measurement Random(const Projection& projection, int width, int height) {
  std::mt19937 random(5);
  std::uniform_real_distribution<float> radiance(0.01F, 2.0F);
  Measurement m;
  m.projection = projection;
  m.radiance = Image<float>(width, height, 4);
  m.flags = Image<std::uint8_t>(width, height);
  m.saturation = {1.5F, 1.5F, 1.5F};
  m.variance_floor = {1e-4F, 1e-4F, 1e-4F};
  m.variance_per_radiance = {1e-3F, 1e-3F, 1e-3F};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      for (int c = 0; c < 3; ++c) m.radiance.pixel(x, y)[c] = radiance(random);
      const int area = (x / 5 + y / 4) % 6;
      if (area == 1) m.flags.at(x, y) = kSaturatedR | kSaturatedB;
      if (area == 2) m.flags.at(x, y) = kDarkG;
      if (area == 4) m.flags.at(x, y) = kMasked;
    }
  }
  return m;
}

struct Points {
  std::vector<float> x;
  std::vector<float> y;
};

// Points all over, at the borders and a little beyond the upper and the lower one.
Points PointsOn(int width, int height) {
  std::mt19937 random(6);
  std::uniform_real_distribution<float> x(0.0F, static_cast<float>(width));
  std::uniform_real_distribution<float> y(-1.0F, static_cast<float>(height) + 1.0F);
  Points points;
  for (int k = 0; k < 3001; ++k) {
    points.x.push_back(k % 97 == 0 ? 0.0F : (k % 89 == 0 ? static_cast<float>(width) : x(random)));
    points.y.push_back(y(random));
  }
  return points;
}

void ExpectAsOneByOne(const Measurement& m, float least_y, float most_y) {
  const PanoramaSampler single(m);
  const Image<float> contrast = ContrastOf(m);
  const RowSampler rows(m, RowSampler::Contrast::kSampled);
  Points points = PointsOn(m.radiance.width(), m.radiance.height());
  for (float& y : points.y) y = std::clamp(y, least_y, most_y);
  SampledRow sampled;
  rows.Sample(points.x.data(), points.y.data(), points.x.size(), &sampled);
  ASSERT_EQ(sampled.size(), points.x.size());
  for (std::size_t i = 0; i < sampled.size(); ++i) {
    const RadianceSample expected = single.SampleAt(points.x[i], points.y[i]);
    ASSERT_EQ(sampled.flags[i], expected.flags) << points.x[i] << ", " << points.y[i];
    for (std::size_t c = 0; c < 3; ++c) {
      ASSERT_NEAR(sampled.radiance[c][i], expected.rgb[c], 1e-5F)
          << points.x[i] << ", " << points.y[i];
    }
    if (expected.flags == kMasked) continue;
    ASSERT_NEAR(sampled.contrast[i],
                contrast.at(std::clamp(static_cast<int>(points.x[i]), 0, contrast.width() - 1),
                            std::clamp(static_cast<int>(points.y[i]), 0, contrast.height() - 1)),
                1e-5F)
        << points.x[i] << ", " << points.y[i];
  }
}

TEST(RowSampler, SamplesALatLongAsOneByOne) {
  ExpectAsOneByOne(Random(Projection::Equirectangular(64, 32), 64, 32), 0.0F, 32.0F);
}

TEST(RowSampler, SamplesACylinderAsOneByOneAndNothingBeyondItsEnds) {
  ExpectAsOneByOne(Random(Projection::Cylindrical(64, 40, -1.0, 1.0), 64, 40), -1.0F, 41.0F);
}

TEST(RowSampler, OnTheRimOfAClippedAreaItGivesABoundWhenAsked) {
  Measurement m = Random(Projection::Equirectangular(16, 8), 16, 8);
  for (int y = 0; y < 8; ++y) {
    for (int x = 0; x < 16; ++x) {
      m.flags.at(x, y) = x < 5 ? kDarkB : kSaturatedAny;
      for (int c = 0; c < 3; ++c) m.radiance.pixel(x, y)[c] = x < 5 ? 0.1F : 1.5F;
    }
  }
  const RowSampler rows(m, RowSampler::Contrast::kNone, RowSampler::Rim::kBound);
  const std::vector<float> x = {3.0F, 4.75F, 5.25F, 9.0F, 4.501F};
  const std::vector<float> y(x.size(), 4.0F);
  SampledRow sampled;
  rows.Sample(x.data(), y.data(), x.size(), &sampled);
  const std::vector<float> clipped = {0.0F, 0.25F, 0.75F, 1.0F, 0.0F};  // the last: rounding
  for (std::size_t i = 0; i < x.size(); ++i) {
    EXPECT_NEAR(sampled.clipped[i], clipped[i], 1e-5F);
    EXPECT_NEAR(sampled.radiance[1][i], 0.1F + 1.4F * clipped[i], 2e-3F);
    EXPECT_EQ(sampled.flags[i], clipped[i] == 0.0F ? kDarkB : kSaturatedAny);
  }
}

TEST(RowSampler, OnTheRimOfAMaskedAreaTheNearestPixelSpeaksThoughABoundIsAskedFor) {
  Measurement m = Random(Projection::Equirectangular(16, 8), 16, 8);
  for (std::uint8_t& f : m.flags.values()) f = kMasked;
  m.flags.at(5, 4) = kSaturatedAny;
  const RowSampler rows(m, RowSampler::Contrast::kNone, RowSampler::Rim::kBound);
  const std::vector<float> x = {5.75F, 6.25F};
  const std::vector<float> y(x.size(), 4.5F);
  SampledRow sampled;
  rows.Sample(x.data(), y.data(), x.size(), &sampled);
  EXPECT_EQ(sampled.flags, (std::vector<std::uint8_t>{kSaturatedAny, kMasked}));
  EXPECT_EQ(sampled.clipped, (std::vector<float>{1.0F, 0.0F}));
  EXPECT_EQ(sampled.radiance[1][0], m.radiance.pixel(5, 4)[1]);
}

TEST(ContrastOf, IsTheChangePerPixelRoundTheGlobe) {
  Measurement m = Random(Projection::Equirectangular(8, 4), 8, 4);
  for (int y = 0; y < 4; ++y) {
    for (int x = 0; x < 8; ++x) {
      const float e = x == 0 ? 3.0F : 1.0F + 0.5F * static_cast<float>(y);
      for (int c = 0; c < 3; ++c) m.radiance.pixel(x, y)[c] = e;
    }
  }
  const Image<float> contrast = ContrastOf(m);
  EXPECT_NEAR(contrast.at(4, 2), 0.5F, 1e-5F);
  EXPECT_NEAR(contrast.at(4, 0), 0.25F, 1e-5F);  // the upper border repeats
  EXPECT_NEAR(contrast.at(7, 0), std::hypot(1.0F, 0.25F), 1e-5F);
  EXPECT_NEAR(contrast.at(0, 1), 0.0F, 1e-5F);
}

}  // namespace
}  // namespace omnihdr::row_sampler_test
