#pragma once

#include <vector>

#include "core/stereo/methods.h"
#include "core/stereo/sgm.h"
#include "core/stereo/stereo_view.h"
#include "core/stereo/sweep.h"

namespace omnihdr {

// The map at half the size and with half the labels: the guide of a search in ranges
// (cost_volume.h) where there is no better one. `reference`, `neighbours`: HalveStereoView of those
// to be matched, offsets as theirs; `sweep`: of the search that follows, its ranges unused.
DisparityMap MatchCoarse(StereoCost cost, const StereoView& reference,
                         const std::vector<SweepNeighbour>& neighbours, const SweepOptions& sweep);

}  // namespace omnihdr
