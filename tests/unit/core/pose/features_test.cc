#include "core/pose/features.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>

#include "core/base/parallel_for.h"
#include "core/pose/feature_image.h"
#include "tests/unit/core/pose/room.h"

namespace omnihdr::features_test {
namespace {

using Eigen::Vector3d;

// A grey sphere with round bright spots at given directions, measured without noise.
Measurement Spots(const Projection& projection, const std::vector<Vector3d>& spots,
                  double sigma_rad) {
  Measurement m;
  m.projection = projection;
  m.radiance = Image<float>(projection.width(), projection.height(), 4);
  m.flags = Image<std::uint8_t>(projection.width(), projection.height(), 1);
  for (int y = 0; y < projection.height(); ++y) {
    for (int x = 0; x < projection.width(); ++x) {
      const Vector3d ray = projection.RayFromPixel(x + 0.5, y + 0.5);
      double ln = 0.0;
      for (const Vector3d& spot : spots) {
        const double angle = std::acos(std::clamp(ray.dot(spot), -1.0, 1.0)) / sigma_rad;
        ln += 1.5 * std::exp(-0.5 * angle * angle);
      }
      float* p = m.radiance.pixel(x, y);
      p[0] = p[1] = p[2] = static_cast<float>(std::exp(ln));
      p[3] = 1.0F;
    }
  }
  m.saturation = {1000.0F, 1000.0F, 1000.0F};
  m.noise_floor = 1e-4F;
  return m;
}

Vector3d Direction(double azimuth_deg, double latitude_deg) {
  const double a = azimuth_deg * M_PI / 180.0;
  const double l = latitude_deg * M_PI / 180.0;
  return {std::cos(a) * std::cos(l), std::sin(a) * std::cos(l), std::sin(l)};
}

double NearestAngle(const FeatureSet& set, const Vector3d& direction) {
  double nearest = M_PI;
  for (const Feature& feature : set.features) {
    nearest = std::min(nearest, std::acos(std::clamp(feature.ray.dot(direction), -1.0, 1.0)));
  }
  return nearest;
}

TEST(Features, ASpotIsFoundWhereItIsToAnEighthOfAPixelOnEveryProjectionAndOnTheSeam) {
  const std::vector<Vector3d> spots{Direction(10.0, 3.0), Direction(179.97, 20.0),
                                    Direction(-90.3, -41.0), Direction(121.2, 58.0),
                                    Direction(60.1, -60.0)};
  for (const Projection& projection : {Projection::Equirectangular(1024, 512),
                                       Projection::Cylindrical(1024, 768, -2.356, 2.356)}) {
    FeatureFinder finder{FeatureOptions{}};
    const FeatureSet set = finder.Find(MakeFeatureImage(Spots(projection, spots, 0.015), 1024));
    const double pixel = 2.0 * M_PI / 1024;
    for (const Vector3d& spot : spots) {
      EXPECT_LT(NearestAngle(set, spot) / pixel, 0.125)
          << ToString(projection.kind()) << " " << spot.transpose();
    }
  }
}

TEST(Features, ClearanceIsTheDistanceToTheMaskRoundTheSeamAsWell) {
  const Projection projection = Projection::Equirectangular(256, 128);
  Measurement m = Spots(projection, {}, 0.1);
  m.flags.row(64)[2] = kMasked;
  const FeatureImage image = MakeFeatureImage(m, 256);
  int row = 0;
  while (image.clearance.row(row)[2] > 0.0F) ++row;
  int last = row;  // the masked pixel may lie under two rows
  while (image.clearance.row(last + 1)[2] <= 0.0F) ++last;
  EXPECT_EQ(image.clearance.row(row)[12], 10.0F);
  EXPECT_EQ(image.clearance.row(row)[250], 8.0F);
  EXPECT_EQ(image.clearance.row(last + 7)[2], 7.0F);
  EXPECT_EQ(image.clearance.row(row - 7)[2], 7.0F);
  EXPECT_NEAR(image.clearance.row(last + 4)[254], 4.0F * std::sqrt(2.0F), 0.01F);
  EXPECT_EQ(image.clearance.row(row)[130], kMostClearance);
}

TEST(Features, TheExposureOfAPictureIsNotSeenInItsFeaturePicture) {
  const Projection projection = Projection::Equirectangular(512, 256);
  const Image<float> radiance = test::Room(3).Render(Pose{}, projection);
  const FeatureImage a = MakeFeatureImage(test::Expose(radiance, projection, 0.05, 1), 512);
  const FeatureImage b = MakeFeatureImage(test::Expose(radiance, projection, 0.2, 2), 512);
  double squares = 0.0;
  double count = 0.0;
  for (int y = 0; y < a.height(); ++y) {
    for (int x = 0; x < a.width(); ++x) {
      if (a.clearance.row(y)[x] <= 0.0F || b.clearance.row(y)[x] <= 0.0F) continue;
      if (a.log_radiance.row(y)[x] < std::log(5.0F * a.softening)) continue;  // mostly noise
      const double difference = a.log_radiance.row(y)[x] - b.log_radiance.row(y)[x];
      squares += difference * difference;
      count += 1.0;
    }
  }
  EXPECT_GT(count, 0.2 * a.width() * a.height());
  EXPECT_LT(std::sqrt(squares / count), 0.15);
}

TEST(Features, NoneTouchesAMaskAndAMaskedPictureHasNone) {
  const Projection projection = Projection::Equirectangular(512, 256);
  const Image<float> radiance = test::Room(4).Render(Pose{}, projection);
  Image<std::uint8_t> mask(512, 256, 1, 255);
  for (int y = 100; y < 256; ++y) std::fill_n(mask.row(y), 300, std::uint8_t{0});
  FeatureFinder finder{FeatureOptions{}};
  const FeatureSet set =
      finder.Find(MakeFeatureImage(test::Expose(radiance, projection, 0.2, 1, mask), 512));
  EXPECT_GT(set.size(), 100);
  for (const Feature& feature : set.features) {
    const Eigen::Vector2d at = projection.PixelFromRay(feature.ray);
    const bool in_mask = at.y() > 100.0 && at.x() < 300.0;
    EXPECT_FALSE(in_mask) << at.transpose();
  }
  const Image<std::uint8_t> all(512, 256, 1);
  EXPECT_EQ(
      finder.Find(MakeFeatureImage(test::Expose(radiance, projection, 0.2, 1, all), 512)).size(),
      0);
}

TEST(Features, TheNumberOfWorkersDoesNotShow) {
  const Projection projection = Projection::Cylindrical(512, 384, -2.0, 2.0);
  const Measurement m = test::Expose(test::Room(5).Render(Pose{}, projection), projection, 0.1, 1);
  SetWorkerCount(1);
  FeatureFinder one{FeatureOptions{}};
  const FeatureSet a = one.Find(MakeFeatureImage(m, 512));
  SetWorkerCount(4);
  FeatureFinder four{FeatureOptions{}};
  four.Find(
      MakeFeatureImage(test::Expose(test::Room(6).Render(Pose{}, projection), projection, 0.1, 1),
                       512));  // leaves its traces in the buffers
  const FeatureSet b = four.Find(MakeFeatureImage(m, 512));
  SetWorkerCount(0);
  ASSERT_EQ(a.size(), b.size());
  EXPECT_GT(a.size(), 200);
  EXPECT_EQ(a.descriptors, b.descriptors);
  for (int i = 0; i < a.size(); ++i) {
    const auto k = static_cast<std::size_t>(i);
    EXPECT_EQ(a.features[k].x, b.features[k].x);
    EXPECT_EQ(a.features[k].y, b.features[k].y);
    EXPECT_EQ(a.features[k].ray, b.features[k].ray);
  }
}

TEST(Features, TheyAreSpreadWhenThereAreTooMany) {
  const Projection projection = Projection::Equirectangular(512, 256);
  const Measurement m = test::Expose(test::Room(7).Render(Pose{}, projection), projection, 0.1, 1);
  FeatureOptions options;
  options.max_features = 200;
  FeatureFinder finder{options};
  const FeatureSet set = finder.Find(MakeFeatureImage(m, 512));
  EXPECT_EQ(set.size(), 200);
  std::array<int, 8> octants{};
  for (const Feature& f : set.features) {
    ++octants[static_cast<std::size_t>((f.ray.x() > 0) + 2 * (f.ray.y() > 0) +
                                       4 * (f.ray.z() > 0))];
  }
  for (const int count : octants) EXPECT_GE(count, 10);
}

TEST(Features, APictureTooSmallOrWithoutTextureHasNone) {
  FeatureFinder finder{FeatureOptions{}};
  const Projection tiny = Projection::Equirectangular(32, 16);
  EXPECT_EQ(finder.Find(MakeFeatureImage(Spots(tiny, {}, 0.1), 1024)).size(), 0);
  const Projection projection = Projection::Equirectangular(512, 256);
  EXPECT_EQ(finder.Find(MakeFeatureImage(Spots(projection, {}, 0.1), 512)).size(), 0);
}

}  // namespace
}  // namespace omnihdr::features_test
