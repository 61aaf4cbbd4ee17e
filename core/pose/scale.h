#pragma once

#include <Eigen/Core>
#include <optional>
#include <vector>

#include "core/pose/bundle_adjustment.h"
#include "core/pose/relative_pose.h"

namespace omnihdr {

// A point known from older positions and the rays under which the two positions of a link see it.
struct ScaleClue {
  BundlePoint point;
  Eigen::Vector3d ray_in_new;
};

// Length of the baseline from `old_pose` to a new position whose direction is known (new_from_old
// with a unit translation), such that the known points come out at the distances they have:
// weighted median over the points. Empty when fewer than `min_clues` say anything.
std::optional<double> BaselineFromPoints(const std::vector<ScaleClue>& clues, const Pose& old_pose,
                                         const Pose& new_from_old, int min_clues);

// Straight distance between two places `travelled` apart along an arc that turns by `turn_rad`.
double ChordOfArc(double travelled, double turn_rad);

}  // namespace omnihdr
