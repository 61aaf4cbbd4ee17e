#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "core/stereo/cost_volume.h"
#include "core/stereo/stereo_view.h"

namespace omnihdr {

struct SweepOptions {
  int labels = 96;
  double max_disparity = 1.0;  // largest normalised disparity searched, inclusive
  int value_truncation = 36;   // of one lane's interval distance, in codes
  int gradient_truncation = 36;
  int gradient_shift = 0;          // halves the gradient's say this many times
  int unknown_cost = 24;           // of a pair of which one side says nothing (of 4 lanes' sum)
  bool aggregates = true;          // each cost becomes the mean of the 3×3 around (AggregateCosts)
  std::vector<LabelRange> ranges;  // searched, tile by tile (cost_volume.h); empty = all labels
};

struct SweepNeighbour {
  const StereoView* view = nullptr;
  // Its centre seen from the reference's centre, in the world frame, in the unit whose inverse the
  // disparity is.
  Eigen::Vector3f offset = Eigen::Vector3f::Zero();
};

// Plane sweep on the sphere: for the surface point at inverse distance d along the unit ray u,
// neighbour n at offset b sees it along u − d·b (thesis eq. 4.5: normalised disparity). The cost of
// a hypothesis is the mean over all pairs of views (the reference and up to four neighbours;
// neighbours among themselves too: where the reference is saturated they still match each other) of
// the truncated distances between the lanes' intervals. The map has half the views' lattice size.
// Deterministic on any number of cores.
CostVolume SweepCosts(const StereoView& reference, const std::vector<SweepNeighbour>& neighbours,
                      const SweepOptions& options);

}  // namespace omnihdr
