#pragma once

#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/base/result.h"
#include "core/pose/pose_tracker.h"

namespace omnihdr {

// Pairs of features found with the help of poses, where the pictures alone gave no motion: they do
// not follow from the pictures, so they are remembered.
struct AdoptedPairs {
  PositionId from{};
  std::vector<std::pair<int, int>> features;  // (of `from`, of this position)
};

// What the tracker remembers of a position besides its features and links, which follow from its
// pixels.
struct TrackedPosition {
  PoseEstimate estimate;
  std::optional<double> odometer_m;
  bool given = false;  // the pose came from elsewhere and stays
  std::vector<AdoptedPairs> adopted;
};

// What positions of one chain have in common.
struct Chain {
  PositionId first{};
  bool metric = false;
  bool scaled = false;  // a baseline has been seen, so lengths mean something
  bool given = false;   // its world frame is that of poses known from elsewhere
  // The baseline of length 1 of a chain without metric scale; the same position twice before
  // `scaled`.
  PositionId unit_from{};
  PositionId unit_to{};
};

struct TrackerState {
  std::vector<TrackedPosition> window;  // oldest first
  std::map<int, Chain> chains;          // those of positions in the window
  int next_chain = 0;
};

// JSON text; numbers survive the round trip exactly.
std::string TrackerStateToJson(const TrackerState& state);
// kData error saying what is missing or of the wrong type.
Result<TrackerState> TrackerStateFromJson(const std::string& text);

}  // namespace omnihdr
