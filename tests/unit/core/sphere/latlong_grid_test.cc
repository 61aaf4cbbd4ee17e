#include "core/sphere/latlong_grid.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "core/sphere/projection.h"

namespace omnihdr::latlong_grid_test {
namespace {

TEST(LatLongGrid, RaysAreThoseOfTheEquirectangularProjection) {
  const LatLongGrid grid(64, 32);
  const Projection projection = Projection::Equirectangular(64, 32);
  for (int y = 0; y < 32; ++y) {
    for (int x = 0; x < 64; ++x) {
      const Eigen::Vector3d exact = projection.RayFromPixel(x + 0.5, y + 0.5);
      EXPECT_LT((grid.Ray(x, y).cast<double>() - exact).norm(), 3e-7);
    }
  }
}

TEST(LatLongGrid, PointsAreThoseOfTheProjectionToAThousandthOfAPixel) {
  const LatLongGrid grid(4096, 2048);
  const Projection projection = Projection::Equirectangular(4096, 2048);
  std::mt19937 generator(2);
  std::normal_distribution<double> coordinate;
  for (int k = 0; k < 20000; ++k) {
    const Eigen::Vector3d ray(coordinate(generator), coordinate(generator), coordinate(generator));
    float x = 0.0F;
    float y = 0.0F;
    grid.Point(ray.cast<float>(), &x, &y);
    const Eigen::Vector2d exact = projection.PixelFromRay(ray);
    const double dx = std::abs(x - exact.x());
    EXPECT_LT(std::min(dx, 4096.0 - dx), 2e-3);
    EXPECT_NEAR(y, exact.y(), 2e-3);
  }
}

TEST(LatLongGrid, EveryPixelContainsItsOwnRay) {
  const LatLongGrid grid(128, 64);
  for (int y = 0; y < 64; ++y) {
    for (int x = 0; x < 128; ++x) {
      int px = -1;
      int py = -1;
      grid.Pixel(3.5F * grid.Ray(x, y), &px, &py);
      EXPECT_EQ(px, x);
      EXPECT_EQ(py, y);
    }
  }
}

TEST(LatLongGrid, PixelsAreInsideEvenAtThePolesAndTheSeam) {
  const LatLongGrid grid(128, 64);
  for (const Eigen::Vector3f& ray :
       {Eigen::Vector3f(0, 0, 1), Eigen::Vector3f(0, 0, -1), Eigen::Vector3f(-1, 0, 0),
        Eigen::Vector3f(-1, -0.0F, 0), Eigen::Vector3f(-1, 1e-20F, 0), Eigen::Vector3f(0, 0, 0)}) {
    int x = -1;
    int y = -1;
    grid.Pixel(ray, &x, &y);
    EXPECT_GE(x, 0);
    EXPECT_LT(x, 128);
    EXPECT_GE(y, 0);
    EXPECT_LT(y, 64);
  }
}

}  // namespace
}  // namespace omnihdr::latlong_grid_test
