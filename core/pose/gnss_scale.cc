#include "core/pose/gnss_scale.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

namespace omnihdr {
namespace {

constexpr std::size_t kLeastFixes = 4;
constexpr double kLeastShare = 2.0 / 3.0;  // of the fixes, to agree
constexpr double kAgree = 3.0;             // sigmas
constexpr double kTiltSigma = 0.17;        // radian: of the chain's Z from the vertical
constexpr int kIterations = 20;
constexpr double kKnown = 0.02;  // relative sigma
constexpr double kOdometerMayBeOff = 0.01;

struct Similarity {
  double scale = 1.0;
  Eigen::Matrix3d rotation = Eigen::Matrix3d::Identity();
  Eigen::Vector3d shift = Eigen::Vector3d::Zero();
  Eigen::Vector3d Of(const Eigen::Vector3d& x) const { return scale * (rotation * x) + shift; }
};

struct Pairs {
  std::vector<Eigen::Vector3d> x;  // by pictures, about their mean
  std::vector<Eigen::Vector3d> g;  // by satellites
  std::vector<double> sigma;
  std::size_t size() const { return x.size(); }
};

// What a fix is off by, in sigmas.
double Off(const Pairs& pairs, const Similarity& s, std::size_t i) {
  const Eigen::Vector3d gap = s.Of(pairs.x[i]) - pairs.g[i];
  return std::sqrt(gap.head<2>().squaredNorm() +
                   gap.z() * gap.z() / (kGnssHeightFactor * kGnssHeightFactor)) /
         pairs.sigma[i];
}

// The turn about Z, scale and shift that take two samples to their fixes.
std::optional<Similarity> FromTwo(const Pairs& pairs, std::size_t a, std::size_t b) {
  const Eigen::Vector2d x = (pairs.x[b] - pairs.x[a]).head<2>();
  const Eigen::Vector2d g = (pairs.g[b] - pairs.g[a]).head<2>();
  // Noise alone is no direction.
  const double least = 2.0 * std::hypot(pairs.sigma[a], pairs.sigma[b]);
  if (!(x.norm() > 1e-9) || !(g.norm() > least)) return std::nullopt;
  Similarity s;
  s.scale = g.norm() / x.norm();
  const double turn = std::atan2(g.y(), g.x()) - std::atan2(x.y(), x.x());
  s.rotation = Eigen::AngleAxisd(turn, Eigen::Vector3d::UnitZ()).toRotationMatrix();
  s.shift = pairs.g[a] - s.scale * (s.rotation * pairs.x[a]);
  return s;
}

std::optional<Similarity> MostAgreed(const Pairs& pairs) {
  std::optional<Similarity> best;
  double least_cost = kAgree * kAgree * static_cast<double>(pairs.size());
  for (std::size_t a = 0; a < pairs.size(); ++a) {
    for (std::size_t b = a + 1; b < pairs.size(); ++b) {
      const std::optional<Similarity> s = FromTwo(pairs, a, b);
      if (!s) continue;
      double cost = 0.0;
      for (std::size_t i = 0; i < pairs.size() && cost < least_cost; ++i) {
        const double off = Off(pairs, *s, i);
        cost += std::min(off * off, kAgree * kAgree);
      }
      if (cost >= least_cost) continue;
      least_cost = cost;
      best = s;
    }
  }
  return best;
}

using Normal = Eigen::Matrix<double, 7, 7>;
using Step = Eigen::Matrix<double, 7, 1>;

// The normal equations about `s`: ln scale, turn in the world, shift; with the tilt held near 0.
void BuildNormal(const Pairs& pairs, const Similarity& s, Normal* normal, Step* right) {
  normal->setZero();
  right->setZero();
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    const Eigen::Vector3d moved = s.scale * (s.rotation * pairs.x[i]);
    const Eigen::Vector3d gap = pairs.g[i] - moved - s.shift;
    Eigen::Matrix<double, 3, 7> slope;
    slope.col(0) = moved;
    slope.col(1) = Eigen::Vector3d::UnitX().cross(moved);
    slope.col(2) = Eigen::Vector3d::UnitY().cross(moved);
    slope.col(3) = Eigen::Vector3d::UnitZ().cross(moved);
    slope.rightCols<3>().setIdentity();
    const double off = Off(pairs, s, i);
    const double weight = 1.0 / (1.0 + off * off / (kAgree * kAgree));
    Eigen::Vector3d per_axis =
        Eigen::Vector3d::Constant(weight / (pairs.sigma[i] * pairs.sigma[i]));
    per_axis.z() /= kGnssHeightFactor * kGnssHeightFactor;
    *normal += slope.transpose() * per_axis.asDiagonal() * slope;
    *right += slope.transpose() * per_axis.cwiseProduct(gap);
  }
  const Eigen::Vector3d up = s.rotation.col(2);  // tilt: where the chain's Z points
  const double weight = 1.0 / (kTiltSigma * kTiltSigma);
  (*normal)(1, 1) += weight;
  (*normal)(2, 2) += weight;
  (*right)(1) += weight * up.y();  // a turn about X by a moves Z towards −Y by a
  (*right)(2) -= weight * up.x();
}

}  // namespace

