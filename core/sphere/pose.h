#pragma once

#include <Eigen/Core>
#include <Eigen/Geometry>

namespace omnihdr {

// world_from_camera: X_world = rotation · X_camera + translation. The world frame is right-handed,
// Z up; without absolute heading it is the camera frame of the chain's first position. Lengths in
// metres when the scale is metric, else in units of the first baseline.
struct Pose {
  Eigen::Quaterniond rotation = Eigen::Quaterniond::Identity();
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();

  Eigen::Vector3d WorldFromCamera(const Eigen::Vector3d& x_in_camera) const {
    return rotation * x_in_camera + translation;
  }
  Eigen::Vector3d CameraFromWorld(const Eigen::Vector3d& x_in_world) const {
    return rotation.conjugate() * (x_in_world - translation);
  }
  Pose Inverse() const { return {rotation.conjugate(), -(rotation.conjugate() * translation)}; }
  // a_from_c = a_from_b * b_from_c.
  Pose operator*(const Pose& other) const {
    return {(rotation * other.rotation).normalized(), WorldFromCamera(other.translation)};
  }
};

}  // namespace omnihdr
