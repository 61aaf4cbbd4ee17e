#pragma once

#include "core/stereo/cost_volume.h"

namespace omnihdr {

// Every cost becomes the mean of those of the same label at the 3×3 pixels around, as far as that
// label is searched there; columns wrap round, rows end. A pixel's own cost is little more than
// noise where there is little texture; nine of them say three times as much, for an edge that is a
// pixel less sharp. Deterministic on any number of cores.
CostVolume AggregateCosts(const CostVolume& volume);

}  // namespace omnihdr
