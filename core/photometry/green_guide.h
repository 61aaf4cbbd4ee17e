#pragma once

#include <vector>

#include "core/image/image.h"
#include "core/photometry/mosaic.h"
#include "core/sphere/rig.h"

namespace omnihdr {

// Green at every place of a rig's mosaics, for interpolation that follows edges: where the mosaic
// has green, its value; elsewhere the mean of the neighbours along the direction in which the
// mosaic changes less, corrected by the curvature of the colour that is there (Hamilton and Adams
// 1997, US 5,629,734), the two directions weighted by the inverse squares of their changes and the
// result kept within the neighbours' range. In linear radiance, red and blue brought to green's
// scale by the sensor's gains. Laws: a saturated value never enters, unless all four neighbours
// are; values lie within those of the mosaic's greens near by, so they are finite and not negative.
// `rows` as StackedRows. Requires a one-channel mosaic; sensors without a Bayer order are copied.
// `guide` is overwritten, its memory used again when the size is the same. Uses the worker pool.
void GreenGuide(const RadianceMosaic& mosaic, const Rig& rig, const std::vector<int>& rows,
                Image<float>* guide);

}  // namespace omnihdr
