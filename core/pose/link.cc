#include "core/pose/link.h"

#include <fmt/format.h>

#include <algorithm>
#include <tuple>

#include "core/pose/matching.h"

namespace omnihdr {
namespace {

constexpr float kMaxRatio = 0.85F;

}  // namespace

Link LinkPositions(PositionId from, const FeatureSet& from_features, PositionId to,
                   const FeatureSet& to_features, const PoseOptions& options) {
  Link link;
  link.from = from;
  link.to = to;
  std::vector<Match> matches = MatchFeatures(from_features, to_features, kMaxRatio);
  std::sort(matches.begin(), matches.end(), [](const Match& x, const Match& y) {
    return std::tie(x.ratio, x.a) < std::tie(y.ratio, y.a);
  });
  link.matches = static_cast<int>(matches.size());
  std::vector<RayPair> pairs;
  pairs.reserve(matches.size());
  for (const Match& match : matches) {
    pairs.push_back({from_features.features[static_cast<std::size_t>(match.a)].ray,
                     to_features.features[static_cast<std::size_t>(match.b)].ray});
  }
  RelativePoseOptions relative;
  relative.threshold_rad = options.ransac_threshold_rad;
  relative.min_inliers = options.min_inliers;
  relative.min_inlier_fraction = options.min_inlier_fraction;
  relative.min_baseline_ratio = options.min_baseline_ratio;
  const std::uint64_t seed = static_cast<std::uint64_t>(Value(from)) * 0x100000001b3ULL +
                             static_cast<std::uint64_t>(Value(to));
  link.motion = EstimateRelativePose(pairs, seed, relative);
  for (const int i : link.motion.inliers) {
    const Match& match = matches[static_cast<std::size_t>(i)];
    link.inliers.emplace_back(match.a, match.b);
  }
  return link;
}

std::string WhyNoLink(const Link& link, int from_features, int to_features,
                      const PoseOptions& options) {
  for (const auto& [id, count] :
       {std::pair(link.to, to_features), std::pair(link.from, from_features)}) {
    if (count < options.min_inliers) {
      return fmt::format("position {} shows {} usable features, at least {} are needed", Value(id),
                         count, options.min_inliers);
    }
  }
  return fmt::format("{} of {} matches agree with any motion between positions {} and {}",
                     link.motion.agreeing, link.matches, Value(link.from), Value(link.to));
}

}  // namespace omnihdr
