#include "core/sphere/pose.h"

#include <gtest/gtest.h>

#include <numbers>

namespace omnihdr::pose_test {
namespace {

TEST(Pose, IsTheIdentityUntilSet) {
  const Eigen::Vector3d x(1.0, 2.0, 3.0);
  EXPECT_EQ(Pose{}.WorldFromCamera(x), x);
  EXPECT_EQ(Pose{}.CameraFromWorld(x), x);
}

TEST(Pose, RotatesThenTranslates) {
  const Pose world_from_camera = {
      Eigen::Quaterniond(Eigen::AngleAxisd(std::numbers::pi / 2.0, Eigen::Vector3d::UnitZ())),
      {10.0, 0.0, 0.0}};
  // A quarter turn to the left: what lies ahead of the camera lies along the world's Y.
  const Eigen::Vector3d x_in_world = world_from_camera.WorldFromCamera({2.0, 0.0, 1.0});
  EXPECT_NEAR((x_in_world - Eigen::Vector3d(10.0, 2.0, 1.0)).norm(), 0.0, 1e-12);
}

TEST(Pose, TheCamerasCentreIsItsTranslation) {
  const Pose pose = {Eigen::Quaterniond(0.3, 0.1, -0.7, 0.2).normalized(), {1.0, -2.0, 3.0}};
  EXPECT_NEAR((pose.WorldFromCamera(Eigen::Vector3d::Zero()) - pose.translation).norm(), 0.0,
              1e-15);
  EXPECT_NEAR(pose.CameraFromWorld(pose.translation).norm(), 0.0, 1e-15);
}

}  // namespace
}  // namespace omnihdr::pose_test
