#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "core/sphere/pose.h"

namespace omnihdr {

struct BundleCamera {
  Pose world_from_camera;
  bool fixed = false;
};

// A point of the scene as a direction from a reference place and an inverse distance, so that
// points at infinity are as well-behaved as near ones: X = reference + direction /
// inverse_distance.
struct BundlePoint {
  Eigen::Vector3d reference = Eigen::Vector3d::Zero();   // world frame; constant
  Eigen::Vector3d direction = Eigen::Vector3d::UnitX();  // world frame, unit
  double inverse_distance = 0.0;
  bool fixed = false;  // its place is known
};

struct BundleObservation {
  int camera = 0;
  int point = 0;
  Eigen::Vector3d ray;  // unit, camera frame
  double weight = 1.0;  // multiplies the angle; 1 for the best features
};

// The distance between two cameras is known, to `sigma`.
struct BundleDistance {
  int a = 0;
  int b = 0;
  double distance = 0.0;
  double sigma = 1.0;
};

struct Bundle {
  std::vector<BundleCamera> cameras;
  std::vector<BundlePoint> points;
  std::vector<BundleObservation> observations;
  std::vector<BundleDistance> distances;
};

struct BundleOptions {
  double huber_rad = 1.0e-3;  // angles beyond this count linearly
  int max_iterations = 12;
};

// Direction from the camera to the point in the camera's frame, of any length; and the inverse
// distance when divided by that length: p = Rᵀ(direction + inverse_distance · (reference − t)).
Eigen::Vector3d RayFromPoint(const Pose& world_from_camera, const BundlePoint& point);
// Angle (small-angle) between an observation and its point, unweighted.
double AngularError(const Bundle& bundle, const BundleObservation& observation);

// Moves cameras and points to the least sum of Huber-weighted squared angles (thesis 4.1) and
// squared distance errors: Levenberg-Marquardt on the cameras, the points eliminated (Schur
// complement; Triggs et al. 2000). Single-threaded and deterministic. At least one camera, or
// the points some camera sees, must be fixed. On numerical failure everything stays where it was
// and the result is false.
bool AdjustBundle(const BundleOptions& options, Bundle* bundle);

// Of (rotation about the camera's axes in radian, translation in the world in the bundle's unit).
using PoseCovariance = Eigen::Matrix<double, 6, 6>;

// How well an adjusted bundle's cameras are known relative to what is fixed, one for each camera
// (zero for fixed ones): the cameras' block of the inverse of the normal equations, points
// eliminated, scaled by the variance of the angles' residuals (Huber-weighted, per degree of
// freedom; Triggs et al. 2000, section 9), distances by their own sigmas. `held`: the two cameras
// whose distance, as it is, is the unit of length; needed where nothing else sets the scale. Empty
// when the bundle does not determine it.
std::vector<PoseCovariance> CameraCovariances(const BundleOptions& options, const Bundle& bundle,
                                              const std::optional<BundleDistance>& held);

}  // namespace omnihdr
