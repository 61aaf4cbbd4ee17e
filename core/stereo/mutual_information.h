#pragma once

#include <vector>

#include "core/stereo/stereo_view.h"
#include "core/stereo/sweep.h"

namespace omnihdr {

struct MutualInformationOptions {
  int passes = 2;               // disparities found on the coarse map before the table is final
  int coarse = 4;               // how many times smaller the coarse map is, each side
  float codes_per_nat = 20.0F;  // cost of losing one nat of pointwise information
};

// Pixelwise mutual information (Kim, Kolmogorov and Zabih 2003; Hirschmueller 2008): how much more
// often two values meet in the two views than chance would have it, from the joint histogram of the
// views registered by a disparity. The first registration takes everything to be at infinity, the
// next ones the disparity that semi-global matching finds with it on a map `coarse` times smaller.
// Each neighbour has its own table, so exposures and responses need not be known: any relation of
// values is learnt, saturation included. Grey values and scale of costs as in pairwise_costs.h.
CostVolume MutualInformationCosts(const StereoView& reference,
                                  const std::vector<SweepNeighbour>& neighbours,
                                  const SweepOptions& options,
                                  const MutualInformationOptions& information);

}  // namespace omnihdr
