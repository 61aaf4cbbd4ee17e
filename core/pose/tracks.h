#pragma once

#include <utility>
#include <vector>

#include "core/pose/bundle_adjustment.h"
#include "core/pose/features.h"

namespace omnihdr {

// One point of the scene as seen from several positions: (index of the position, index of the
// feature there), ascending, at most one feature a position.
struct Track {
  std::vector<std::pair<int, int>> sightings;
};

// Pairs of features of two positions that show the same point.
struct FeaturePairs {
  int a = 0;  // index of the position
  int b = 0;
  std::vector<std::pair<int, int>> features;
};

// Joins pairs into tracks. A track that would show one point at two places of one picture is
// contradictory and left out. `feature_counts[i]` is the number of features of position i. The
// longest tracks come first; the order depends on the pairs as a set only.
std::vector<Track> BuildTracks(const std::vector<int>& feature_counts,
                               const std::vector<FeaturePairs>& pairs);

// A sighting from a camera whose pose is known.
struct Sighting {
  const Pose* world_from_camera = nullptr;
  Eigen::Vector3d ray;
};
// The point seen, from the first camera: direction as that camera saw it, inverse distance by least
// squares over the others. At least one sighting.
BundlePoint Triangulate(const std::vector<Sighting>& sightings);
// Largest angle between two of the sightings' rays in the world: how well the distance is known.
double LargestParallax(const std::vector<Sighting>& sightings);

}  // namespace omnihdr
