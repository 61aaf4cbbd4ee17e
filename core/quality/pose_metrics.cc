#include "core/quality/pose_metrics.h"

#include <cassert>
#include <cstddef>
#include <numbers>

namespace omnihdr {

ChainErrors ComparePoses(std::span<const Pose> estimated, std::span<const Pose> truth,
                         bool fit_scale) {
  assert(estimated.size() == truth.size());
  ChainErrors result;
  if (estimated.empty()) return result;
  const Pose first_from_estimated = estimated.front().Inverse();
  const Pose first_from_truth = truth.front().Inverse();

  double along = 0.0;
  double square = 0.0;
  for (std::size_t i = 0; i < estimated.size(); ++i) {
    const Eigen::Vector3d have = (first_from_estimated * estimated[i]).translation;
    along += have.dot((first_from_truth * truth[i]).translation);
    square += have.squaredNorm();
  }
  if (square > 0.0 && along > 0.0) result.scale = along / square;
  const double applied = fit_scale ? result.scale : 1.0;

  double travelled = 0.0;
  for (std::size_t i = 0; i < estimated.size(); ++i) {
    const Pose have = first_from_estimated * estimated[i];
    const Pose want = first_from_truth * truth[i];
    if (i > 0) travelled += (truth[i].translation - truth[i - 1].translation).norm();
    PoseErrors errors;
    errors.rotation_deg = have.rotation.angularDistance(want.rotation) * 180.0 / std::numbers::pi;
    if (travelled > 0.0) {
      errors.translation_percent =
          100.0 * (applied * have.translation - want.translation).norm() / travelled;
    }
    result.positions.push_back(errors);
  }
  return result;
}

}  // namespace omnihdr
