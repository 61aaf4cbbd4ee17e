#pragma once

#include <cstdint>
#include <span>
#include <utility>
#include <vector>

#include "core/image/image.h"
#include "core/sphere/projection.h"

namespace omnihdr {

// Which pixels two pictures are compared on and how much each counts. The pixels of a panorama
// stand for different solid angles, so that an average over them must be weighted or the poles
// count too much.
struct ComparisonArea {
  // W×H×1, non-zero = compare. Empty: everywhere.
  ImageView<const std::uint8_t> mask;
  // One weight a row. Empty: every pixel counts the same (planar pictures).
  std::vector<double> row_weights;

  bool Has(int x, int y) const { return mask.empty() || mask.at(x, y) != 0; }
  double Weight(int y) const {
    return row_weights.empty() ? 1.0 : row_weights[static_cast<std::size_t>(y)];
  }
};

// Every pixel of a panorama by its solid angle in steradians; `mask` as in ComparisonArea.
ComparisonArea SphereArea(const Projection& projection, ImageView<const std::uint8_t> mask = {});

struct WeightedValue {
  float value = 0.0F;
  float weight = 0.0F;
};
// The value below which the share `quantile` (0..1) of the weight lies: the smallest v with
// weight(values ≤ v) ≥ quantile · total. NaN for no weight at all. Reorders `values`.
double WeightedQuantile(std::span<WeightedValue> values, double quantile);

}  // namespace omnihdr
