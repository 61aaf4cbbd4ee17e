#include "core/stereo/row_geometry.h"

#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <cmath>

namespace omnihdr::row_geometry_test {
namespace {

const Eigen::Matrix3f kTurn = (Eigen::AngleAxisf(0.7F, Eigen::Vector3f::UnitZ()) *
                               Eigen::AngleAxisf(0.3F, Eigen::Vector3f(0.6F, 0.8F, 0.0F)))
                                  .toRotationMatrix();

Measurement Blank(const Projection& projection, int width, int height) {
  Measurement m;
  m.projection = projection;
  m.radiance = Image<float>(width, height, 4, 1.0F);
  m.flags = Image<std::uint8_t>(width, height, 1, 0);
  return m;
}

class Geometry : public ::testing::TestWithParam<bool> {
 protected:
  static Measurement Seen() {
    return GetParam() ? Blank(Projection::Cylindrical(96, 40, -0.8, 0.9), 96, 40)
                      : Blank(Projection::Equirectangular(96, 48), 96, 48);
  }
};

TEST_P(Geometry, ARowIsWhatEveryPixelAloneWouldBe) {
  const Measurement m = Seen();
  const PanoramaSampler view(m);
  const LatLongGrid output(50, 25);
  const LatLongGrid grid(32, 16);
  const Eigen::Vector3f offset(0.3F, -0.2F, 0.1F);
  const Eigen::Matrix3f camera_from_world = kTurn.transpose();
  for (const int step : {1, 2, 3}) {
    for (int y = 0; y < output.height(); y += 4) {
      const int first = step / 2;
      RayRow rays;
      RaysOfRow(output, y, first, step, kTurn, &rays);
      ASSERT_EQ(static_cast<int>(rays.size()), (output.width() - first + step - 1) / step);
      PointRow points;
      PointsInView(rays, camera_from_world, view, &points);
      PointRow on_grid;
      PointsOnGrid(rays, grid, &on_grid);
      std::vector<float> disparity(rays.size());
      for (std::size_t i = 0; i < rays.size(); ++i) {
        disparity[i] = 0.1F * static_cast<float>(i % 5);  // some infinitely far
      }
      SeenRow seen;
      SurfacePointsInView(rays, disparity, offset, camera_from_world, view, grid, &seen);
      for (std::size_t i = 0; i < rays.size(); ++i) {
        const Eigen::Vector3f ray = kTurn * output.Ray(first + static_cast<int>(i) * step, y);
        const Eigen::Vector3f there = camera_from_world * ray;
        float px = 0.0F;
        float py = 0.0F;
        view.PixelFromRay(there.x(), there.y(), there.z(), &px, &py);
        EXPECT_NEAR(points.x[i], px, 1e-3F);
        EXPECT_NEAR(points.y[i], py, 1e-3F * (1.0F + std::abs(py)));
        grid.Point(ray, &px, &py);
        EXPECT_NEAR(on_grid.x[i], px, 1e-3F);
        EXPECT_NEAR(on_grid.y[i], py, 1e-3F);

        const Eigen::Vector3f point = ray - disparity[i] * offset;
        EXPECT_NEAR(seen.distance[i], point.norm(), 1e-5F);
        const Eigen::Vector3f in_view = camera_from_world * point;
        view.PixelFromRay(in_view.x(), in_view.y(), in_view.z(), &px, &py);
        EXPECT_NEAR(seen.image.x[i], px, 1e-3F);
        EXPECT_NEAR(seen.image.y[i], py, 1e-3F * (1.0F + std::abs(py)));
        grid.Point(point, &px, &py);
        EXPECT_NEAR(static_cast<float>(seen.grid_column[i]) + 0.5F, px, 0.501F);
        EXPECT_NEAR(static_cast<float>(seen.grid_row[i]) + 0.5F, py, 0.501F);
        EXPECT_LT(seen.grid_column[i], grid.width());
        EXPECT_LT(seen.grid_row[i], grid.height());
      }
    }
  }
}

INSTANTIATE_TEST_SUITE_P(Projections, Geometry, ::testing::Bool());

}  // namespace
}  // namespace omnihdr::row_geometry_test
