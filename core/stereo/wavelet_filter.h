#pragma once

#include "core/stereo/sgm.h"

namespace omnihdr {

struct WaveletOptions {
  int scales = 3;           // of the transform, 1 to 5; the coarsest filter reaches 2^(scales+1)
                            // pixels
  double tolerance = 0.01;  // a disparity is low when the coarse map nowhere near comes down to it
                            // within this ...
  double relative_tolerance = 0.06;  // ... or within this fraction of the coarse map's value
  double noise_sigmas = 3.0;  // details below so many standard deviations of their scale are noise
};

// Filter on the redundant ("a trous") wavelet transform with the cubic B-spline, rows closing round
// the globe, unknown pixels left out of every mean. Two things happen, as in the thesis (4.2):
// low-disparity outliers - known pixels farther away than anything the coarse map holds in their
// neighbourhood - become unknown with confidence 0; then small noise goes, by setting the details
// that are below the noise of their scale (from their median magnitude) to zero. Details of edges
// are far above it and stay whole, so a step remains a step. Unknown stays unknown.
void FilterWavelet(const WaveletOptions& options, DisparityMap* map);

}  // namespace omnihdr
