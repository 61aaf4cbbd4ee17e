#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <cmath>
#include <numbers>

#include "core/sphere/pose.h"
#include "core/sphere/projection.h"
#include "tests/property/generators.h"

namespace omnihdr::sphere_test {
namespace {

using testing::AnyPose;
using testing::Between;

// Distance of two image points on a picture that closes round.
double PixelDistance(const Eigen::Vector2d& a, const Eigen::Vector2d& b, int width) {
  double dx = std::abs(a.x() - b.x());
  dx = std::min(dx, width - dx);
  return std::hypot(dx, a.y() - b.y());
}

RC_GTEST_PROP(ProjectionLaw, ALatLongPointComesBackThroughItsRay, ()) {
  const int width = *rc::gen::inRange(2, 8192);
  const int height = *rc::gen::inRange(2, 4096);
  const Projection p = Projection::Equirectangular(width, height);
  // At the poles themselves a row is one direction: its column cannot come back.
  const Eigen::Vector2d point(*Between(0.0, width), *Between(0.01, height - 0.01));
  const Eigen::Vector3d ray = p.RayFromPixel(point.x(), point.y());
  RC_ASSERT(std::abs(ray.norm() - 1.0) < 1e-12);
  RC_ASSERT(PixelDistance(p.PixelFromRay(ray), point, width) < 1e-5);
}

RC_GTEST_PROP(ProjectionLaw, ACylindersPointComesBackThroughItsRay, ()) {
  const int width = *rc::gen::inRange(2, 8192);
  const int height = *rc::gen::inRange(2, 4096);
  const double z_min = *Between(-5.0, 4.0);
  const Projection p = Projection::Cylindrical(width, height, z_min, z_min + *Between(0.1, 6.0));
  const Eigen::Vector2d point(*Between(0.0, width), *Between(0.0, height));
  const Eigen::Vector3d ray = p.RayFromPixel(point.x(), point.y());
  RC_ASSERT(std::abs(ray.norm() - 1.0) < 1e-12);
  RC_ASSERT(PixelDistance(p.PixelFromRay(ray), point, width) < 1e-5);
}

RC_GTEST_PROP(ProjectionLaw, ARayComesBackThroughItsPoint, ()) {
  const Projection p = *rc::gen::element(Projection::Equirectangular(2048, 1024),
                                         Projection::Cylindrical(1536, 1152, -2.4, 2.4));
  const Eigen::Vector3d ray = testing::AnyUnitVector();
  RC_PRE(std::hypot(ray.x(), ray.y()) > 1e-6);
  RC_PRE(p.Covers(ray));
  const Eigen::Vector2d point = p.PixelFromRay(ray);
  RC_ASSERT(point.x() >= 0.0);
  RC_ASSERT(point.x() < p.width());
  RC_ASSERT((p.RayFromPixel(point.x(), point.y()) - ray).norm() < 1e-9);
}

RC_GTEST_PROP(ProjectionLaw, SolidAnglesOfRowsAddUpWhateverTheSize, ()) {
  const int height = *rc::gen::inRange(1, 500);
  const double z_min = *Between(-5.0, 4.0);
  const double z_max = z_min + *Between(0.1, 6.0);
  const Projection p = Projection::Cylindrical(7, height, z_min, z_max);
  double sum = 0.0;
  for (int row = 0; row < height; ++row) sum += 7 * p.PixelSolidAngle(row);
  const double band =
      2.0 * std::numbers::pi * (std::sin(std::atan(z_max)) - std::sin(std::atan(z_min)));
  RC_ASSERT(std::abs(sum - band) < 1e-9);
}

RC_GTEST_PROP(PoseLaw, CompositionAppliesOneAfterTheOther, ()) {
  const Pose a_from_b = AnyPose();
  const Pose b_from_c = AnyPose();
  const Eigen::Vector3d x_in_c = 5.0 * testing::AnyUnitVector();
  const Eigen::Vector3d composed = (a_from_b * b_from_c).WorldFromCamera(x_in_c);
  const Eigen::Vector3d step_by_step = a_from_b.WorldFromCamera(b_from_c.WorldFromCamera(x_in_c));
  RC_ASSERT((composed - step_by_step).norm() < 1e-9);
}

RC_GTEST_PROP(PoseLaw, CompositionIsAssociative, ()) {
  const Pose a = AnyPose();
  const Pose b = AnyPose();
  const Pose c = AnyPose();
  const Pose left = (a * b) * c;
  const Pose right = a * (b * c);
  RC_ASSERT(left.rotation.angularDistance(right.rotation) < 1e-7);
  RC_ASSERT((left.translation - right.translation).norm() < 1e-9);
}

RC_GTEST_PROP(PoseLaw, TheInverseUndoes, ()) {
  const Pose pose = AnyPose();
  const Eigen::Vector3d x = 5.0 * testing::AnyUnitVector();
  RC_ASSERT((pose.CameraFromWorld(pose.WorldFromCamera(x)) - x).norm() < 1e-9);
  RC_ASSERT((pose.Inverse().WorldFromCamera(x) - pose.CameraFromWorld(x)).norm() < 1e-9);
  const Pose nothing = pose * pose.Inverse();
  RC_ASSERT(nothing.rotation.angularDistance(Eigen::Quaterniond::Identity()) < 1e-7);
  RC_ASSERT(nothing.translation.norm() < 1e-9);
}

}  // namespace
}  // namespace omnihdr::sphere_test
