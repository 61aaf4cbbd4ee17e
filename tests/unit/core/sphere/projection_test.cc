#include "core/sphere/projection.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>
#include <vector>

namespace omnihdr::projection_test {
namespace {

constexpr double kPi = std::numbers::pi;

const Projection kLatLong = Projection::Equirectangular(2048, 1024);
const Projection kCylinder = Projection::Cylindrical(1536, 1152, -2.0, 2.5);

void ExpectRay(const Eigen::Vector3d& ray, double x, double y, double z) {
  EXPECT_NEAR(ray.x(), x, 1e-12);
  EXPECT_NEAR(ray.y(), y, 1e-12);
  EXPECT_NEAR(ray.z(), z, 1e-12);
}

TEST(Projection, TheCentreLooksForwardAlongX) {
  ExpectRay(kLatLong.RayFromPixel(1024.0, 512.0), 1.0, 0.0, 0.0);
  const Projection even = Projection::Cylindrical(1536, 1152, -2.0, 2.0);
  ExpectRay(even.RayFromPixel(768.0, 576.0), 1.0, 0.0, 0.0);
}

TEST(Projection, RightInTheImageIsMinusY) {
  ExpectRay(kLatLong.RayFromPixel(1536.0, 512.0), 0.0, -1.0, 0.0);
  ExpectRay(kLatLong.RayFromPixel(512.0, 512.0), 0.0, 1.0, 0.0);
  EXPECT_LT(kCylinder.RayFromPixel(1152.0, 500.0).y(), 0.0);
}

TEST(Projection, TheImagesEdgesLookBackward) {
  ExpectRay(kLatLong.RayFromPixel(0.0, 512.0), -1.0, 0.0, 0.0);
  ExpectRay(kLatLong.RayFromPixel(2048.0, 512.0), -1.0, 0.0, 0.0);
}

TEST(Projection, TheTopLooksUp) {
  ExpectRay(kLatLong.RayFromPixel(77.0, 0.0), 0.0, 0.0, 1.0);
  ExpectRay(kLatLong.RayFromPixel(77.0, 1024.0), 0.0, 0.0, -1.0);
  const Eigen::Vector3d top = kCylinder.RayFromPixel(0.0, 0.0);
  EXPECT_NEAR(top.z() / std::hypot(top.x(), top.y()), 2.5, 1e-12);
  const Eigen::Vector3d bottom = kCylinder.RayFromPixel(0.0, 1152.0);
  EXPECT_NEAR(bottom.z() / std::hypot(bottom.x(), bottom.y()), -2.0, 1e-12);
}

TEST(Projection, FollowsTheFormulasOfTheConventions) {
  const Eigen::Vector3d ray = Eigen::Vector3d(0.4, -0.7, 0.2);
  const double theta = std::atan2(-0.7, 0.4);
  const double phi = std::acos(0.2 / ray.norm());
  const Eigen::Vector2d latlong = kLatLong.PixelFromRay(ray);
  EXPECT_NEAR(latlong.x(), 2048.0 * (kPi - theta) / (2.0 * kPi), 1e-9);
  EXPECT_NEAR(latlong.y(), 1024.0 * phi / kPi, 1e-9);
  const Eigen::Vector2d cylinder = kCylinder.PixelFromRay(ray);
  EXPECT_NEAR(cylinder.x(), 1536.0 * (kPi - theta) / (2.0 * kPi), 1e-9);
  const double z = 0.2 / std::hypot(0.4, 0.7);
  EXPECT_NEAR(cylinder.y(), 1152.0 * (2.5 - z) / 4.5, 1e-9);
}

TEST(Projection, TheLengthOfARayDoesNotMatter) {
  const Eigen::Vector3d ray(0.3, 0.5, -0.6);
  for (const Projection& p : {kLatLong, kCylinder}) {
    EXPECT_NEAR((p.PixelFromRay(ray) - p.PixelFromRay(1e-3 * ray)).norm(), 0.0, 1e-9);
    EXPECT_NEAR((p.PixelFromRay(ray) - p.PixelFromRay(1e6 * ray)).norm(), 0.0, 1e-9);
  }
}

TEST(Projection, ColumnsStayBelowTheWidthAtTheSeam) {
  for (const double y : {0.0, -0.0, 1e-18, -1e-18, 1e-9, -1e-9}) {
    const Eigen::Vector2d p = kLatLong.PixelFromRay({-1.0, y, 0.0});
    EXPECT_GE(p.x(), 0.0);
    EXPECT_LT(p.x(), 2048.0);
  }
}

TEST(Projection, AllPixelsTogetherAreTheSphere) {
  for (const Projection& p :
       {Projection::Equirectangular(64, 32), Projection::Equirectangular(100, 37), kLatLong}) {
    double sum = 0.0;
    for (int row = 0; row < p.height(); ++row) sum += p.width() * p.PixelSolidAngle(row);
    EXPECT_NEAR(sum, 4.0 * kPi, 1e-9);
  }
}

TEST(Projection, AllPixelsOfACylinderTogetherAreTheBandItCovers) {
  for (const auto& [low, high] : std::vector<std::pair<double, double>>{
           {-2.0, 2.5}, {0.1, 0.2}, {-100.0, 100.0}, {-3.0, -1.0}}) {
    const Projection p = Projection::Cylindrical(50, 41, low, high);
    double sum = 0.0;
    for (int row = 0; row < p.height(); ++row) {
      EXPECT_GT(p.PixelSolidAngle(row), 0.0);
      sum += p.width() * p.PixelSolidAngle(row);
    }
    const double band = 2.0 * kPi * (std::sin(std::atan(high)) - std::sin(std::atan(low)));
    EXPECT_NEAR(sum, band, 1e-9);
  }
}

TEST(Projection, ACylinderCoversItsBandOnly) {
  EXPECT_TRUE(kCylinder.Covers({1.0, 0.0, 2.49}));
  EXPECT_FALSE(kCylinder.Covers({1.0, 0.0, 2.51}));
  EXPECT_TRUE(kCylinder.Covers({0.0, 1.0, -1.99}));
  EXPECT_FALSE(kCylinder.Covers({0.0, 1.0, -2.01}));
  EXPECT_FALSE(kCylinder.Covers({0.0, 0.0, 1.0}));
  EXPECT_FALSE(kCylinder.Covers({0.0, 0.0, -1.0}));
}

TEST(Projection, ALatLongCoversEverything) {
  for (const Eigen::Vector3d& ray :
       {Eigen::Vector3d(0, 0, 1), Eigen::Vector3d(0, 0, -1), Eigen::Vector3d(-1, 1e-9, 0.3)}) {
    EXPECT_TRUE(kLatLong.Covers(ray));
  }
}

TEST(Projection, StraightUpIsAFinitePointOnACylinder) {
  for (const double z : {1.0, -1.0, 1e-200, 1e200}) {
    const Eigen::Vector2d p = kCylinder.PixelFromRay({0.0, 0.0, z});
    EXPECT_TRUE(std::isfinite(p.x()));
    EXPECT_TRUE(std::isfinite(p.y()));
    EXPECT_TRUE(z > 0.0 ? p.y() < 0.0 : p.y() > 1152.0);
  }
}

TEST(Projection, AnotherSizeIsTheSameMapping) {
  const Eigen::Vector3d ray = Eigen::Vector3d(0.3, 0.5, -0.6).normalized();
  for (const Projection& p : {kLatLong, kCylinder}) {
    const Projection half = p.Resized(p.width() / 2, p.height() / 2);
    EXPECT_EQ(half.kind(), p.kind());
    const Eigen::Vector2d full = p.PixelFromRay(ray);
    const Eigen::Vector2d small = half.PixelFromRay(ray);
    EXPECT_NEAR((full - 2.0 * small).norm(), 0.0, 1e-9);
  }
}

TEST(ProjectionKind, NamesRoundTrip) {
  for (const ProjectionKind kind :
       {ProjectionKind::kEquirectangular, ProjectionKind::kCylindrical}) {
    EXPECT_EQ(ProjectionKindFromString(ToString(kind)), kind);
  }
  EXPECT_FALSE(ProjectionKindFromString("fisheye"));
  EXPECT_FALSE(ProjectionKindFromString(""));
}

}  // namespace
}  // namespace omnihdr::projection_test
