#include "core/pose/link.h"

#include <fmt/format.h>

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <functional>
#include <tuple>

#include "core/base/parallel_for.h"
#include "core/pose/matching.h"

namespace omnihdr {
namespace {

constexpr float kMaxRatio = 0.9F;
// Among the few features near an epipolar line a match need be less distinct, ...
constexpr float kMaxGuidedRatio = 0.92F;
// ... but as similar as nearly all matches were that a motion agrees with.
constexpr double kSimilarShare = 0.99;
constexpr float kMaxScaleRatio = 2.0F;
constexpr float kNearestInverse = 3.0F;  // nearest point looked for: 1/3 of a baseline away

std::vector<RayPair> Rays(const FeatureSet& a, const FeatureSet& b,
                          const std::vector<Match>& matches) {
  std::vector<RayPair> pairs;
  pairs.reserve(matches.size());
  for (const Match& match : matches) {
    pairs.push_back({a.features[static_cast<std::size_t>(match.a)].ray,
                     b.features[static_cast<std::size_t>(match.b)].ray});
  }
  return pairs;
}

void MostDistinctFirst(std::vector<Match>& matches) {
  std::sort(matches.begin(), matches.end(), [](const Match& x, const Match& y) {
    return std::tie(x.ratio, x.a) < std::tie(y.ratio, y.a);
  });
}

// Matches among the pairs of features that `motion` allows.
std::vector<Match> MatchAlong(const FeatureSet& a, const FeatureSet& b, const RelativePose& motion,
                              int least_similarity, double threshold) {
  const Eigen::Matrix3f rotation = motion.b_from_a.rotation.toRotationMatrix().cast<float>();
  const Eigen::Vector3f direction = motion.b_from_a.translation.cast<float>();
  const bool baseline = motion.verdict == RelativePose::Verdict::kBaseline;
  const float band = static_cast<float>(threshold);
  // Padded with a ray that is nowhere, so that features can be looked over in blocks.
  constexpr int kBlock = 16;
  Eigen::Matrix3Xf rays_b =
      Eigen::Matrix3Xf::Constant(3, (b.size() + kBlock - 1) / kBlock * kBlock, 1e6F);
  for (int j = 0; j < b.size(); ++j) {
    rays_b.col(j) = b.features[static_cast<std::size_t>(j)].ray.cast<float>();
  }
  struct Best {
    int index = -1;
    int similarity = 0;
    int second = 0;
  };
  std::vector<Best> of_a(static_cast<std::size_t>(a.size()));
  ParallelFor(a.size(), 256, [&](int begin, int end) {
    Eigen::RowVectorXf off(rays_b.cols());
    for (int i = begin; i < end; ++i) {
      const Feature& feature = a.features[static_cast<std::size_t>(i)];
      const Eigen::Vector3f turned = rotation * feature.ray.cast<float>();
      const Eigen::Vector3f normal = direction.cross(turned);
      const float sine = normal.norm();
      if (baseline && sine < 10.0F * band) continue;  // the line is a point
      // Along the great circle from the ray (point at infinity) towards the direction of motion.
      const float cosine = direction.dot(turned);
      const Eigen::Vector3f ahead = baseline ? Eigen::Vector3f((direction - cosine * turned) / sine)
                                             : Eigen::Vector3f::Zero();
      const float furthest = std::atan2(kNearestInverse * sine, 1.0F + kNearestInverse * cosine);
      // Distance from the line, or from the ray, squared.
      if (baseline) {
        off.noalias() = (normal / sine).transpose() * rays_b;
        off = off.cwiseAbs();
      } else {
        off.noalias() = (rays_b.colwise() - turned).colwise().squaredNorm();
      }
      const float limit = baseline ? band : band * band;
      Best best;
      for (int j = 0; j < b.size(); ++j) {
        if (j % kBlock == 0 && off.segment<kBlock>(j).minCoeff() > limit) {
          j += kBlock - 1;
          continue;
        }
        if (off[j] > limit) continue;
        if (baseline) {
          const float angle = std::atan2(ahead.dot(rays_b.col(j)), turned.dot(rays_b.col(j)));
          if (angle < -band || angle > furthest + band) continue;
        }
        const Feature& other = b.features[static_cast<std::size_t>(j)];
        const double scale = feature.sigma_rad / other.sigma_rad;
        if (scale > static_cast<double>(kMaxScaleRatio) ||
            scale * static_cast<double>(kMaxScaleRatio) < 1.0) {
          continue;
        }
        const int similarity = DescriptorSimilarity(a, i, b, j);
        if (similarity > best.similarity) {
          best.second = best.similarity;
          best.similarity = similarity;
          best.index = j;
        } else {
          best.second = std::max(best.second, similarity);
        }
      }
      of_a[static_cast<std::size_t>(i)] = best;
    }
  });
  std::vector<int> of_b(static_cast<std::size_t>(b.size()), -1);
  for (int i = 0; i < a.size(); ++i) {
    const Best& best = of_a[static_cast<std::size_t>(i)];
    if (best.index < 0) continue;
    int& owner = of_b[static_cast<std::size_t>(best.index)];
    if (owner < 0 || best.similarity > of_a[static_cast<std::size_t>(owner)].similarity) owner = i;
  }
  std::vector<Match> matches;
  for (int i = 0; i < a.size(); ++i) {
    const Best& best = of_a[static_cast<std::size_t>(i)];
    if (best.index < 0 || best.similarity < least_similarity ||
        of_b[static_cast<std::size_t>(best.index)] != i) {
      continue;
    }
    const float ratio = DescriptorDistance(best.similarity) / DescriptorDistance(best.second);
    if (ratio < kMaxGuidedRatio) matches.push_back({i, best.index, ratio});
  }
  return matches;
}

}  // namespace

Link LinkPositions(PositionId from, const FeatureSet& from_features, PositionId to,
                   const FeatureSet& to_features, const PoseOptions& options) {
  Link link;
  link.from = from;
  link.to = to;
  std::vector<Match> matches = MatchFeatures(from_features, to_features, kMaxRatio);
  MostDistinctFirst(matches);
  link.matches = static_cast<int>(matches.size());
  RelativePoseOptions relative;
  relative.threshold_rad = options.ransac_threshold_rad;
  relative.min_inliers = options.min_inliers;
  relative.min_inlier_fraction = options.min_inlier_fraction;
  relative.min_baseline_ratio = options.min_baseline_ratio;
  const std::uint64_t seed = static_cast<std::uint64_t>(Value(from)) * 0x100000001b3ULL +
                             static_cast<std::uint64_t>(Value(to));
  link.motion = EstimateRelativePose(Rays(from_features, to_features, matches), seed, relative);
  if (!link.ok()) {
    for (const Match& match : matches) link.unexplained.emplace_back(match.a, match.b);
    return link;
  }

  std::vector<int> similarities;
  for (const int i : link.motion.inliers) {
    const Match& match = matches[static_cast<std::size_t>(i)];
    similarities.push_back(DescriptorSimilarity(from_features, match.a, to_features, match.b));
  }
  std::sort(similarities.begin(), similarities.end(), std::greater<>());
  const auto similar =
      static_cast<std::size_t>(kSimilarShare * static_cast<double>(similarities.size()));
  const std::vector<Match> guided =
      MatchAlong(from_features, to_features, link.motion,
                 similarities[std::min(similar, similarities.size() - 1)], relative.threshold_rad);
  RelativePoseOptions guided_options = relative;
  guided_options.min_inlier_fraction = 0.0;  // they were chosen to agree
  RelativePose motion =
      RefineRelativePose(Rays(from_features, to_features, guided), link.motion, guided_options);
  if (motion.verdict == link.motion.verdict &&
      motion.inliers.size() >= link.motion.inliers.size()) {
    motion.agreeing = link.motion.agreeing;
    link.motion = std::move(motion);
    matches = guided;
  }
  for (const int i : link.motion.inliers) {
    const Match& match = matches[static_cast<std::size_t>(i)];
    link.inliers.emplace_back(match.a, match.b);
  }
  return link;
}

std::vector<std::pair<int, int>> MatchByMotion(const FeatureSet& from_features,
                                               const FeatureSet& to_features,
                                               const Pose& to_from_from, int least_similarity,
                                               const PoseOptions& options) {
  RelativePose motion;
  const double length = to_from_from.translation.norm();
  motion.b_from_a = to_from_from;
  motion.verdict =
      length > 1e-9 ? RelativePose::Verdict::kBaseline : RelativePose::Verdict::kRotation;
  if (length > 1e-9) motion.b_from_a.translation /= length;
  std::vector<std::pair<int, int>> pairs;
  for (const Match& match : MatchAlong(from_features, to_features, motion, least_similarity,
                                       options.ransac_threshold_rad)) {
    pairs.emplace_back(match.a, match.b);
  }
  return pairs;
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
