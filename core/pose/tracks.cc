#include "core/pose/tracks.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <numeric>

namespace omnihdr {

std::vector<Track> BuildTracks(const std::vector<int>& feature_counts,
                               const std::vector<FeaturePairs>& pairs) {
  std::vector<int> first(feature_counts.size() + 1, 0);
  std::partial_sum(feature_counts.begin(), feature_counts.end(), first.begin() + 1);
  std::vector<int> parent(static_cast<std::size_t>(first.back()));
  std::iota(parent.begin(), parent.end(), 0);
  const auto root = [&](int node) {
    while (parent[static_cast<std::size_t>(node)] != node) {
      auto& up = parent[static_cast<std::size_t>(node)];
      up = parent[static_cast<std::size_t>(up)];
      node = up;
    }
    return node;
  };
  for (const FeaturePairs& link : pairs) {
    for (const auto& [a, b] : link.features) {
      const int root_a = root(first[static_cast<std::size_t>(link.a)] + a);
      const int root_b = root(first[static_cast<std::size_t>(link.b)] + b);
      // The smaller node leads: the same trees whatever the order of the pairs.
      parent[static_cast<std::size_t>(std::max(root_a, root_b))] = std::min(root_a, root_b);
    }
  }
  std::vector<Track> by_root(parent.size());
  for (std::size_t position = 0; position < feature_counts.size(); ++position) {
    for (int feature = 0; feature < feature_counts[position]; ++feature) {
      const int top = root(first[position] + feature);
      by_root[static_cast<std::size_t>(top)].sightings.emplace_back(static_cast<int>(position),
                                                                    feature);
    }
  }
  std::vector<Track> tracks;
  for (Track& track : by_root) {
    if (track.sightings.size() < 2) continue;
    const auto clash =
        std::adjacent_find(track.sightings.begin(), track.sightings.end(),
                           [](const auto& a, const auto& b) { return a.first == b.first; });
    if (clash == track.sightings.end()) tracks.push_back(std::move(track));
  }
  std::stable_sort(tracks.begin(), tracks.end(), [](const Track& a, const Track& b) {
    return a.sightings.size() > b.sightings.size();
  });
  return tracks;
}

BundlePoint Triangulate(const std::vector<Sighting>& sightings) {
  const Pose& reference = *sightings.front().world_from_camera;
  BundlePoint point;
  point.reference = reference.translation;
  point.direction = (reference.rotation * sightings.front().ray).normalized();
  // ray × Rᵀ(direction + ρ (reference − t)) = 0, linear in ρ.
  double numerator = 0.0;
  double denominator = 0.0;
  for (std::size_t i = 1; i < sightings.size(); ++i) {
    const Pose& pose = *sightings[i].world_from_camera;
    const Eigen::Vector3d ray = pose.rotation * sightings[i].ray;
    const Eigen::Vector3d constant = ray.cross(point.direction);
    const Eigen::Vector3d slope = ray.cross(point.reference - pose.translation);
    numerator -= constant.dot(slope);
    denominator += slope.squaredNorm();
  }
  point.inverse_distance = denominator > 1e-18 ? numerator / denominator : 0.0;
  return point;
}

double LargestParallax(const std::vector<Sighting>& sightings) {
  double largest = 0.0;
  for (std::size_t i = 0; i < sightings.size(); ++i) {
    const Eigen::Vector3d a = sightings[i].world_from_camera->rotation * sightings[i].ray;
    for (std::size_t j = i + 1; j < sightings.size(); ++j) {
      const Eigen::Vector3d b = sightings[j].world_from_camera->rotation * sightings[j].ray;
      largest = std::max(largest, std::atan2(a.cross(b).norm(), a.dot(b)));
    }
  }
  return largest;
}

}  // namespace omnihdr
