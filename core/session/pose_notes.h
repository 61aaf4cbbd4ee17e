#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <string_view>

#include "core/base/units.h"

namespace omnihdr {

// What is said of a pose beside the pose itself (README: "Poses").

// One standard deviation, axis by axis.
struct PoseSigma {
  Eigen::Vector3d rotation_deg = Eigen::Vector3d::Zero();  // about the camera's X, Y, Z
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();  // along the world's X, Y, Z; chain's unit
};

// Where a chain's unit of length comes from.
enum class ScaleSource : std::uint8_t {
  kNone,      // its first baseline: relative
  kOdometer,  // metres driven
  kGnss,      // satellite fixes along the way
  kGiven,     // poses known from elsewhere
};
std::string_view ToString(ScaleSource source);
std::optional<ScaleSource> ScaleSourceFromString(std::string_view name);

// What satellite fixes along a chain make of its unit of length.
struct GnssScale {
  double metres_per_unit = 1.0;
  double sigma = 0.0;  // one standard deviation of that
  int fixes = 0;       // that agree
  int outliers = 0;    // that do not
  bool operator==(const GnssScale&) const = default;
};

// An old place was recognised and the position was put into that place's chain.
struct Relocalisation {
  PositionId place{};      // the old position
  PositionId seen_from{};  // the position that saw it again: this one, or one shortly after it
  int from_chain = 0;      // what was followed until then
  int matches = 0;         // points of the old place that were found again where they should be
};

// A place of the same chain was recognised after having been away from it.
struct LoopClosure {
  PositionId place{};
  PositionId seen_from{};
  int matches = 0;
  // What had added up on the way round: the pose as the old place sees it against the pose as
  // followed, angle and distance, and the ratio of their units of length.
  double drift_rotation_deg = 0.0;
  double drift_translation = 0.0;
  double drift_scale = 1.0;
  bool corrected = false;  // this pose and those after it are in the old place's frame
};

}  // namespace omnihdr
