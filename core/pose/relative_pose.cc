#include "core/pose/relative_pose.h"

#include <Eigen/Dense>
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "core/pose/random.h"

namespace omnihdr {
namespace {

using Eigen::Matrix3d;
using Eigen::Vector3d;

constexpr int kSample = 8;
constexpr double kFewestDraws = 30.0;
// Residuals of a rotation this many times what noise alone would leave are a baseline.
constexpr double kRotationNoise = 1.6;
constexpr double kMedianOfRayleigh = 1.1774;
constexpr int kFirstLook = 128;  // pairs a hypothesis is tried on before all

Matrix3d Skew(const Vector3d& v) {
  Matrix3d m;
  m << 0.0, -v.z(), v.y(), v.z(), 0.0, -v.x(), -v.y(), v.x(), 0.0;
  return m;
}

// The pairs as columns of floats, for scoring, in a shuffled order so that the first look is fair.
struct Columns {
  std::vector<float> ax, ay, az, bx, by, bz;
  explicit Columns(const std::vector<RayPair>& pairs, SplitMix& random) {
    std::vector<int> order(pairs.size());
    for (std::size_t i = 0; i < order.size(); ++i) order[i] = static_cast<int>(i);
    for (int i = static_cast<int>(order.size()) - 1; i > 0; --i) {
      std::swap(order[static_cast<std::size_t>(i)],
                order[static_cast<std::size_t>(random.Below(i + 1))]);
    }
    for (const int i : order) {
      const RayPair& pair = pairs[static_cast<std::size_t>(i)];
      ax.push_back(static_cast<float>(pair.a.x()));
      ay.push_back(static_cast<float>(pair.a.y()));
      az.push_back(static_cast<float>(pair.a.z()));
      bx.push_back(static_cast<float>(pair.b.x()));
      by.push_back(static_cast<float>(pair.b.y()));
      bz.push_back(static_cast<float>(pair.b.z()));
    }
  }
  // Sum over [begin, end) of 1 − min(1, (sine of the angle / threshold)²): inliers, the closer the
  // better.
  float Score(const Matrix3d& essential, double threshold, int begin, int end) const {
    const Eigen::Matrix3f e = essential.cast<float>();
    const float scale = static_cast<float>(1.0 / (threshold * threshold));
    float score = 0.0F;
    std::array<float, 8> lanes{};
    for (int base = begin; base < end; base += 8) {
      const int count = std::min(8, end - base);
      for (int lane = 0; lane < count; ++lane) {
        const auto i = static_cast<std::size_t>(base + lane);
        const float u = e(0, 0) * ax[i] + e(0, 1) * ay[i] + e(0, 2) * az[i];
        const float v = e(1, 0) * ax[i] + e(1, 1) * ay[i] + e(1, 2) * az[i];
        const float w = e(2, 0) * ax[i] + e(2, 1) * ay[i] + e(2, 2) * az[i];
        const float c = u * bx[i] + v * by[i] + w * bz[i];
        const float n = u * u + v * v + w * w;
        const float q = c * c * scale / std::max(n, 1e-12F);
        lanes[static_cast<std::size_t>(lane)] += 1.0F - std::min(1.0F, q);
      }
    }
    for (const float lane : lanes) score += lane;
    return score;
  }
};

// Null vector of the eight equations by Gaussian elimination with full pivoting, made a true
// essential matrix (two equal singular values and a zero).
std::optional<Matrix3d> EightPoint(const std::vector<RayPair>& pairs,
                                   const std::array<int, kSample>& sample) {
  Eigen::Matrix<double, kSample, 9> equations;
  for (int k = 0; k < kSample; ++k) {
    const RayPair& pair = pairs[static_cast<std::size_t>(sample[static_cast<std::size_t>(k)])];
    for (int i = 0; i < 3; ++i) {
      for (int j = 0; j < 3; ++j) equations(k, 3 * i + j) = pair.b[i] * pair.a[j];
    }
  }
  std::array<int, 9> column{0, 1, 2, 3, 4, 5, 6, 7, 8};
  for (int k = 0; k < kSample; ++k) {
    Eigen::Index r = 0;
    Eigen::Index c = 0;
    const double pivot =
        equations.bottomRightCorner(kSample - k, 9 - k).cwiseAbs().maxCoeff(&r, &c);
    if (pivot < 1e-9) return std::nullopt;
    if (r != 0) equations.row(k).swap(equations.row(k + r));
    if (c != 0) {
      equations.col(k).swap(equations.col(k + c));
      std::swap(column[static_cast<std::size_t>(k)], column[static_cast<std::size_t>(k + c)]);
    }
    for (int i = k + 1; i < kSample; ++i) {
      const double f = equations(i, k) / equations(k, k);
      equations.row(i).tail(9 - k) -= f * equations.row(k).tail(9 - k);
    }
  }
  Eigen::Matrix<double, 9, 1> null;
  null[column[8]] = 1.0;
  std::array<double, 9> solved{};
  solved[8] = 1.0;
  for (int k = kSample - 1; k >= 0; --k) {
    double sum = 0.0;
    for (int c = k + 1; c < 9; ++c) sum += equations(k, c) * solved[static_cast<std::size_t>(c)];
    solved[static_cast<std::size_t>(k)] = -sum / equations(k, k);
    null[column[static_cast<std::size_t>(k)]] = solved[static_cast<std::size_t>(k)];
  }
  Matrix3d e;
  e << null[0], null[1], null[2], null[3], null[4], null[5], null[6], null[7], null[8];
  if (!e.allFinite()) return std::nullopt;
  const Eigen::JacobiSVD<Matrix3d> svd(e, Eigen::ComputeFullU | Eigen::ComputeFullV);
  return svd.matrixU() * Vector3d(1.0, 1.0, 0.0).asDiagonal() * svd.matrixV().transpose();
}

struct Motion {
  Matrix3d rotation = Matrix3d::Identity();
  Vector3d direction = Vector3d::UnitX();
  Matrix3d Essential() const { return Skew(direction) * rotation; }
};

// One of the two rotations of an essential matrix, the one turning less, and either sign of
// direction: the angles to the epipolar planes are the same for all four.
Motion Decompose(const Matrix3d& essential) {
  const Eigen::JacobiSVD<Matrix3d> svd(essential, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Matrix3d u = svd.matrixU();
  Matrix3d v = svd.matrixV();
  if (u.determinant() < 0.0) u = -u;
  if (v.determinant() < 0.0) v = -v;
  Matrix3d w;
  w << 0.0, -1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0;
  const Matrix3d r0 = u * w * v.transpose();
  const Matrix3d r1 = u * w.transpose() * v.transpose();
  return {r0.trace() >= r1.trace() ? r0 : r1, u.col(2)};
}

// The other rotation: half a turn about the direction.
Motion Twisted(const Motion& motion) {
  const Matrix3d half_turn =
      2.0 * motion.direction * motion.direction.transpose() - Matrix3d::Identity();
  return {half_turn * motion.rotation, motion.direction};
}

// Gauss-Newton over rotation and direction of the symmetric (Sampson) angle to the epipolar plane,
// with Geman-McClure weights: pairs beyond the threshold hardly count.
void Refine(const std::vector<RayPair>& pairs, double scale, int iterations, Motion* motion) {
  for (int iteration = 0; iteration < iterations; ++iteration) {
    const Vector3d t = motion->direction;
    const Vector3d t1 = t.unitOrthogonal();
    const Vector3d t2 = t.cross(t1);
    const Matrix3d essential = motion->Essential();
    Eigen::Matrix<double, 5, 5> normal = Eigen::Matrix<double, 5, 5>::Zero();
    Eigen::Matrix<double, 5, 1> right = Eigen::Matrix<double, 5, 1>::Zero();
    for (const RayPair& pair : pairs) {
      const Vector3d turned = motion->rotation * pair.a;
      const Vector3d line_b = t.cross(turned);
      const double error = pair.b.dot(line_b);
      const double size = line_b.squaredNorm() + (essential.transpose() * pair.b).squaredNorm();
      if (size < 1e-8) continue;  // along the direction of motion: the epipolar plane is undefined
      const double inverse = std::sqrt(2.0 / size);
      const double angle = error * inverse;
      const double weight_root = 1.0 / (1.0 + angle * angle / (scale * scale));
      const Vector3d by_rotation = turned.cross(pair.b.cross(t));
      const Vector3d by_direction = turned.cross(pair.b);
      Eigen::Matrix<double, 5, 1> row;
      row << by_rotation, by_direction.dot(t1), by_direction.dot(t2);
      row *= inverse * weight_root;
      normal.selfadjointView<Eigen::Lower>().rankUpdate(row);
      right -= row * (angle * weight_root);
    }
    normal.diagonal().array() += 1e-9 * (normal.trace() + 1e-12);
    const Eigen::Matrix<double, 5, 1> step =
        normal.selfadjointView<Eigen::Lower>().ldlt().solve(right);
    if (!step.allFinite()) return;
    const Vector3d turn = step.head<3>();
    const double angle = turn.norm();
    if (angle > 0.0) {
      motion->rotation =
          Eigen::AngleAxisd(angle, turn / angle).toRotationMatrix() * motion->rotation;
    }
    motion->direction = (t + step[3] * t1 + step[4] * t2).normalized();
    if (step.norm() < 1e-10) break;
  }
  motion->rotation = Eigen::Quaterniond(motion->rotation).normalized().toRotationMatrix();
}

double AngleToPlane(const RayPair& pair, const Matrix3d& essential) {
  const Vector3d in_b = essential * pair.a;
  const Vector3d in_a = essential.transpose() * pair.b;
  const double size = in_b.squaredNorm() + in_a.squaredNorm();
  if (size < 1e-12) return 0.0;
  return std::fabs(pair.b.dot(in_b)) * std::sqrt(2.0 / size);
}

// Rotation that best takes rays a onto rays b (Horn 1987, by SVD), with robust weights.
Matrix3d FitRotation(const std::vector<RayPair>& pairs, const std::vector<int>& which,
                     Matrix3d start, double scale) {
  for (int iteration = 0; iteration < 10; ++iteration) {
    Matrix3d moment = Matrix3d::Zero();
    for (const int i : which) {
      const RayPair& pair = pairs[static_cast<std::size_t>(i)];
      const double square = (start * pair.a - pair.b).squaredNorm() / (scale * scale);
      const double weight = 1.0 / ((1.0 + square) * (1.0 + square));
      moment += weight * pair.b * pair.a.transpose();
    }
    const Eigen::JacobiSVD<Matrix3d> svd(moment, Eigen::ComputeFullU | Eigen::ComputeFullV);
    Vector3d signs(1.0, 1.0, 1.0);
    if ((svd.matrixU() * svd.matrixV().transpose()).determinant() < 0.0) signs.z() = -1.0;
    start = svd.matrixU() * signs.asDiagonal() * svd.matrixV().transpose();
  }
  return start;
}

double Median(std::vector<double> values) {
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// What to make of a motion found: which pairs agree with it, whether they are enough, and whether a
// rotation alone would do.
RelativePose Judge(const std::vector<RayPair>& pairs, const Motion& best,
                   const RelativePoseOptions& options) {
  RelativePose result;
  const int count = static_cast<int>(pairs.size());
  const double threshold = options.threshold_rad;
  const auto inliers_of = [&](const Matrix3d& essential) {
    std::vector<int> inliers;
    for (int i = 0; i < count; ++i) {
      if (AngleToPlane(pairs[static_cast<std::size_t>(i)], essential) < threshold)
        inliers.push_back(i);
    }
    return inliers;
  };
  const std::vector<int> near_plane = inliers_of(best.Essential());
  result.agreeing = static_cast<int>(near_plane.size());
  const auto enough = [&](std::size_t agreeing) {
    return static_cast<int>(agreeing) >= options.min_inliers &&
           static_cast<double>(agreeing) >= options.min_inlier_fraction * count;
  };
  if (!enough(near_plane.size())) return result;

  // Cheirality: of the four motions, the one with the scene in front of both cameras.
  const double tolerance = 2.0 * threshold;
  Pose chosen;
  int most = -1;
  for (const bool twisted : {false, true}) {
    Motion motion = twisted ? Twisted(best) : best;
    for (const double sign : {1.0, -1.0}) {
      const Pose candidate{Eigen::Quaterniond(motion.rotation).normalized(),
                           sign * motion.direction};
      int in_front = 0;
      for (const int i : near_plane) {
        const RayPair& pair = pairs[static_cast<std::size_t>(i)];
        const double inverse = InverseDistance(pair, candidate);
        const Vector3d seen_from_b = candidate.rotation * pair.a + inverse * candidate.translation;
        if (inverse > 0.0 && seen_from_b.dot(pair.b) > 0.0) ++in_front;
      }
      if (in_front > most) {
        most = in_front;
        chosen = candidate;
      }
    }
  }

  // A rotation alone? Fitted to the same pairs, it leaves residuals in two dimensions that are no
  // larger than the angles to the epipolar planes, in one, let expect: what lies along the planes
  // is noise too.
  const Matrix3d turn =
      FitRotation(pairs, near_plane, chosen.rotation.toRotationMatrix(), threshold);
  std::vector<double> turn_angles;
  std::vector<double> plane_angles;
  for (const int i : near_plane) {
    const RayPair& pair = pairs[static_cast<std::size_t>(i)];
    turn_angles.push_back((turn * pair.a - pair.b).norm());
    plane_angles.push_back(AngleToPlane(pair, best.Essential()));
  }
  const double noise = 1.4826 * Median(plane_angles);
  const double turn_median = Median(turn_angles);
  std::vector<int> in_front;
  std::vector<double> parallaxes;
  double squares = 0.0;
  for (const int i : near_plane) {
    const RayPair& pair = pairs[static_cast<std::size_t>(i)];
    const double inverse = InverseDistance(pair, chosen);
    parallaxes.push_back(inverse);
    const Vector3d seen_from_b = chosen.rotation * pair.a + inverse * chosen.translation;
    // Points at infinity may come out a little behind.
    if (inverse < -tolerance || seen_from_b.dot(pair.b) <= 0.0) continue;
    in_front.push_back(i);
    const double angle = AngleToPlane(pair, best.Essential());
    squares += angle * angle;
  }
  result.median_parallax = Median(parallaxes);
  const bool turn_explains = turn_median < kRotationNoise * kMedianOfRayleigh * noise;
  if (turn_explains ||
      (result.median_parallax < options.min_baseline_ratio && turn_median < threshold)) {
    // Pairs that agree with the rotation to within what noise explains.
    const double limit = std::max(threshold, 3.0 * turn_median);
    double turn_squares = 0.0;
    for (int i = 0; i < count; ++i) {
      const RayPair& pair = pairs[static_cast<std::size_t>(i)];
      const double angle = (turn * pair.a - pair.b).norm();
      if (angle >= limit) continue;
      result.inliers.push_back(i);
      turn_squares += angle * angle;
    }
    result.verdict = RelativePose::Verdict::kRotation;
    result.b_from_a = {Eigen::Quaterniond(turn).normalized(), Vector3d::Zero()};
    result.rms_rad = std::sqrt(turn_squares / static_cast<double>(result.inliers.size()));
    return result;
  }
  if (!enough(in_front.size())) {
    result.agreeing = static_cast<int>(in_front.size());
    return result;
  }
  result.verdict = RelativePose::Verdict::kBaseline;
  result.b_from_a = chosen;
  result.inliers = std::move(in_front);
  result.rms_rad = std::sqrt(squares / static_cast<double>(result.inliers.size()));
  return result;
}

}  // namespace

double InverseDistance(const RayPair& pair, const Pose& b_from_a) {
  // b ∥ R a + ρ t: ρ minimises |b × (R a + ρ t)|.
  const Vector3d turned = b_from_a.rotation * pair.a;
  const Vector3d across_turned = pair.b.cross(turned);
  const Vector3d across_t = pair.b.cross(b_from_a.translation);
  const double size = across_t.squaredNorm();
  return size > 1e-9 ? -across_t.dot(across_turned) / size : 0.0;
}

RelativePose EstimateRelativePose(const std::vector<RayPair>& pairs, std::uint64_t seed,
                                  const RelativePoseOptions& options) {
  const int count = static_cast<int>(pairs.size());
  if (count < std::max(options.min_inliers, kSample)) return {};
  SplitMix random(seed);
  const Columns columns(pairs, random);
  const double threshold = options.threshold_rad;

  Motion best;
  float best_score = 0.0F;
  float best_first_look = 0.0F;
  const int first_look = std::min(kFirstLook, count);
  int needed = options.max_iterations;
  for (int iteration = 0; iteration < needed; ++iteration) {
    // The pool grows from the most distinct pairs to all of them within the first 500 draws.
    const int pool = std::clamp(40 + count * iteration / 500, kSample, count);
    std::array<int, kSample> sample{};
    for (int k = 0; k < kSample;) {
      const int index = random.Below(pool);
      const auto end = sample.begin() + k;
      if (std::find(sample.begin(), end, index) != end) continue;
      sample[static_cast<std::size_t>(k++)] = index;
    }
    const auto essential = EightPoint(pairs, sample);
    if (!essential) continue;
    const float look = columns.Score(*essential, threshold, 0, first_look);
    if (look < 0.5F * best_first_look) continue;
    const float score = look + columns.Score(*essential, threshold, first_look, count);
    if (score <= 0.7F * best_score) continue;
    Motion motion = Decompose(*essential);
    Refine(pairs, 3.0 * threshold, 2, &motion);
    Refine(pairs, threshold, 3, &motion);
    const Matrix3d refined = motion.Essential();
    const float refined_look = columns.Score(refined, threshold, 0, first_look);
    const float refined_score = refined_look + columns.Score(refined, threshold, first_look, count);
    if (refined_score <= best_score) continue;
    best = motion;
    best_score = refined_score;
    best_first_look = refined_look;
    // Draws until a sample without an outlier was met with 99.9 %; the score is a cautious count.
    const double share = std::clamp(static_cast<double>(best_score) / count, 0.01, 0.99);
    const double enough = std::log(1e-3) / std::log1p(-std::pow(share, kSample));
    needed = static_cast<int>(
        std::clamp(enough, kFewestDraws, static_cast<double>(options.max_iterations)));
  }
  if (best_score <= 0.0F) return {};
  Refine(pairs, 0.6 * threshold, 10, &best);
  return Judge(pairs, best, options);
}

RelativePose RefineRelativePose(const std::vector<RayPair>& pairs, const RelativePose& start,
                                const RelativePoseOptions& options) {
  Motion motion{start.b_from_a.rotation.toRotationMatrix(), start.b_from_a.translation};
  // A rotation alone has no direction: any does, to tell whether there is one after all.
  if (motion.direction.norm() < 0.5) motion.direction = Vector3d::UnitX();
  Refine(pairs, 0.6 * options.threshold_rad, 10, &motion);
  return Judge(pairs, motion, options);
}

}  // namespace omnihdr
