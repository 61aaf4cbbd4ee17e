#include "core/pose/bundle_adjustment.h"

#include <ceres/ceres.h>

#include <Eigen/Dense>
#include <array>
#include <cmath>
#include <memory>

namespace omnihdr {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;
using Matrix23 = Eigen::Matrix<double, 2, 3, Eigen::RowMajor>;
using Matrix26 = Eigen::Matrix<double, 2, 6, Eigen::RowMajor>;

// Residuals are in units of this angle, so that those of distances (in sigmas) weigh in fairly.
constexpr double kUnitAngle = 1.0e-3;

Matrix3d Skew(const Vector3d& v) {
  Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

Matrix3d RotationFromVector(const Vector3d& turn) {
  const double angle = turn.norm();
  if (angle < 1e-12) return Matrix3d::Identity() + Skew(turn);
  return Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix();
}

// Right Jacobian of the rotation group: exp(turn + δ) = exp(turn)·exp(J·δ).
Matrix3d RightJacobian(const Vector3d& turn) {
  const double angle = turn.norm();
  const Matrix3d k = Skew(turn);
  if (angle < 1e-6) return Matrix3d::Identity() - 0.5 * k;
  const double square = angle * angle;
  return Matrix3d::Identity() - (1.0 - std::cos(angle)) / square * k +
         (angle - std::sin(angle)) / (square * angle) * k * k;
}

// Parameters: camera (turn from the start rotation, translation), point (two tangential steps from
// the start direction, inverse distance).
class AngleCost final : public ceres::SizedCostFunction<2, 6, 3> {
 public:
  AngleCost(const Matrix3d& start_rotation, const BundlePoint& point, const Vector3d& tangent1,
            const Vector3d& tangent2, const BundleObservation& observation)
      : start_rotation_(start_rotation),
        point_(point),
        tangent1_(tangent1),
        tangent2_(tangent2),
        weight_(observation.weight / kUnitAngle) {
    const Vector3d e1 = observation.ray.unitOrthogonal();
    across_.row(0) = e1;
    across_.row(1) = observation.ray.cross(e1);
  }

  bool Evaluate(const double* const* parameters, double* residuals,
                double** jacobians) const override {
    const Eigen::Map<const Vector3d> turn(parameters[0]);
    const Eigen::Map<const Vector3d> translation(parameters[0] + 3);
    const double* p = parameters[1];
    const Matrix3d camera_from_world = (start_rotation_ * RotationFromVector(turn)).transpose();
    const Vector3d offset = point_.reference - translation;
    const Vector3d direction =
        point_.direction + p[0] * tangent1_ + p[1] * tangent2_ + p[2] * offset;
    const Vector3d seen = camera_from_world * direction;
    const double length = seen.norm();
    if (!(length > 1e-9)) return false;
    const Eigen::Vector2d projected = across_ * seen / length;
    Eigen::Map<Eigen::Vector2d>(residuals, 2) = weight_ * projected;
    if (jacobians == nullptr) return true;
    const Matrix23 by_seen = weight_ / length * (across_ - projected * (seen / length).transpose());
    if (jacobians[0] != nullptr) {
      Eigen::Map<Matrix26> j(jacobians[0]);
      j.leftCols<3>() = by_seen * Skew(seen) * RightJacobian(turn);
      j.rightCols<3>() = -p[2] * by_seen * camera_from_world;
    }
    if (jacobians[1] != nullptr) {
      Eigen::Map<Matrix23> j(jacobians[1]);
      const Matrix23 by_direction = by_seen * camera_from_world;
      j.col(0) = by_direction * tangent1_;
      j.col(1) = by_direction * tangent2_;
      j.col(2) = by_direction * offset;
    }
    return true;
  }

 private:
  Matrix3d start_rotation_;
  BundlePoint point_;
  Vector3d tangent1_;
  Vector3d tangent2_;
  Matrix23 across_;
  double weight_;
};

class DistanceCost final : public ceres::SizedCostFunction<1, 6, 6> {
 public:
  explicit DistanceCost(const BundleDistance& distance) : distance_(distance) {}
  bool Evaluate(const double* const* parameters, double* residuals,
                double** jacobians) const override {
    const Vector3d between = Eigen::Map<const Vector3d>(parameters[1] + 3) -
                             Eigen::Map<const Vector3d>(parameters[0] + 3);
    const double length = between.norm();
    residuals[0] = (length - distance_.distance) / distance_.sigma;
    if (jacobians == nullptr) return true;
    const Vector3d slope =
        length > 1e-12 ? Vector3d(between / (length * distance_.sigma)) : Vector3d::Zero();
    for (int k = 0; k < 2; ++k) {
      if (jacobians[k] == nullptr) continue;
      Eigen::Map<Eigen::Matrix<double, 1, 6>> j(jacobians[k]);
      j.setZero();
      j.tail<3>() = (k == 0 ? -1.0 : 1.0) * slope.transpose();
    }
    return true;
  }

 private:
  BundleDistance distance_;
};

}  // namespace

Vector3d RayFromPoint(const Pose& world_from_camera, const BundlePoint& point) {
  return world_from_camera.rotation.conjugate() *
         (point.direction +
          point.inverse_distance * (point.reference - world_from_camera.translation));
}

double AngularError(const Bundle& bundle, const BundleObservation& observation) {
  const Vector3d seen =
      RayFromPoint(bundle.cameras[static_cast<std::size_t>(observation.camera)].world_from_camera,
                   bundle.points[static_cast<std::size_t>(observation.point)]);
  return std::atan2(seen.cross(observation.ray).norm(), seen.dot(observation.ray));
}

bool AdjustBundle(const BundleOptions& options, Bundle* bundle) {
  std::vector<std::array<double, 6>> cameras(bundle->cameras.size());
  std::vector<std::array<double, 3>> points(bundle->points.size());
  std::vector<Matrix3d> rotations;
  std::vector<std::array<Vector3d, 2>> tangents;
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    const Pose& pose = bundle->cameras[i].world_from_camera;
    rotations.push_back(pose.rotation.toRotationMatrix());
    cameras[i] = {0.0, 0.0, 0.0, pose.translation.x(), pose.translation.y(), pose.translation.z()};
  }
  for (std::size_t i = 0; i < points.size(); ++i) {
    const Vector3d t1 = bundle->points[i].direction.unitOrthogonal();
    tangents.push_back({t1, bundle->points[i].direction.cross(t1)});
    points[i] = {0.0, 0.0, bundle->points[i].inverse_distance};
  }

