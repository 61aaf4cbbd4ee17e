#pragma once

namespace omnihdr {

// Variance of a pixel value Z above black, in squared 8-bit code values:
//   var(Z) = read² + gain·(Z − black) + 1/12
// read noise, photon (shot) noise, quantisation (photon transfer, Janesick 2007). `prnu` adds the
// proportional part (pixel gain spread).
struct NoiseModel {
  double read = 0.5;    // code values rms; 0 = to be estimated from each frame (Measure)
  double gain = 0.02;   // code values of variance per code value: 255 / full well in electrons
  double prnu = 0.005;  // fraction
  double VarianceOfValue(double value_above_black) const {
    const double v = value_above_black > 0.0 ? value_above_black : 0.0;
    return read * read + gain * v + prnu * prnu * v * v + 1.0 / 12.0;
  }
};

}  // namespace omnihdr
