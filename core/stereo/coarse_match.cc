#include "core/stereo/coarse_match.h"

#include <algorithm>

#include "core/stereo/pairwise_costs.h"

namespace omnihdr {
namespace {

constexpr int kLeastCoarseLabels = 16;

}  // namespace

DisparityMap MatchCoarse(StereoCost cost, const StereoView& reference,
                         const std::vector<SweepNeighbour>& neighbours, const SweepOptions& sweep) {
  SweepOptions coarse = sweep;
  coarse.labels = std::max(kLeastCoarseLabels, sweep.labels / 2);
  coarse.ranges.clear();
  return OptimiseSemiGlobal(MatchingCosts(cost, reference, neighbours, coarse), reference,
                            SgmOptions{});
}

}  // namespace omnihdr
