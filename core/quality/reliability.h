#pragma once

#include <array>
#include <cstddef>

#include "core/image/image.h"
#include "core/quality/comparison_area.h"

namespace omnihdr {

// Whether a confidence can be taken at its word: what share of the pixels that are called right
// with a probability of p is right. As a reliability diagram has it (Murphy and Winkler 1977; Guo
// et al., "On Calibration of Modern Neural Networks", 2017).
class ReliabilityCurve {
 public:
  static constexpr std::size_t kBins = 10;
  struct Bin {
    double weight = 0.0;      // of the pixels in it, in units of the area's weights
    double confidence = 0.0;  // their mean; NaN for an empty bin
    double right = 0.0;       // share of them; NaN for an empty bin
  };

  // Adds the known pixels of a disparity map; `confidence` 0..1. Right is what `bad1`
  // (disparity_metrics.h) does not count as wrong: within a pixel of parallax of a panorama 1536
  // wide. Sizes equal; `baseline` as there.
  void Add(ImageView<const float> tested, ImageView<const float> confidence,
           ImageView<const float> truth, double baseline, const ComparisonArea& area);
  void Add(const ReliabilityCurve& other);

  bool empty() const;
  // Bin k holds the confidences from k/10 to (k+1)/10.
  std::array<Bin, kBins> Bins() const;
  // Mean distance of a bin's confidence from its share of right pixels, by weight. NaN when empty.
  double CalibrationError() const;

 private:
  struct Sums {
    double weight = 0.0;
    double confidence = 0.0;
    double right = 0.0;
  };
  std::array<Sums, kBins> sums_;
};

}  // namespace omnihdr
