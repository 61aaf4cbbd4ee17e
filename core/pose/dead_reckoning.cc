#include "core/pose/dead_reckoning.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/pose/scale.h"

namespace omnihdr {
namespace {

constexpr double kDegree = std::numbers::pi / 180.0;
constexpr double kFewSigmas = 3.0;  // as many may be noise

}  // namespace

double TurnFromHeadings(double before_deg, double after_deg) {
  return std::remainder(before_deg - after_deg, 360.0) * kDegree;
}

double TurnOf(const Eigen::Quaterniond& world_rotation) {
  return std::remainder(2.0 * std::atan2(world_rotation.z(), world_rotation.w()),
                        2.0 * std::numbers::pi);
}

double HeadingAgreement(double turn_rad, double turn_by_heading_rad, double sigma_rad) {
  const double off = std::remainder(turn_rad - turn_by_heading_rad, 2.0 * std::numbers::pi);
  const double share = off / (kFewSigmas * sigma_rad);
  return 1.0 / (1.0 + share * share);
}

Pose DeadReckon(const Pose& last, const std::optional<Pose>& before, double turn_rad,
                double travelled) {
  Eigen::Vector3d direction = Eigen::Vector3d::UnitX();  // in the camera, half-way
  if (before) {
    const Eigen::Vector3d step = last.translation - before->translation;
    const Eigen::Quaterniond halfway = before->rotation.slerp(0.5, last.rotation);
    if (step.norm() > 1e-6) direction = halfway.conjugate() * step.normalized();
  }
  const auto turned = [&](double angle) {
    return (Eigen::Quaterniond(Eigen::AngleAxisd(angle, Eigen::Vector3d::UnitZ())) * last.rotation)
        .normalized();
  };
  Pose pose;
  pose.rotation = turned(turn_rad);
  pose.translation =
      last.translation + ChordOfArc(travelled, turn_rad) * (turned(0.5 * turn_rad) * direction);
  return pose;
}

PoseSigma DeadReckoningSigma(double travelled, double heading_sigma_deg,
                             const std::optional<PoseSigma>& of_last) {
  const double turn_deg = std::numbers::sqrt2 * heading_sigma_deg;
  const double along = kOdometerShare * travelled + kOdometerFloor;
  const double across = travelled * std::sin(std::min(turn_deg, 90.0) * kDegree);
  PoseSigma sigma;
  sigma.rotation_deg.setConstant(turn_deg);
  sigma.translation.setConstant(std::hypot(along, across));
  if (of_last) {
    for (Eigen::Index i = 0; i < 3; ++i) {
      sigma.translation[i] = std::hypot(sigma.translation[i], of_last->translation[i]);
    }
  }
  return sigma;
}

}  // namespace omnihdr
