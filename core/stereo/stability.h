#pragma once

#include <vector>

#include "core/stereo/fuse.h"

namespace omnihdr {

struct AgreementOptions {
  double tolerance = 0.01;           // two disparities agree within this ...
  double relative_tolerance = 0.06;  // ... or within this fraction of the larger
};

// Cross-checking on the sphere: a pixel's surface point is looked up in each neighbour's map, where
// it is confirmed when the disparity found there agrees with its distance from there. Confidence is
// the share of neighbours that confirm; what none confirms becomes unknown, occlusions above all.
DisparityMap CrossCheck(const DisparityMap& map, const std::vector<NeighbourMap>& neighbours,
                        const AgreementOptions& options);

// Stability fusion (Merrell et al. 2007; thesis 4.2): each pixel's candidates are its own value and
// those the other maps put there. A candidate's stability is the number of candidates in front of
// it less the number of views that see through it; the one of least stability that is not negative
// wins - the nearest that is not contradicted more often than hidden - and becomes the mean of
// those that agree with it. Confidence is their number over that of the maps. Where every candidate
// is negative the pixel is a hole.
DisparityMap FuseByStability(const DisparityMap& reference,
                             const std::vector<NeighbourMap>& neighbours,
                             const AgreementOptions& options);

// Stability fusion of maps that are cross-checked first: the reference's with all neighbours', each
// neighbour's with the reference's, as matching pair by pair would have it (thesis 4.2).
DisparityMap FuseCrossChecked(const DisparityMap& reference,
                              const std::vector<NeighbourMap>& neighbours,
                              const AgreementOptions& options);

}  // namespace omnihdr
