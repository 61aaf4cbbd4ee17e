#include "core/pose/scale.h"

#include <algorithm>
#include <cmath>
#include <utility>

namespace omnihdr {
namespace {

// Parallax (radian) below which a distance says nothing about scale.
constexpr double kLeastParallax = 3.0e-3;

}  // namespace

std::optional<double> BaselineFromPoints(const std::vector<ScaleClue>& clues, const Pose& old_pose,
                                         const Pose& new_from_old, int min_clues) {
  std::vector<std::pair<double, double>> votes;  // baseline, weight
  for (const ScaleClue& clue : clues) {
    const Eigen::Vector3d seen = RayFromPoint(old_pose, clue.point);
    const double length = seen.norm();
    if (!(length > 1e-9)) continue;
    const double known = clue.point.inverse_distance / length;
    const Eigen::Vector3d direction = seen / length;
    const double per_baseline = InverseDistance({direction, clue.ray_in_new}, new_from_old);
    const double sine = clue.ray_in_new.cross(new_from_old.translation).norm();
    if (!(known > 0.0) || per_baseline * sine < kLeastParallax) continue;
    votes.emplace_back(per_baseline / known, per_baseline * sine);
  }
  if (static_cast<int>(votes.size()) < min_clues) return std::nullopt;
  std::sort(votes.begin(), votes.end());
  double total = 0.0;
  for (const auto& vote : votes) total += vote.second;
  double sum = 0.0;
  for (const auto& [baseline, weight] : votes) {
    sum += weight;
    if (2.0 * sum >= total) return baseline;
  }
  return votes.back().first;
}

double ChordOfArc(double travelled, double turn_rad) {
  const double half = 0.5 * std::fabs(turn_rad);
  return half < 1e-6 ? travelled : travelled * std::sin(half) / half;
}

}  // namespace omnihdr
