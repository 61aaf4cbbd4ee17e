#include "core/pose/resection.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>

#include "core/pose/random.h"

namespace omnihdr {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

// Real roots of c[4]·x⁴ + … + c[0].
std::vector<double> RealRoots(const std::array<double, 5>& c) {
  std::vector<double> roots;
  if (std::fabs(c[4]) < 1e-14) return roots;
  Eigen::Matrix4d companion = Eigen::Matrix4d::Zero();
  for (int i = 0; i < 4; ++i) companion(i, 3) = -c[static_cast<std::size_t>(i)] / c[4];
  for (int i = 0; i < 3; ++i) companion(i + 1, i) = 1.0;
  if (!companion.allFinite()) return roots;
  const Eigen::EigenSolver<Eigen::Matrix4d> solver(companion, false);
  for (int i = 0; i < 4; ++i) {
    const auto value = solver.eigenvalues()[i];
    // Double roots come out with a small imaginary part.
    if (std::fabs(value.imag()) < 1e-3 * (1.0 + std::fabs(value.real()))) {
      roots.push_back(value.real());
    }
  }
  return roots;
}

// Rotation and translation that take three points in the camera onto three in the world.
Pose Align(const std::array<Vector3d, 3>& in_camera, const std::array<Vector3d, 3>& in_world) {
  const Vector3d camera_mean = (in_camera[0] + in_camera[1] + in_camera[2]) / 3.0;
  const Vector3d world_mean = (in_world[0] + in_world[1] + in_world[2]) / 3.0;
  Matrix3d moment = Matrix3d::Zero();
  for (std::size_t i = 0; i < 3; ++i) {
    moment += (in_world[i] - world_mean) * (in_camera[i] - camera_mean).transpose();
  }
  const Eigen::JacobiSVD<Matrix3d> svd(moment, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Vector3d signs(1.0, 1.0, 1.0);
  if ((svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0) signs.z() = -1.0;
  const Matrix3d rotation = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
  return {Eigen::Quaterniond(rotation).normalized(), world_mean - rotation * camera_mean};
}

std::vector<Pose> ThreePoint(const std::array<Vector3d, 3>& points,
                             const std::array<Vector3d, 3>& rays) {
  std::vector<Pose> poses;
  const double a2 = (points[1] - points[2]).squaredNorm();
  const double b2 = (points[0] - points[2]).squaredNorm();
  const double c2 = (points[0] - points[1]).squaredNorm();
  if (std::min({a2, b2, c2}) < 1e-12) return poses;
  const double ca = rays[1].dot(rays[2]);
  const double cb = rays[0].dot(rays[2]);
  const double cg = rays[0].dot(rays[1]);
  const double p = (a2 - c2) / b2;
  const double q = (a2 + c2) / b2;
  const double r = c2 / b2;
  const double s = a2 / b2;
  const std::array<double, 5> quartic{
      (1.0 + p) * (1.0 + p) - 4.0 * s * cg * cg,
      4.0 * (-p * (1.0 + p) * cb + 2.0 * s * cg * cg * cb - (1.0 - q) * ca * cg),
      2.0 * (p * p - 1.0 + 2.0 * p * p * cb * cb + 2.0 * (1.0 - r) * ca * ca -
             4.0 * q * ca * cb * cg + 2.0 * (1.0 - s) * cg * cg),
      4.0 * (p * (1.0 - p) * cb - (1.0 - q) * ca * cg + 2.0 * r * ca * ca * cb),
      (p - 1.0) * (p - 1.0) - 4.0 * r * ca * ca};
  for (const double v : RealRoots(quartic)) {
    const double below = 2.0 * (cg - v * ca);
    const double square = 1.0 + v * v - 2.0 * v * cb;
    if (v <= 0.0 || std::fabs(below) < 1e-12 || square <= 1e-12) continue;
    const double u = ((p - 1.0) * v * v - 2.0 * p * cb * v + 1.0 + p) / below;
    if (u <= 0.0) continue;
    const double first = std::sqrt(b2 / square);
    poses.push_back(Align({first * rays[0], u * first * rays[1], v * first * rays[2]}, points));
  }
  return poses;
}

// Truncated squared angles: how many agree, the closer the better.
double Score(const std::vector<PointSight>& sights, const std::vector<int>& usable,
             const Pose& pose, double threshold) {
  double score = 0.0;
  for (const int i : usable) {
    const PointSight& sight = sights[static_cast<std::size_t>(i)];
    const Vector3d seen = RayFromPoint(pose, sight.point);
    const double along = seen.dot(sight.ray);
    if (along <= 0.0) continue;
    const double square = seen.squaredNorm() / (along * along) - 1.0;  // tangent of the angle
    score += std::max(0.0, 1.0 - square / (threshold * threshold));
  }
  return score;
}

// Gauss-Newton with Geman-McClure weights.
void Refine(const std::vector<PointSight>& sights, const std::vector<int>& usable, double scale,
            Pose* pose) {
  for (int iteration = 0; iteration < 10; ++iteration) {
    const Matrix3d camera_from_world = pose->rotation.conjugate().toRotationMatrix();
    Eigen::Matrix<double, 6, 6> normal = Eigen::Matrix<double, 6, 6>::Zero();
    Eigen::Matrix<double, 6, 1> right = Eigen::Matrix<double, 6, 1>::Zero();
    for (const int i : usable) {
      const PointSight& sight = sights[static_cast<std::size_t>(i)];
      const Vector3d seen = RayFromPoint(*pose, sight.point);
      const double length = seen.norm();
      if (!(length > 1e-9) || seen.dot(sight.ray) <= 0.0) continue;
      const Vector3d unit = seen / length;
      const Vector3d e1 = sight.ray.unitOrthogonal();
      Eigen::Matrix<double, 2, 3> across;
      across.row(0) = e1;
      across.row(1) = sight.ray.cross(e1);
      const Eigen::Vector2d residual = across * unit;
      const double root = 1.0 / (1.0 + residual.squaredNorm() / (scale * scale));
      const Eigen::Matrix<double, 2, 3> by_seen = (across - residual * unit.transpose()) / length;
      Matrix3d skew;
      skew << 0.0, -seen.z(), seen.y(), seen.z(), 0.0, -seen.x(), -seen.y(), seen.x(), 0.0;
      Eigen::Matrix<double, 2, 6> row;
      row.leftCols<3>() = by_seen * skew;
      row.rightCols<3>() = -sight.point.inverse_distance * by_seen * camera_from_world;
      normal += root * root * row.transpose() * row;
      right -= root * root * row.transpose() * residual;
    }
    normal.diagonal().array() += 1e-9 * normal.trace() + 1e-15;
    const Eigen::Matrix<double, 6, 1> step = normal.ldlt().solve(right);
    if (!step.allFinite()) return;
    const double angle = step.head<3>().norm();
    if (angle > 0.0) {
      const Eigen::AngleAxisd turn(angle, step.head<3>() / angle);
      pose->rotation = (pose->rotation * Eigen::Quaterniond(turn)).normalized();
    }
    pose->translation += step.tail<3>();
    if (step.norm() < 1e-10) return;
  }
}

}  // namespace

std::optional<Resection> EstimatePoseFromPoints(const std::vector<PointSight>& sights,
                                                std::uint64_t seed,
                                                const ResectionOptions& options) {
  std::vector<int> usable;
  for (std::size_t i = 0; i < sights.size(); ++i) {
    if (sights[i].point.inverse_distance > 1e-9) usable.push_back(static_cast<int>(i));
  }
  const int count = static_cast<int>(usable.size());
  if (count < std::max(4, options.min_inliers)) return std::nullopt;
  SplitMix random(seed);
  Pose best;
  double best_score = 0.0;
  int needed = options.max_iterations;
  for (int iteration = 0; iteration < needed; ++iteration) {
    std::array<int, 3> sample{};
    for (std::size_t k = 0; k < 3;) {
      const int index = usable[static_cast<std::size_t>(random.Below(count))];
      const auto end = sample.begin() + static_cast<std::ptrdiff_t>(k);
      if (std::find(sample.begin(), end, index) == end) sample[k++] = index;
    }
    std::array<Vector3d, 3> points;
    std::array<Vector3d, 3> rays;
    for (std::size_t k = 0; k < 3; ++k) {
      const PointSight& sight = sights[static_cast<std::size_t>(sample[k])];
      points[k] = sight.point.reference + sight.point.direction / sight.point.inverse_distance;
      rays[k] = sight.ray;
    }
    for (const Pose& pose : ThreePoint(points, rays)) {
      // Three points' noise is amplified: a wider net until refined.
      if (Score(sights, usable, pose, 3.0 * options.threshold_rad) <= 0.5 * best_score) continue;
      Pose refined = pose;
      Refine(sights, usable, 2.0 * options.threshold_rad, &refined);
      const double score = Score(sights, usable, refined, options.threshold_rad);
      if (score <= best_score) continue;
      best = refined;
      best_score = score;
      const double share = std::clamp(score / count, 0.01, 0.99);
      const double enough = std::log(1e-4) / std::log1p(-share * share * share);
      needed =
          static_cast<int>(std::clamp(enough, 20.0, static_cast<double>(options.max_iterations)));
    }
  }
  Refine(sights, usable, options.threshold_rad, &best);
  Resection result;
  result.world_from_camera = best;
  for (const int i : usable) {
    const PointSight& sight = sights[static_cast<std::size_t>(i)];
    const Vector3d seen = RayFromPoint(best, sight.point);
    if (std::atan2(seen.cross(sight.ray).norm(), seen.dot(sight.ray)) < options.threshold_rad) {
      result.inliers.push_back(i);
    }
  }
  if (static_cast<int>(result.inliers.size()) < options.min_inliers) return std::nullopt;
  return result;
}

}  // namespace omnihdr
