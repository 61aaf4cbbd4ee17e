#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "core/sphere/pose.h"

namespace omnihdr {

// Two cameras' unit rays to one point of the scene.
struct RayPair {
  Eigen::Vector3d a;
  Eigen::Vector3d b;
};

struct RelativePoseOptions {
  double threshold_rad = 2.5e-3;  // angle between a ray and its epipolar plane
  int min_inliers = 24;
  double min_inlier_fraction = 0.25;
  double min_baseline_ratio = 0.002;
  int max_iterations = 4000;
};

struct RelativePose {
  enum class Verdict {
    kNone,      // no motion explains enough of the pairs
    kRotation,  // they are explained by a rotation alone
    kBaseline,  // rotation and a direction of translation
  };
  Verdict verdict = Verdict::kNone;
  // x_in_b = rotation · x_in_a + translation; translation is unit, zero for kRotation.
  Pose b_from_a;
  std::vector<int> inliers;      // indices of pairs, ascending
  int agreeing = 0;              // pairs that agree with the best motion found, also for kNone
  double median_parallax = 0.0;  // median over the inliers of baseline / distance
  double rms_rad = 0.0;          // of the inliers' angles to their epipolar planes (or rays)
};

// Motion between two panoramas from matched unit rays: eight-point hypotheses on the sphere
// (Longuet-Higgins 1981; p_bᵀ E p_a = 0), drawn from the most distinct pairs first (`pairs` is
// ordered so; PROSAC, Chum and Matas 2005), scored by truncated squared angles, each new best
// refined over its inliers (LO-RANSAC, Chum, Matas and Kittler 2003). Deterministic: `seed` decides
// the draws.
RelativePose EstimateRelativePose(const std::vector<RayPair>& pairs, std::uint64_t seed,
                                  const RelativePoseOptions& options);

// The same judgement of pairs found with the help of a motion that is about right (the verdict of
// `start` is not kNone): refined from there, without draws.
RelativePose RefineRelativePose(const std::vector<RayPair>& pairs, const RelativePose& start,
                                const RelativePoseOptions& options);

// Inverse distance of the point seen along two rays, from camera a, in units of the baseline
// (|translation| of b_from_a = 1): least squares along ray b; negative behind.
double InverseDistance(const RayPair& pair, const Pose& b_from_a);

}  // namespace omnihdr
