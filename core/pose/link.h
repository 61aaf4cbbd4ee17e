#pragma once

#include <string>
#include <utility>
#include <vector>

#include "core/base/units.h"
#include "core/pose/features.h"
#include "core/pose/pose_tracker.h"
#include "core/pose/relative_pose.h"

namespace omnihdr {

// What the features of two positions say about the motion between them.
struct Link {
  PositionId from{};  // the older
  PositionId to{};
  int matches = 0;
  RelativePose motion;                       // to_from_from: x_in_to = motion.b_from_a · x_in_from
  std::vector<std::pair<int, int>> inliers;  // (feature of `from`, feature of `to`)
  // All matches, kept while no motion is known: single ones may still be right.
  std::vector<std::pair<int, int>> unexplained;
  bool ok() const { return motion.verdict != RelativePose::Verdict::kNone; }
  bool has_baseline() const { return motion.verdict == RelativePose::Verdict::kBaseline; }
};

// A function of the two sets, the ids (which seed the draws) and the options alone.
Link LinkPositions(PositionId from, const FeatureSet& from_features, PositionId to,
                   const FeatureSet& to_features, const PoseOptions& options);

// Pairs of features that a motion known from elsewhere allows and that resemble each other as much
// as those at similarity `least_similarity`: x_in_to = to_from_from · x_in_from.
std::vector<std::pair<int, int>> MatchByMotion(const FeatureSet& from_features,
                                               const FeatureSet& to_features,
                                               const Pose& to_from_from, int least_similarity,
                                               const PoseOptions& options);

// Why a link is not ok, for people.
std::string WhyNoLink(const Link& link, int from_features, int to_features,
                      const PoseOptions& options);

}  // namespace omnihdr
