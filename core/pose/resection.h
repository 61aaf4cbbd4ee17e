#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/pose/bundle_adjustment.h"
#include "core/sphere/pose.h"

namespace omnihdr {

// A point whose place is known and the ray under which a camera may see it.
struct PointSight {
  BundlePoint point;
  Eigen::Vector3d ray;  // unit, camera frame
};

struct ResectionOptions {
  double threshold_rad = 3.5e-3;  // angle between a ray and its point
  int min_inliers = 10;
  int max_iterations = 2000;
};

struct Resection {
  Pose world_from_camera;
  std::vector<int> inliers;  // indices of sights, ascending
};

// Pose of a camera among known points: three-point hypotheses (Grunert 1841, as in Haralick et al.
// 1994), scored by truncated squared angles, the best refined over its inliers. It takes far fewer
// right pairs than a motion between two cameras does, because a wrong pair hardly ever agrees by
// chance. Points at infinity or behind are left out. Deterministic: `seed` decides the draws.
std::optional<Resection> EstimatePoseFromPoints(const std::vector<PointSight>& sights,
                                                std::uint64_t seed,
                                                const ResectionOptions& options);

}  // namespace omnihdr
