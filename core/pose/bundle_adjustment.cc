#include "core/pose/bundle_adjustment.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <optional>

namespace omnihdr {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector2d;
using Eigen::Vector3d;
using Matrix23 = Eigen::Matrix<double, 2, 3>;
using Matrix26 = Eigen::Matrix<double, 2, 6>;
using Matrix66 = PoseCovariance;
using Matrix63 = Eigen::Matrix<double, 6, 3>;
using Vector6 = Eigen::Matrix<double, 6, 1>;

// Residuals are in units of this angle, so that those of distances (in sigmas) weigh in fairly.
constexpr double kUnitAngle = 1.0e-3;
// A step that lowers the cost by less than this share of it is the last.
constexpr double kSmallGain = 1.0e-6;
constexpr double kFirstDamping = 1.0e-4;
constexpr double kMostDamping = 1.0e8;
constexpr double kHeldShare = 1.0e-6;   // sigma of a length that is held, as a share of it
constexpr double kLeastFreedom = 10.0;  // observations beyond what they have to determine

Matrix3d Skew(const Vector3d& v) {
  Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

// What does not change while poses and points do.
struct Sight {
  int camera = 0;
  Matrix23 across;  // two directions across the ray, times weight / kUnitAngle
};

class Adjuster {
 public:
  Adjuster(const BundleOptions& options, Bundle* bundle)
      : huber_(options.huber_rad / kUnitAngle),
        max_iterations_(options.max_iterations),
        bundle_(*bundle) {
    // Observations in the order of their points.
    first_.assign(bundle_.points.size() + 1, 0);
    for (const BundleObservation& o : bundle_.observations) {
      ++first_[static_cast<std::size_t>(o.point) + 1];
    }
    std::partial_sum(first_.begin(), first_.end(), first_.begin());
    std::vector<std::size_t> next(first_.begin(), first_.end() - 1);
    sights_.resize(bundle_.observations.size());
    for (const BundleObservation& o : bundle_.observations) {
      Sight& sight = sights_[next[static_cast<std::size_t>(o.point)]++];
      const Vector3d e1 = o.ray.unitOrthogonal();
      sight.camera = o.camera;
      sight.across.row(0) = e1;
      sight.across.row(1) = o.ray.cross(e1);
      sight.across *= o.weight / kUnitAngle;
    }
    block_.assign(bundle_.cameras.size(), -1);
    for (std::size_t c = 0; c < block_.size(); ++c) {
      if (!bundle_.cameras[c].fixed) block_[c] = free_cameras_++;
    }
  }

  bool Run() {
    double cost = Cost(bundle_.cameras, bundle_.points);
    if (!std::isfinite(cost)) return false;
    const std::vector<BundleCamera> cameras_before = bundle_.cameras;
    const std::vector<BundlePoint> points_before = bundle_.points;
    double damping = kFirstDamping;
    for (int iteration = 0; iteration < max_iterations_ && damping < kMostDamping; ++iteration) {
      std::vector<BundleCamera> cameras = bundle_.cameras;
      std::vector<BundlePoint> points = bundle_.points;
      if (!Step(damping, &cameras, &points)) {
        damping *= 10.0;
        continue;
      }
      const double new_cost = Cost(cameras, points);
      if (!(new_cost < cost)) {
        damping *= 10.0;
        continue;
      }
      bundle_.cameras = std::move(cameras);
      bundle_.points = std::move(points);
      damping = std::max(1e-9, 0.1 * damping);
      const double gain = cost - new_cost;
      cost = new_cost;
      if (gain <= kSmallGain * cost) break;
    }
    for (const BundleCamera& camera : bundle_.cameras) {
      if (camera.world_from_camera.rotation.coeffs().allFinite() &&
          camera.world_from_camera.translation.allFinite()) {
        continue;
      }
      bundle_.cameras = cameras_before;
      bundle_.points = points_before;
      return false;
    }
    return true;
  }

  std::vector<Matrix66> Covariances(const std::optional<BundleDistance>& held) const {
    const int size = 6 * free_cameras_;
    Normal equations;
    if (size == 0 || !Build(0.0, &equations)) return {};
    if (held) {
      BundleDistance exact = *held;
      exact.distance = Between(bundle_.cameras, exact).norm();
      exact.sigma = kHeldShare * exact.distance;
      AddDistance(exact, &equations.matrix, nullptr);
    }
    Eliminate(&equations);
    const Eigen::LLT<Eigen::MatrixXd, Eigen::Lower> factor(equations.matrix);
    if (factor.info() != Eigen::Success) return {};
    const Eigen::MatrixXd inverse = factor.solve(Eigen::MatrixXd::Identity(size, size));
    const double variance = ResidualVariance();
    if (!inverse.allFinite() || !(variance > 0.0)) return {};
    // Angles count in units that are not their noise, distances in sigmas: the covariance of the
    // estimate that was made, which is not the best one (H⁻¹ · Σ gradient · gradientᵀ · H⁻¹).
    Eigen::MatrixXd from_distances = Eigen::MatrixXd::Zero(size, size);
    for (const BundleDistance& distance : bundle_.distances) {
      AddDistance(distance, &from_distances, nullptr);
    }
    const Eigen::MatrixXd covariance =
        variance * inverse + (1.0 - variance) * (inverse * from_distances * inverse);
    std::vector<Matrix66> of_cameras(bundle_.cameras.size(), Matrix66::Zero());
    for (std::size_t c = 0; c < of_cameras.size(); ++c) {
      if (block_[c] < 0) continue;
      of_cameras[c] = covariance.block<6, 6>(6 * block_[c], 6 * block_[c]);
      if (!of_cameras[c].allFinite() || !(of_cameras[c].diagonal().minCoeff() >= 0.0)) return {};
    }
    return of_cameras;
  }

 private:
  // Of one component of a residual, in kUnitAngle², outliers counting as they did in the
  // adjustment; 0 when hardly more is observed than sought.
  double ResidualVariance() const {
    double sum = 0.0;
    double freedom = -6.0 * free_cameras_;
    for (std::size_t p = 0; p < bundle_.points.size(); ++p) {
      const BundlePoint& point = bundle_.points[p];
      if (first_[p] == first_[p + 1]) continue;
      if (!point.fixed) freedom -= 3.0;
      for (std::size_t k = first_[p]; k < first_[p + 1]; ++k) {
        const auto c = static_cast<std::size_t>(sights_[k].camera);
        const Vector3d seen = RayFromPoint(bundle_.cameras[c].world_from_camera, point);
        const double square = (sights_[k].across * seen).squaredNorm() / seen.squaredNorm();
        sum += Weight(square) * square;
        freedom += 2.0;
      }
    }
    return freedom >= kLeastFreedom && std::isfinite(sum) ? sum / freedom : 0.0;
  }

  double Loss(double square) const {
    if (square <= huber_ * huber_) return square;
    return 2.0 * huber_ * std::sqrt(square) - huber_ * huber_;
  }
  // What a squared residual counts in the normal equations.
  double Weight(double square) const {
    return square <= huber_ * huber_ ? 1.0 : huber_ / std::sqrt(square);
  }

  double Cost(const std::vector<BundleCamera>& cameras,
              const std::vector<BundlePoint>& points) const {
    std::vector<Matrix3d> camera_from_world;
    for (const BundleCamera& camera : cameras) {
      camera_from_world.push_back(camera.world_from_camera.rotation.conjugate().toRotationMatrix());
    }
    double cost = 0.0;
    for (std::size_t p = 0; p < points.size(); ++p) {
      const BundlePoint& point = points[p];
      for (std::size_t k = first_[p]; k < first_[p + 1]; ++k) {
        const auto c = static_cast<std::size_t>(sights_[k].camera);
        const Vector3d offset = point.reference - cameras[c].world_from_camera.translation;
        const Vector3d seen =
            camera_from_world[c] * (point.direction + point.inverse_distance * offset);
        cost += Loss((sights_[k].across * seen).squaredNorm() / seen.squaredNorm());
      }
    }
    for (const BundleDistance& distance : bundle_.distances) {
      const double residual =
          (Between(cameras, distance).norm() - distance.distance) / distance.sigma;
      cost += residual * residual;
    }
    return cost;
  }

  static Vector3d Between(const std::vector<BundleCamera>& cameras,
                          const BundleDistance& distance) {
    return cameras[static_cast<std::size_t>(distance.b)].world_from_camera.translation -
           cameras[static_cast<std::size_t>(distance.a)].world_from_camera.translation;
  }

  // The normal equations: camera blocks and, kept for going back, what couples each sight's camera
  // to its point.
  struct Normal {
    Eigen::MatrixXd matrix;
    Eigen::VectorXd right;
    std::vector<Matrix63> coupling;
    std::vector<Matrix3d> point_inverse;
    std::vector<Vector3d> point_right;
    std::vector<std::array<Vector3d, 2>> tangents;
  };

  // At bundle_, damped; the points not yet eliminated.
  bool Build(double damping, Normal* equations) const {
    const std::vector<BundlePoint>& points = bundle_.points;
    const int size = 6 * free_cameras_;
    Eigen::MatrixXd& normal = equations->matrix;
    Eigen::VectorXd& right = equations->right;
    normal = Eigen::MatrixXd::Zero(size, size);
    right = Eigen::VectorXd::Zero(size);
    std::vector<Matrix3d> camera_from_world;
    for (const BundleCamera& camera : bundle_.cameras) {
      camera_from_world.push_back(camera.world_from_camera.rotation.conjugate().toRotationMatrix());
    }

    std::vector<Matrix63>& coupling = equations->coupling;
    coupling.resize(sights_.size());
    equations->point_inverse.resize(points.size());
    equations->point_right.resize(points.size());
    equations->tangents.resize(points.size());
    for (std::size_t p = 0; p < points.size(); ++p) {
      const BundlePoint& point = points[p];
      const Vector3d t1 = point.direction.unitOrthogonal();
      const Vector3d t2 = point.direction.cross(t1);
      equations->tangents[p] = {t1, t2};
      Matrix3d point_normal = Matrix3d::Zero();
      Vector3d point_gradient = Vector3d::Zero();
      for (std::size_t k = first_[p]; k < first_[p + 1]; ++k) {
        const Sight& sight = sights_[k];
        const auto c = static_cast<std::size_t>(sight.camera);
        const Matrix3d& turn = camera_from_world[c];
        const Vector3d offset = point.reference - bundle_.cameras[c].world_from_camera.translation;
        const Vector3d seen = turn * (point.direction + point.inverse_distance * offset);
        const double inverse_length = 1.0 / seen.norm();
        if (!std::isfinite(inverse_length)) return false;
        const Vector2d residual = sight.across * seen * inverse_length;
        const double weight = Weight(residual.squaredNorm());
        const Matrix23 by_seen =
            inverse_length * (sight.across - residual * (inverse_length * seen).transpose());
        const Matrix23 by_direction = by_seen * turn;
        Matrix23 by_point;
        by_point.col(0) = by_direction * t1;
        by_point.col(1) = by_direction * t2;
        by_point.col(2) = by_direction * offset;
        point_normal.noalias() += weight * by_point.transpose() * by_point;
        point_gradient.noalias() -= weight * by_point.transpose() * residual;
        const int block = block_[c];
        if (block < 0) continue;
        Matrix26 by_camera;
        by_camera.leftCols<3>() = by_seen * Skew(seen);
        by_camera.rightCols<3>() = -point.inverse_distance * by_direction;
        normal.block<6, 6>(6 * block, 6 * block).noalias() +=
            weight * by_camera.transpose() * by_camera;
        right.segment<6>(6 * block).noalias() -= weight * by_camera.transpose() * residual;
        coupling[k].noalias() = weight * by_camera.transpose() * by_point;
      }
      if (point.fixed) {
        // Nothing to eliminate, and no way to go.
        equations->point_inverse[p].setZero();
        equations->point_right[p].setZero();
        continue;
      }
      point_normal.diagonal() *= 1.0 + damping;
      point_normal.diagonal().array() += 1e-9;
      equations->point_inverse[p] = point_normal.inverse();
      equations->point_right[p] = point_gradient;
    }
    for (const BundleDistance& distance : bundle_.distances) AddDistance(distance, &normal, &right);
    normal.diagonal() *= 1.0 + damping;
    normal.diagonal().array() += 1e-9;
    return true;
  }

  // What a distance adds to the cameras' equations; `right` may be null.
  void AddDistance(const BundleDistance& distance, Eigen::MatrixXd* normal,
                   Eigen::VectorXd* right) const {
    const Vector3d between = Between(bundle_.cameras, distance);
    const double length = between.norm();
    if (length < 1e-12) return;
    const double residual = (length - distance.distance) / distance.sigma;
    const Vector3d slope = between / (length * distance.sigma);
    const int a = block_[static_cast<std::size_t>(distance.a)];
    const int b = block_[static_cast<std::size_t>(distance.b)];
    const Matrix3d square = slope * slope.transpose();
    if (a >= 0) {
      normal->block<3, 3>(6 * a + 3, 6 * a + 3) += square;
      if (right != nullptr) right->segment<3>(6 * a + 3) += residual * slope;
    }
    if (b >= 0) {
      normal->block<3, 3>(6 * b + 3, 6 * b + 3) += square;
      if (right != nullptr) right->segment<3>(6 * b + 3) -= residual * slope;
    }
    if (a >= 0 && b >= 0) {
      normal->block<3, 3>(6 * a + 3, 6 * b + 3) -= square;
      normal->block<3, 3>(6 * b + 3, 6 * a + 3) -= square;
    }
  }

  // Eliminates the points: what is left are equations of the cameras, in the lower triangle.
  void Eliminate(Normal* equations) const {
    for (std::size_t p = 0; p + 1 < first_.size(); ++p) {
      for (std::size_t k = first_[p]; k < first_[p + 1]; ++k) {
        const int row = block_[static_cast<std::size_t>(sights_[k].camera)];
        if (row < 0) continue;
        const Matrix63 scaled = equations->coupling[k] * equations->point_inverse[p];
        equations->right.segment<6>(6 * row).noalias() -= scaled * equations->point_right[p];
        for (std::size_t l = first_[p]; l < first_[p + 1]; ++l) {
          const int column = block_[static_cast<std::size_t>(sights_[l].camera)];
          if (column < 0 || column > row) continue;  // the lower triangle is enough
          equations->matrix.block<6, 6>(6 * row, 6 * column).noalias() -=
              scaled * equations->coupling[l].transpose();
        }
      }
    }
  }

  // One damped Gauss-Newton step from bundle_, applied to the copies.
  bool Step(double damping, std::vector<BundleCamera>* cameras,
            std::vector<BundlePoint>* points) const {
    Normal equations;
    if (!Build(damping, &equations)) return false;
    Eliminate(&equations);
    const int size = 6 * free_cameras_;
    Eigen::VectorXd step = Eigen::VectorXd::Zero(size);
    if (size > 0) {
      const Eigen::LLT<Eigen::MatrixXd, Eigen::Lower> factor(equations.matrix);
      if (factor.info() != Eigen::Success) return false;
      step = factor.solve(equations.right);
      if (!step.allFinite()) return false;
    }

    for (std::size_t c = 0; c < cameras->size(); ++c) {
      if (block_[c] < 0) continue;
      Pose& pose = (*cameras)[c].world_from_camera;
      const Vector3d turn = step.segment<3>(6 * block_[c]);
      const double angle = turn.norm();
      if (angle > 0.0) {
        pose.rotation = (pose.rotation * Eigen::Quaterniond(Eigen::AngleAxisd(angle, turn / angle)))
                            .normalized();
      }
      pose.translation += step.segment<3>(6 * block_[c] + 3);
    }
    for (std::size_t p = 0; p < points->size(); ++p) {
      if (first_[p] == first_[p + 1] || bundle_.points[p].fixed) continue;
      Vector3d gradient = equations.point_right[p];
      for (std::size_t k = first_[p]; k < first_[p + 1]; ++k) {
        const int block = block_[static_cast<std::size_t>(sights_[k].camera)];
        if (block < 0) continue;
        gradient.noalias() -= equations.coupling[k].transpose() * step.segment<6>(6 * block);
      }
      const Vector3d move = equations.point_inverse[p] * gradient;
      BundlePoint& point = (*points)[p];
      const Vector3d direction =
          point.direction + move[0] * equations.tangents[p][0] + move[1] * equations.tangents[p][1];
      const double length = direction.norm();
      point.direction = direction / length;
      point.inverse_distance = (point.inverse_distance + move[2]) / length;
    }
    return true;
  }

  double huber_;
  int max_iterations_;
  Bundle& bundle_;
  std::vector<std::size_t> first_;  // sights of point p: [first_[p], first_[p + 1])
  std::vector<Sight> sights_;
  std::vector<int> block_;  // of a camera in the normal equations; -1 when fixed
  int free_cameras_ = 0;
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
  return Adjuster(options, bundle).Run();
}

std::vector<PoseCovariance> CameraCovariances(const BundleOptions& options, const Bundle& bundle,
                                              const std::optional<BundleDistance>& held) {
  Bundle copy = bundle;
  return Adjuster(options, &copy).Covariances(held);
}

}  // namespace omnihdr
