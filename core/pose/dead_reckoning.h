#pragma once

#include <optional>

#include "core/session/pose_notes.h"
#include "core/sphere/pose.h"

namespace omnihdr {

// Sigma of a distance between positions by odometer: a share of it plus a length in metres.
inline constexpr double kOdometerShare = 0.003;
inline constexpr double kOdometerFloor = 0.002;

// How much the camera has turned to the left about the world's vertical, in radian, (-pi, pi], by
// two compass headings in degrees (clockwise).
double TurnFromHeadings(double before_deg, double after_deg);
// The turn to the left about the world's vertical that is part of a rotation in the world.
double TurnOf(const Eigen::Quaterniond& world_rotation);
// 1 where a turn and headings agree within their noise, falling towards 0 the more sigmas apart.
double HeadingAgreement(double turn_rad, double turn_by_heading_rad, double sigma_rad);

// Where a vehicle has got to from `last`: turned by `turn_rad` about the vertical, and `travelled`
// metres on along an arc, in the direction (in the camera) in which it had come from `before`;
// forward where that is not known. Lengths in metres.
Pose DeadReckon(const Pose& last, const std::optional<Pose>& before, double turn_rad,
                double travelled);

// How well that is known: rotation as the headings' difference, on all axes since the tilt is only
// assumed to stay; translation by the odometer and by the heading's error across, added to the
// error of the pose it began at.
PoseSigma DeadReckoningSigma(double travelled, double heading_sigma_deg,
                             const std::optional<PoseSigma>& of_last);

}  // namespace omnihdr
