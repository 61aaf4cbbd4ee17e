#pragma once

#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/base/result.h"
#include "core/pose/bundle_adjustment.h"
#include "core/pose/gnss_scale.h"
#include "core/pose/pose_tracker.h"

namespace omnihdr {

// Pairs of features found with the help of poses, where the pictures alone gave no motion: they do
// not follow from the pictures, so they are remembered.
struct AdoptedPairs {
  PositionId from{};
  std::vector<std::pair<int, int>> features;  // (of `from`, of this position)
};

// A feature that shows a point of a remembered place.
struct Anchor {
  int feature = 0;
  BundlePoint point;  // in the position's chain
};

// What the tracker remembers of a position besides its features and links, which follow from its
// pixels.
struct TrackedPosition {
  PoseEstimate estimate;
  std::optional<double> odometer_m;
  std::optional<double> heading_deg;
  std::optional<GnssClue> gnss;
  bool given = false;        // the pose came from elsewhere and stays
  std::int64_t ordinal = 0;  // how many positions came before
  std::vector<AdoptedPairs> adopted;
  std::vector<Anchor> anchors;  // ascending by feature
};

// What positions of one chain have in common.
struct Chain {
  PositionId first{};
  bool metric = false;
  bool scaled = false;  // a baseline has been seen, so lengths mean something
  bool given = false;   // its world frame is that of poses known from elsewhere
  ScaleSource source = ScaleSource::kNone;
  // The baseline that is the unit of a chain without odometer, and its length: 1, or metres of one
  // whose scale satellites gave later; the same position twice before `scaled`.
  PositionId unit_from{};
  PositionId unit_to{};
  double unit_length = 1.0;
  double path = 0.0;  // sum of the steps from position to position
  // Places with fixes, evenly over the chain: of those, every so-many-th was kept.
  std::vector<GnssSample> fixes;
  std::int64_t fixes_seen = 0;
  std::int64_t fix_spacing = 1;
  std::optional<GnssScale> gnss_scale;
  bool contradicted = false;  // told that the fixes contradict it
};

// A remembered place, without its content.
struct KeyframeEntry {
  PositionId position{};
  std::int64_t ordinal = 0;
  int chain = 0;
  std::uint32_t crc = 0;  // CRC-32C of its bytes
  double scale = 1.0;     // the chain's unit in units of those bytes
};

struct TrackerState {
  std::vector<TrackedPosition> window;  // oldest first
  std::map<int, Chain> chains;          // those of positions in the window and of keyframes
  int next_chain = 0;
  int next_group = 0;
  int revision = 0;
  std::int64_t pushed = 0;               // positions so far
  std::int64_t spacing = 1;              // every so-many-th position is remembered
  std::vector<KeyframeEntry> keyframes;  // ascending by ordinal
};

// JSON text; numbers survive the round trip exactly.
std::string TrackerStateToJson(const TrackerState& state);
// kData error saying what is missing or of the wrong type.
Result<TrackerState> TrackerStateFromJson(const std::string& text);

}  // namespace omnihdr
