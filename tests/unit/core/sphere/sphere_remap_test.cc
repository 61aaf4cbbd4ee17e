#include "core/sphere/sphere_remap.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>
#include <random>

#include "core/base/parallel_for.h"

namespace omnihdr::sphere_remap_test {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

Image<float> Noise(int width, int height, int channels) {
  Image<float> image(width, height, channels);
  std::mt19937 generator(5);
  std::uniform_real_distribution<float> value(0.0F, 1000.0F);
  for (float& v : image.values()) v = value(generator);
  return image;
}

// The mean over the sphere, by solid angle.
double Mean(const SphereGrid& grid, const Image<float>& image) {
  double sum = 0.0;
  double total = 0.0;
  for (int y = 0; y < grid.height(); ++y) {
    for (int x = 0; x < grid.width(); ++x) {
      const double weight = grid.PixelSolidAngle(x, y);
      if (weight == 0.0 || std::isnan(image.at(x, y))) continue;
      sum += weight * image.at(x, y);
      total += weight;
    }
  }
  return sum / total;
}

TEST(SphereRemap, APictureOntoItsOwnGridStaysAsItIs) {
  for (const SphereGrid& grid :
       {SphereGrid::Equirectangular(32, 16), SphereGrid::Cylindrical(32, 16, -1, 1),
        SphereGrid::CubeStrip(9), SphereGrid::RhombicDodecahedron(7)}) {
    const Image<float> picture = Noise(grid.width(), grid.height(), 3);
    Image<float> out(grid.width(), grid.height(), 3);
    SphereRemapOptions options;
    options.area = false;
    SphereRemap(grid, grid, options).Apply(picture, out.view());
    for (std::size_t i = 0; i < out.size(); ++i) {
      ASSERT_NEAR(out.data()[i], picture.data()[i], 0.05F) << ToString(grid.kind()) << " " << i;
    }
  }
}

TEST(SphereRemap, ATurnOfHalfTheWidthIsAShiftOfColumns) {
  const SphereGrid grid = SphereGrid::Equirectangular(32, 16);
  const Image<float> picture = Noise(32, 16, 1);
  Image<float> out(32, 16);
  const Eigen::Matrix3d quarter =
      Eigen::AngleAxisd(std::numbers::pi / 2, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  SphereRemapOptions options;
  options.area = false;
  SphereRemap(grid, grid, options, quarter).Apply(picture, out.view());
  for (int y = 0; y < 16; ++y) {
    for (int x = 0; x < 32; ++x) {
      // +Z is up: a quarter turn to the left looks a quarter of the width further left.
      ASSERT_NEAR(out.at(x, y), picture.at((x + 24) % 32, y), 0.1F) << x << ", " << y;
    }
  }
}

TEST(SphereRemap, MinifyingKeepsTheMeanLight) {
  // One bright pixel in the dark, as a lamp: sampled at centres it would be lost or doubled.
  const SphereGrid source = SphereGrid::Equirectangular(256, 128);
  for (const SphereGrid& target : {SphereGrid::RhombicDodecahedron(9), SphereGrid::CubeStrip(11),
                                   SphereGrid::Equirectangular(48, 24)}) {
    for (const int x : {10, 101, 200}) {
      Image<float> picture(256, 128, 1, 1.0F);
      for (int dy = 0; dy < 3; ++dy) {
        for (int dx = 0; dx < 3; ++dx) picture.at(x + dx, 50 + dy) = 10'000.0F;
      }
      Image<float> out(target.width(), target.height());
      SphereRemap(target, source).Apply(picture, out.view());
      const double truth = Mean(source, picture);
      EXPECT_NEAR(Mean(target, out) / truth, 1.0, 0.1) << ToString(target.kind()) << " " << x;
    }
  }
}

TEST(SphereRemap, MinifiedStripesAreGreyNotMoire) {
  const SphereGrid source = SphereGrid::Equirectangular(512, 256);
  Image<std::uint8_t> stripes(512, 256);
  for (int y = 0; y < 256; ++y) {
    for (int x = 0; x < 512; ++x) stripes.at(x, y) = (x + y) % 2 == 0 ? 0 : 200;
  }
  const SphereGrid target = SphereGrid::CubeStrip(16);
  Image<std::uint8_t> out(16, 96);
  SphereRemap(target, source).Apply(stripes, out.view());
  for (const std::uint8_t v : out.values()) ASSERT_NEAR(v, 100, 15);
}

TEST(SphereRemap, APixelWithoutValueCostsItsShareAndNoMore) {
  const SphereGrid grid = SphereGrid::Equirectangular(64, 32);
  Image<float> picture(64, 32, 3, 5.0F);
  for (int c = 0; c < 3; ++c) picture.at(20, 16, c) = kNan;
  picture.at(40, 16, 1) = kNan;
  const SphereGrid target = SphereGrid::Equirectangular(256, 128);
  Image<float> out(256, 128, 3);
  SphereRemap(target, grid).Apply(picture, out.view());
  int missing = 0;
  for (int y = 0; y < 128; ++y) {
    for (int x = 0; x < 256; ++x) {
      for (int c = 0; c < 3; ++c) {
        if (std::isnan(out.at(x, y, c))) {
          missing += c == 1 ? 0 : 1;
          // Only where the pixel without a value is the nearest one, more or less.
          const double dx =
              std::min(std::abs((x + 0.5) / 4 - 20.5), std::abs((x + 0.5) / 4 - 40.5));
          ASSERT_LT(dx, 0.8);
          ASSERT_LT(std::abs((y + 0.5) / 4 - 16.5), 0.8);
        } else {
          ASSERT_FLOAT_EQ(out.at(x, y, c), 5.0F);
        }
      }
    }
  }
  EXPECT_GE(missing, 2 * 8);
  EXPECT_LE(missing, 2 * 24);
}

TEST(SphereRemap, InfiniteRadianceDoesNotBecomeNan) {
  const SphereGrid grid = SphereGrid::Equirectangular(16, 8);
  Image<float> picture(16, 8, 1, std::numeric_limits<float>::infinity());
  Image<float> out(24, 12);
  SphereRemap(SphereGrid::Equirectangular(24, 12), grid).Apply(picture, out.view());
  for (const float v : out.values()) ASSERT_TRUE(std::isinf(v));
}

TEST(SphereRemap, LabelsAreCarriedOverAsTheyAre) {
  const SphereGrid source = SphereGrid::Equirectangular(64, 32);
  Image<float> labels(64, 32);
  for (int y = 0; y < 32; ++y) {
    for (int x = 0; x < 64; ++x) labels.at(x, y) = x < 32 ? 1.0F : 7.0F;
  }
  const SphereGrid target = SphereGrid::RhombicDodecahedron(24);
  Image<float> out(target.width(), target.height());
  SphereRemap(target, source).ApplyNearest(labels, out.view());
  for (int y = 0; y < target.height(); ++y) {
    for (int x = 0; x < target.width(); ++x) {
      const Eigen::Vector3d ray = *target.RayFromPixel(x + 0.5, y + 0.5);
      if (std::abs(ray.y()) < 1e-9) continue;  // on the line between them
      ASSERT_EQ(out.at(x, y), ray.y() > 0.0 ? 1.0F : 7.0F) << x << ", " << y;
    }
  }
}

TEST(SphereRemap, WhatACylinderDoesNotShowIsEmpty) {
  const SphereGrid source = SphereGrid::Cylindrical(64, 32, -1.0, 0.5);
  const SphereGrid target = SphereGrid::CubeCross(16);
  const Image<float> picture(64, 32, 1, 3.0F);
  const Image<std::uint8_t> bytes(64, 32, 1, 30);
  Image<float> out(64, 48);
  Image<float> nearest(64, 48);
  Image<std::uint8_t> out_bytes(64, 48, 1, 99);
  const SphereRemap remap(target, source);
  remap.Apply(picture, out.view());
  remap.Apply(bytes, out_bytes.view());
  remap.ApplyNearest(picture, nearest.view());
  for (int y = 0; y < 48; ++y) {
    for (int x = 0; x < 64; ++x) {
      const auto ray = target.RayFromPixel(x + 0.5, y + 0.5);
      const bool is_shown = ray && source.PixelFromRay(*ray);
      ASSERT_EQ(std::isnan(nearest.at(x, y)), !is_shown);
      if (!is_shown) {
        ASSERT_TRUE(std::isnan(out.at(x, y)));
        ASSERT_EQ(out_bytes.at(x, y), 0);
      } else if (!std::isnan(out.at(x, y))) {
        ASSERT_FLOAT_EQ(out.at(x, y), 3.0F);
        ASSERT_EQ(out_bytes.at(x, y), 30);
      }
    }
  }
}

TEST(SphereRemap, StripesOfRowsMakeTheSamePictureAsTheWhole) {
  const SphereGrid source = SphereGrid::Equirectangular(64, 32);
  const SphereGrid target = SphereGrid::RhombicDodecahedron(8);
  const Image<float> picture = Noise(64, 32, 3);
  Image<float> whole(32, 24, 3);
  Image<float> stripes(32, 24, 3);
  SphereRemap(target, source).Apply(picture, whole.view());
  for (int row = 0; row < 24; row += 7) {
    SphereRemapOptions options;
    options.first_row = row;
    options.rows = 7;
    SphereRemap(target, source, options).Apply(picture, stripes.view());
  }
  EXPECT_TRUE(std::equal(whole.values().begin(), whole.values().end(), stripes.values().begin()));
}

TEST(SphereRemap, FixedPointAndFloatAgreeToHalfACode) {
  const SphereGrid source = SphereGrid::Equirectangular(64, 32);
  const SphereGrid target = SphereGrid::CubeStrip(20);
  Image<std::uint8_t> bytes(64, 32, 3);
  Image<std::uint16_t> words(64, 32, 3);
  Image<float> floats(64, 32, 3);
  std::mt19937 generator(3);
  for (std::size_t i = 0; i < bytes.size(); ++i) {
    const auto v = static_cast<std::uint8_t>(generator() & 0xFFU);
    bytes.data()[i] = v;
    words.data()[i] = static_cast<std::uint16_t>(v * 257);
    floats.data()[i] = v;
  }
  Image<std::uint8_t> out8(20, 120, 3);
  Image<std::uint16_t> out16(20, 120, 3);
  Image<float> out(20, 120, 3);
  const SphereRemap remap(target, source);
  remap.Apply(bytes, out8.view());
  remap.Apply(words, out16.view());
  remap.Apply(floats, out.view());
  for (std::size_t i = 0; i < out.size(); ++i) {
    // Half a code of rounding, and 1/512 pixel of position over a step of up to 255.
    ASSERT_NEAR(out8.data()[i], out.data()[i], 0.5F + 1.0F);
    ASSERT_NEAR(out16.data()[i] / 257.0F, out.data()[i], 1.1F);
  }
}

}  // namespace
}  // namespace omnihdr::sphere_remap_test
