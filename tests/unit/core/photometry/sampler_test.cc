#include "core/photometry/sampler.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

namespace omnihdr::sampler_test {
namespace {

// Radiance R = column, G = row, B = 1.
Measurement Coordinates(const Projection& projection) {
  Measurement m;
  m.projection = projection;
  m.radiance = Image<float>(projection.width(), projection.height(), 4);
  m.flags = Image<std::uint8_t>(projection.width(), projection.height());
  for (int y = 0; y < projection.height(); ++y) {
    for (int x = 0; x < projection.width(); ++x) {
      float* p = m.radiance.pixel(x, y);
      p[0] = static_cast<float>(x);
      p[1] = static_cast<float>(y);
      p[2] = 1.0F;
      p[3] = 1.0F;
    }
  }
  return m;
}

TEST(PanoramaSampler, PixelCentresReadTheirPixel) {
  const Measurement m = Coordinates(Projection::Equirectangular(32, 16));
  const PanoramaSampler sampler(m);
  for (int y = 0; y < 16; ++y) {
    for (int x = 0; x < 32; ++x) {
      const RadianceSample s =
          sampler.SampleAt(static_cast<float>(x) + 0.5F, static_cast<float>(y) + 0.5F);
      EXPECT_NEAR(s.rgb[0], x, 1e-5);
      EXPECT_NEAR(s.rgb[1], y, 1e-5);
      EXPECT_EQ(s.flags, 0);
    }
  }
}

TEST(PanoramaSampler, BetweenCentresItInterpolates) {
  const Measurement m = Coordinates(Projection::Equirectangular(32, 16));
  const RadianceSample s = PanoramaSampler(m).SampleAt(10.75F, 7.9F);
  EXPECT_NEAR(s.rgb[0], 10.25, 1e-5);
  EXPECT_NEAR(s.rgb[1], 7.4, 1e-5);
  EXPECT_NEAR(s.rgb[2], 1.0, 1e-6);
}

TEST(PanoramaSampler, ColumnsWrapRoundAtTheSeam) {
  const Measurement m = Coordinates(Projection::Equirectangular(32, 16));
  const PanoramaSampler sampler(m);
  // Half-way between the last column and the first.
  for (const float x : {0.0F, 32.0F}) {
    EXPECT_NEAR(sampler.SampleAt(x, 8.5F).rgb[0], 15.5, 1e-4);
  }
  EXPECT_NEAR(sampler.SampleAt(0.25F, 8.5F).rgb[0], 0.25 * 31.0, 1e-4);
  EXPECT_NEAR(sampler.SampleAt(31.75F, 8.5F).rgb[0], 0.75 * 31.0, 1e-4);
}

TEST(PanoramaSampler, ALatLongsPolesAreClamped) {
  const Measurement m = Coordinates(Projection::Equirectangular(32, 16));
  const PanoramaSampler sampler(m);
  EXPECT_NEAR(sampler.SampleAt(10.5F, 0.0F).rgb[1], 0.0, 1e-6);
  EXPECT_NEAR(sampler.SampleAt(10.5F, 16.0F).rgb[1], 15.0, 1e-6);
  EXPECT_EQ(sampler.Sample({0.0F, 0.0F, 1.0F}).flags, 0);
  EXPECT_EQ(sampler.Sample({0.0F, 0.0F, -1.0F}).flags, 0);
}

TEST(PanoramaSampler, OutsideACylinderIsMasked) {
  const Measurement m = Coordinates(Projection::Cylindrical(32, 16, -1.0, 1.5));
  const PanoramaSampler sampler(m);
  EXPECT_EQ(sampler.Sample({1.0F, 0.0F, 1.49F}).flags, 0);
  EXPECT_EQ(sampler.Sample({1.0F, 0.0F, 1.51F}).flags, kMasked);
  EXPECT_EQ(sampler.Sample({1.0F, 0.0F, -0.99F}).flags, 0);
  EXPECT_EQ(sampler.Sample({1.0F, 0.0F, -1.01F}).flags, kMasked);
  EXPECT_EQ(sampler.Sample({0.0F, 0.0F, 1.0F}).flags, kMasked);
  EXPECT_EQ(sampler.Sample({0.0F, 0.0F, -1.0F}).flags, kMasked);
}

TEST(PanoramaSampler, DarkPixelsAreBlendedAndSaySo) {
  Measurement m = Coordinates(Projection::Equirectangular(32, 16));
  m.flags.at(31, 8) = kDarkR;
  m.flags.at(0, 9) = kDarkB;
  const RadianceSample s = PanoramaSampler(m).SampleAt(0.0F, 9.0F);
  EXPECT_EQ(s.flags, kDarkR | kDarkB);
  EXPECT_NEAR(s.rgb[0], 15.5, 1e-4);
}

TEST(PanoramaSampler, OnTheRimOfAClippedOrMaskedAreaTheNearestPixelAloneSpeaks) {
  for (const std::uint8_t flag : {kSaturatedB, kSaturatedAny, kMasked}) {
    Measurement m = Coordinates(Projection::Equirectangular(32, 16));
    m.flags.at(0, 8) = flag;
    const PanoramaSampler sampler(m);
    const RadianceSample clipped = sampler.SampleAt(0.2F, 8.4F);
    EXPECT_EQ(clipped.flags, flag);
    EXPECT_EQ(clipped.rgb[0], 0.0F);
    EXPECT_EQ(clipped.rgb[1], 8.0F);
    const RadianceSample beside = sampler.SampleAt(31.9F, 8.4F);
    EXPECT_EQ(beside.flags, 0);
    EXPECT_EQ(beside.rgb[0], 31.0F);
  }
}

TEST(PanoramaSampler, InsideAClippedAreaItInterpolatesTheBounds) {
  Measurement m = Coordinates(Projection::Equirectangular(32, 16));
  for (std::uint8_t& f : m.flags.values()) f = kSaturatedAny;
  const RadianceSample s = PanoramaSampler(m).SampleAt(10.75F, 7.9F);
  EXPECT_EQ(s.flags, kSaturatedAny);
  EXPECT_NEAR(s.rgb[0], 10.25, 1e-5);
}

TEST(PanoramaSampler, RaysLandWhereTheProjectionSays) {
  std::mt19937 generator(9);
  std::normal_distribution<double> coordinate;
  for (const Projection& p :
       {Projection::Equirectangular(2048, 1024), Projection::Cylindrical(1536, 1152, -2.0, 2.5)}) {
    Measurement m;
    m.projection = p;
    m.radiance = Image<float>(p.width(), p.height(), 4);
    m.flags = Image<std::uint8_t>(p.width(), p.height());
    const PanoramaSampler sampler(m);
    for (int k = 0; k < 5000; ++k) {
      const Eigen::Vector3d ray(coordinate(generator), coordinate(generator),
                                coordinate(generator));
      if (!p.Covers(ray)) continue;
      float x = 0.0F;
      float y = 0.0F;
      sampler.PixelFromRay(static_cast<float>(ray.x()), static_cast<float>(ray.y()),
                           static_cast<float>(ray.z()), &x, &y);
      const Eigen::Vector2d exact = p.PixelFromRay(ray);
      const double dx = std::abs(x - exact.x());
      EXPECT_LT(std::min(dx, p.width() - dx), 2e-3);
      EXPECT_NEAR(y, exact.y(), 2e-3);
    }
  }
}

}  // namespace
}  // namespace omnihdr::sampler_test