std::optional<GnssClue> ClueFromFix(const std::optional<GnssFix>& fix) {
  if (!fix || fix->fix <= 0) return std::nullopt;
  // What share of places lies within a receiver's error is rarely said: taken for the root mean
  // square of the horizontal distance.
  const double sigma = fix->error_m && *fix->error_m > 0.0 ? *fix->error_m / std::numbers::sqrt2
                                                           : kUnstatedGnssSigma;
  return GnssClue{{fix->lat_deg, fix->lon_deg, fix->alt_m}, sigma};
}

std::optional<GnssScale> EstimateGnssScale(std::span<const GnssSample> samples) {
  if (samples.size() < kLeastFixes) return std::nullopt;
  Pairs pairs;
  Eigen::Vector3d mean = Eigen::Vector3d::Zero();
  for (const GnssSample& sample : samples) mean += sample.translation;
  mean /= static_cast<double>(samples.size());
  for (const GnssSample& sample : samples) {
    pairs.x.push_back(sample.translation - mean);
    pairs.g.push_back(EastNorthUp(samples.front().clue.place, sample.clue.place));
    pairs.sigma.push_back(sample.clue.sigma_m);
  }
  std::optional<Similarity> s = MostAgreed(pairs);
  if (!s) return std::nullopt;
  Normal normal;
  Step right;
  for (int k = 0; k < kIterations; ++k) {
    BuildNormal(pairs, *s, &normal, &right);
    const Step step = normal.ldlt().solve(right);
    if (!step.allFinite()) return std::nullopt;
    s->scale *= std::exp(std::clamp(step(0), -1.0, 1.0));
    const Eigen::Vector3d turn = step.segment<3>(1);
    if (const double angle = turn.norm(); angle > 0.0) {
      s->rotation = Eigen::AngleAxisd(angle, turn / angle) * s->rotation;
    }
    s->shift += step.tail<3>();
    if (step.head<4>().norm() < 1e-10) break;
  }
  GnssScale scale;
  scale.metres_per_unit = s->scale;
  double square = 0.0;
  for (std::size_t i = 0; i < pairs.size(); ++i) {
    const double off = Off(pairs, *s, i);
    if (off > kAgree) {
      ++scale.outliers;
      continue;
    }
    ++scale.fixes;
    square += off * off;
  }
  const auto agreeing = static_cast<std::size_t>(scale.fixes);
  if (agreeing < kLeastFixes ||
      static_cast<double>(agreeing) < kLeastShare * static_cast<double>(pairs.size())) {
    return std::nullopt;
  }
  BuildNormal(pairs, *s, &normal, &right);
  const double variance = normal.ldlt().solve(Step(Step::Unit(0)))(0);
  if (!(variance > 0.0) || !std::isfinite(variance)) return std::nullopt;
  const double freedom = std::max(1.0, 3.0 * scale.fixes - 7.0);
  scale.sigma = s->scale * std::sqrt(variance * std::max(1.0, square / freedom));
  return scale;
}

bool IsScaleKnown(const GnssScale& scale) { return scale.sigma < kKnown * scale.metres_per_unit; }

bool ContradictsMetres(const GnssScale& scale) {
  return std::fabs(scale.metres_per_unit - 1.0) > 3.0 * scale.sigma + kOdometerMayBeOff;
}

}  // namespace omnihdr
