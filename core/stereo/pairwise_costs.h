#pragma once

#include <vector>

#include "core/stereo/methods.h"
#include "core/stereo/stereo_view.h"
#include "core/stereo/sweep.h"

namespace omnihdr {

// Matching costs that compare the reference with each neighbour and nothing else, as the
// alternatives to SweepCosts (sweep.h): one grey value a texel, the mean of the red and blue log
// codes. A saturated or dark value counts as if it had been measured, which is what these costs do
// in the literature. Shape, labels and geometry of the volume are those of SweepCosts; costs lie on
// the same scale (0 to 144), so that one set of penalties serves all. Deterministic on any number
// of cores.

struct RadiometricOptions {
  int mean_radius = 5;      // of the local mean's square, in map pixels
  int value_weight = 2;     // of the adjusted value's distance
  int gradient_weight = 1;  // of each of the two derivatives' distances
  int truncation = 36;      // of each distance, in half codes
};

// Weighted sum of absolute differences of the radiometrically adjusted picture - value less local
// mean - and of its gradient (Brunton's cost; thesis 4.3.2). An exposure's factor is a constant in
// the logarithm, so the local mean takes it away, known or not.
CostVolume RadiometricCosts(const StereoView& reference,
                            const std::vector<SweepNeighbour>& neighbours,
                            const SweepOptions& options, const RadiometricOptions& radiometric);

// Hamming distance, times three, of 7×7 census transforms (Zabih and Woodfill 1994): unchanged by
// any monotone change of values.
CostVolume CensusCosts(const StereoView& reference, const std::vector<SweepNeighbour>& neighbours,
                       const SweepOptions& options);

// The cost by name; SweepCosts for kInterval.
CostVolume MatchingCosts(StereoCost cost, const StereoView& reference,
                         const std::vector<SweepNeighbour>& neighbours,
                         const SweepOptions& options);

}  // namespace omnihdr
