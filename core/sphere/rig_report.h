#pragma once

#include <array>
#include <optional>
#include <string>
#include <vector>

#include "core/sphere/rig.h"

namespace omnihdr {

// What a person checks a rig file by. Directions of the rig frame: azimuth 0 = forward (X),
// positive to the left (Y); elevation positive up (Z).
struct SensorOptics {
  double azimuth_deg = 0.0;  // of the lens's axis
  double elevation_deg = 0.0;
  // Where the picture's own up (toward row 0) points, seen from behind the lens: 0 = up, 90 = to
  // the right. For a lens that looks straight up or down: against the rig's backward or forward.
  double roll_deg = 0.0;
  double field_across_deg = 0.0;  // through the centre, along the rows; as far as rays land
  double field_down_deg = 0.0;    // along the columns
  double share = 0.0;             // of the sphere that it sees
  double offset_m = 0.0;          // from the rig's centre
  // Offset along the axis: negative = the lens looks at the head's own centre, which tells of a
  // mirrored or inverted pose.
  double outward_m = 0.0;
};

struct RigOverlap {
  int first = 0;
  int second = 0;
  double share = 0.0;  // of the sphere seen by both
};

struct RigReport {
  std::vector<SensorOptics> sensors;
  double covered = 0.0;        // share of the sphere seen by at least one sensor
  double covered_twice = 0.0;  // by at least two
  // Elevations between which every azimuth is seen; empty where no row is.
  std::optional<std::array<double, 2>> closed_band_deg;
  std::vector<RigOverlap> overlaps;  // of the pairs that have one
  // Sensor that sees forward, left, back, right, up, down nearest to its axis; -1 = none.
  std::array<int, 6> directions{-1, -1, -1, -1, -1, -1};
  // What looks wrong, for people.
  std::vector<std::string> warnings;
};

inline constexpr std::array<const char*, 6> kDirectionNames = {"forward", "left", "back",
                                                               "right",   "up",   "down"};

// Samples the sphere of the rig's radius at one point per square degree and finer. Requires a valid
// rig. Masks are not looked at.
RigReport ExamineRig(const Rig& rig);

}  // namespace omnihdr
