#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/base/result.h"
#include "core/base/units.h"
#include "core/pose/bundle_adjustment.h"
#include "core/pose/features.h"
#include "core/pose/pose_tracker.h"
#include "core/sphere/pose.h"

namespace omnihdr {

inline constexpr int kMaxKeyframePoints = 400;

// A remembered place: where it was and the points seen from it whose distance is known.
struct Keyframe {
  PositionId position{};
  std::int64_t ordinal = 0;  // how many positions came before
  int chain = 0;
  Pose world_from_camera;
  double path = 0.0;                     // length of the chain up to here
  double median_inverse_distance = 0.0;  // of the points, > 0
  FeatureSet features;                   // their rays: to where the point is, camera frame
  std::vector<double> inverse_distance;  // of each feature's point from the camera

  BundlePoint Point(int index) const;  // in the chain's world, fixed
};

// Numbers and descriptors as they are in memory, with a magic number in front.
std::string KeyframeToBytes(const Keyframe& keyframe);
// kData error saying what is wrong with the bytes.
Result<Keyframe> KeyframeFromBytes(const std::string& bytes);

// The features that vote for a place: the first ones, which are the strongest of each part of the
// picture.
FeatureSet VotersOf(const FeatureSet& features);
// How many of them resemble one point of the place distinctly.
int Votes(const Keyframe& keyframe, const FeatureSet& voters);

// A place seen again.
struct Recognition {
  Pose world_from_camera;                  // of the new position, in the keyframe's chain
  std::vector<std::pair<int, int>> pairs;  // (point of the keyframe, feature of the new position)
};
// The pose from which the keyframe's points are seen where the features are (resection.h); nothing
// when too few agree or all lie in one direction, which one object that stands in two places would
// do. `seed` decides the draws.
std::optional<Recognition> Recognise(const Keyframe& keyframe, std::uint64_t seed,
                                     const FeatureSet& features, const PoseOptions& options);

}  // namespace omnihdr
