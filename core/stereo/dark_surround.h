#pragma once

#include <vector>

#include "core/image/image.h"
#include "core/photometry/measurement.h"
#include "core/stereo/row_geometry.h"

namespace omnihdr {

// What may lie at a pixel that is too dark in a view to say so by itself. A single such pixel
// contradicts nothing: at the edge between something black and something a little brighter than the
// noise, another view's sample of the wrong side passes for it. The means of 3 × 3 pixels around it
// have a third of its noise; what lies outside all of theirs is not there.
//
// Borrowed: the measurement must outlive it. Thread-safe.
class DarkSurround {
 public:
  explicit DarkSurround(const Measurement& own);

  // The least and the most radiance of green that each point (x, y of the view's own pixels) may
  // have: three standard deviations of a mean, and a tenth, beyond the means around it. Infinite
  // where the view is not dark, or has not measured all of the pixels around.
  void LimitsOfRow(const PointRow& points, std::vector<float>* least,
                   std::vector<float>* most) const;

 private:
  float Variance(float radiance) const;

  const Measurement& own_;
  Image<float> mean_;  // of green over 3 × 3 pixels; NaN where one of them is not measured
};

}  // namespace omnihdr