  ceres::Problem::Options problem_options;
  problem_options.loss_function_ownership = ceres::DO_NOT_TAKE_OWNERSHIP;
  ceres::HuberLoss huber(options.huber_rad / kUnitAngle);
  ceres::Problem problem(problem_options);
  const auto ordering = std::make_shared<ceres::ParameterBlockOrdering>();
  for (std::size_t i = 0; i < cameras.size(); ++i) {
    problem.AddParameterBlock(cameras[i].data(), 6);
    if (bundle->cameras[i].fixed) problem.SetParameterBlockConstant(cameras[i].data());
    ordering->AddElementToGroup(cameras[i].data(), 1);
  }
  std::vector<bool> used(points.size(), false);
  for (const BundleObservation& observation : bundle->observations) {
    const auto camera = static_cast<std::size_t>(observation.camera);
    const auto point = static_cast<std::size_t>(observation.point);
    problem.AddResidualBlock(
        std::make_unique<AngleCost>(rotations[camera], bundle->points[point], tangents[point][0],
                                    tangents[point][1], observation)
            .release(),
        &huber, cameras[camera].data(), points[point].data());
    if (!used[point]) ordering->AddElementToGroup(points[point].data(), 0);
    used[point] = true;
  }
  for (const BundleDistance& distance : bundle->distances) {
    problem.AddResidualBlock(std::make_unique<DistanceCost>(distance).release(), nullptr,
                             cameras[static_cast<std::size_t>(distance.a)].data(),
                             cameras[static_cast<std::size_t>(distance.b)].data());
  }

  ceres::Solver::Options solver;
  solver.linear_solver_type = ceres::DENSE_SCHUR;
  solver.linear_solver_ordering = ordering;
  solver.num_threads = 1;
  solver.max_num_iterations = options.max_iterations;
  solver.function_tolerance = 1e-7;
  solver.parameter_tolerance = 1e-9;
  solver.logging_type = ceres::SILENT;
  ceres::Solver::Summary summary;
  ceres::Solve(solver, &problem, &summary);
  if (!summary.IsSolutionUsable()) return false;

  for (std::size_t i = 0; i < cameras.size(); ++i) {
    if (bundle->cameras[i].fixed) continue;
    Pose& pose = bundle->cameras[i].world_from_camera;
    pose.rotation =
        Eigen::Quaterniond(rotations[i] * RotationFromVector(Vector3d(cameras[i].data())))
            .normalized();
    pose.translation = Vector3d(cameras[i].data() + 3);
  }
  for (std::size_t i = 0; i < points.size(); ++i) {
    if (!used[i]) continue;
    BundlePoint& point = bundle->points[i];
    const Vector3d direction =
        point.direction + points[i][0] * tangents[i][0] + points[i][1] * tangents[i][1];
    const double length = direction.norm();
    point.direction = direction / length;
    point.inverse_distance = points[i][2] / length;
  }
  return true;
}

}  // namespace omnihdr
