#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/sphere/rig.h"

namespace omnihdr {

struct OrientationOptions {
  // Between directions that are compared; pictures are reduced to that.
  double sample_deg = 1.5;
  // About the size of a patch. Means and slopes of patches do not count: a sky agrees with much.
  double patch_deg = 12.0;
  double texture = 0.06;    // spread of the logarithm of values that makes a patch count
  int least_patches = 15;   // of a frame, below which it says nothing
  int least_compared = 20;  // of all frames, where an alternative differs, below which it is none
  // Agreement is the mean over patches of the correlation of two sensors' logarithms, -1 to 1.
  double agrees = 0.5;       // from here on the configured calibration is said to agree
  double contradicts = 0.6;  // what an alternative must reach at least where they differ
  // By so much an alternative must be ahead of the configured one, where they differ.
  double clearly_better = 0.25;
  double about_equal = 0.05;  // alternatives within this of the best are told, too
  Status Validate() const;
};

enum class OrientationVerdict {
  kUndecided,     // too little that two sensors see, or nothing agrees clearly best
  kAgrees,        // the sensors' pictures agree under the calibration, and under none better
  kContradicted,  // they disagree, and agree clearly better under another one
};
std::string_view ToString(OrientationVerdict verdict);

// How well neighbouring sensors agree when the calibration is taken for wrong in one way.
struct OrientationAlternative {
  std::string what;  // "the pictures are stored upside down"; empty = as configured
  double agreement = 0.0;
  int patches = 0;
  // Of the overlaps in which it differs from the configured one: their agreement, and what the
  // configured one makes of them.
  double where_it_differs = 0.0;
  double configured_there = 0.0;
};

struct OrientationReport {
  OrientationVerdict verdict = OrientationVerdict::kUndecided;
  OrientationAlternative configured;
  // When contradicted: the best alternative, and those that agree about as well. Overlaps cannot
  // tell everything apart: mirrored pictures are like sensors that are counted the other way round.
  std::vector<OrientationAlternative> best;
  int frames = 0;
  // One sentence, with the numbers.
  std::string Text() const;
};

// Whether a head's pictures are what its calibration says: looks where neighbouring sensors see the
// same directions, and compares what they show there under the calibration as configured and under
// its likely mistakes: all pictures mirrored, upside down or on their side, a single one so, two
// sensors exchanged, the ring counted the other way round or from another sensor on, all counted
// from the other end. Law: gains, exposure and any rising response do not matter, nor does the
// order of frames. A world that is mirrored as a whole (mirrored pictures of sensors that are
// counted the other way round) agrees as well as the right one: only a text or a chart tells
// (`omnihdr calibrate white-balance`). Not thread-safe.
class OrientationCheck {
 public:
  // Some 50 projections of the sphere: a second of work. kData: fewer than two sensors see the same
  // directions, so that there is nothing to compare.
  static Result<OrientationCheck> Create(const Rig& rig, const OrientationOptions& options = {});

  // A frame: the sensors' pictures one below the other, mosaics or grey, as they are delivered,
  // with values up to the type's largest. False: it says nothing, for what two sensors see is
  // clipped, dark or without texture, and does not count. kData: another size than the rig's.
  Result<bool> Add(ImageView<const std::uint8_t> stack);
  Result<bool> Add(ImageView<const std::uint16_t> stack);
  OrientationReport Report() const;

 private:
  // How one slot of the rig is taken to be filled.
  struct Slot {
    int picture = 0;       // which of the stack
    bool on_side = false;  // the rotation is a quarter turn off, about the lens's axis
    bool flip_x = false;   // of the stored picture
    bool flip_y = false;
    bool operator==(const Slot&) const = default;
  };
  // Of patches of an overlap.
  struct Agreement {
    double sum = 0.0;  // of correlations
    int patches = 0;
    double mean() const { return patches > 0 ? sum / patches : 0.0; }
    void Add(const Agreement& other) {
      sum += other.sum;
      patches += other.patches;
    }
  };
  struct Hypothesis {
    std::string what;
    std::vector<Slot> slots;
    std::vector<Agreement> pairs;  // of slots, the first · their number + the second
  };
  // Where a direction falls in a slot's picture, by direction; NaN where it does not.
  using Pixels = std::vector<Eigen::Vector2f>;
  // The pictures of a frame, reduced: logarithms, NaN where clipped or dark.
  using Reduced = std::vector<Image<float>>;

  OrientationCheck() = default;
  void ListHypotheses();
  std::vector<int> Ring() const;
  template <typename Value>
  Result<bool> AddValues(ImageView<const Value> stack);
  float ValueAt(const Reduced& pictures, int slot, const Slot& as, std::size_t direction) const;
  std::vector<Agreement> Compare(const Reduced& pictures, const Hypothesis& hypothesis) const;
  OrientationAlternative Judge(const Hypothesis& hypothesis) const;

  OrientationOptions options_;
  Rig rig_;
  std::vector<Eigen::Vector2f> place_in_patch_;  // of each direction
  std::vector<int> patch_of_;                    // of each direction
  int patch_count_ = 0;
  std::vector<std::vector<Pixels>> pixels_;  // by slot, and by whether it is on its side
  std::vector<int> reduction_;               // pixels a side that make one value, by sensor
  std::vector<Hypothesis> hypotheses_;       // the configured one first
  int frames_ = 0;
};

}  // namespace omnihdr
