#pragma once

#include <span>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/photometry/measure.h"
#include "core/photometry/noise_model.h"
#include "core/photometry/response.h"

namespace omnihdr {

struct RefineOptions {
  double limit = 0.2;         // largest correction, relative; a label off by more is kept
  double least = 0.005;       // smallest correction: a label this close is right
  std::size_t samples = 500;  // values two frames must share before their ratio counts
  double value_low = 10.0;    // usable range of pixel values, 8-bit units
  double value_high = 245.0;
  NoiseModel noise;
};

enum class RefineVerdict {
  kLabelRight,
  kRefined,
  kBeyondLimit,   // kept as labelled
  kInconsistent,  // kept: so many labels seem wrong that it is the response or the alignment
  kNoOverlap,     // shares too few values with the others, or does not show the same: as labelled
};

// One frame's exposure as its neighbours in the bracket see it.
struct RefinedExposure {
  double scale = 1.0;       // exposure to use = label · scale
  double measured = 1.0;    // exposure as the overlaps say, over the label
  std::size_t samples = 0;  // values shared with the next shorter and the next longer exposure
  RefineVerdict verdict = RefineVerdict::kLabelRight;
};

// Tests the exposure labels of a bracket taken at one place against the pictures: for each two
// neighbouring exposures the ratio of what they measure where both are well exposed (robust mean
// weighted by noise; samples chosen by the longer, cleaner one, so that the choice does not bias
// it), chained over the bracket. Only ratios can be seen: the median label counts as right (of two
// frames the longer). Where small steps add up to a large one, or more than a quarter of the labels
// (and more than one) seem wrong beyond the limit, none is corrected. One result per frame, in the
// order given. Deterministic. Errors: as Measure.
Result<std::vector<RefinedExposure>> RefineExposures(std::span<const ExposedFrame> frames,
                                                     const Response& response, int bits,
                                                     ImageView<const std::uint8_t> mask,
                                                     const RefineOptions& options);

// What to tell the user, by frame in the order given; empty when all labels are right. `names`: of
// the frames.
std::vector<std::string> RefinementNotes(std::span<const RefinedExposure> refined,
                                         std::span<const ExposedFrame> labelled,
                                         std::span<const std::string> names, double limit);

}  // namespace omnihdr
