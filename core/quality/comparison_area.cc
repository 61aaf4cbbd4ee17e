#include "core/quality/comparison_area.h"

#include <algorithm>
#include <cstddef>
#include <limits>

namespace omnihdr {

ComparisonArea SphereArea(const Projection& projection, ImageView<const std::uint8_t> mask) {
  ComparisonArea area;
  area.mask = mask;
  area.row_weights.reserve(static_cast<std::size_t>(projection.height()));
  for (int y = 0; y < projection.height(); ++y) {
    area.row_weights.push_back(projection.PixelSolidAngle(y));
  }
  return area;
}

double WeightedQuantile(std::span<WeightedValue> values, double quantile) {
  std::sort(values.begin(), values.end(),
            [](const WeightedValue& a, const WeightedValue& b) { return a.value < b.value; });
  double total = 0.0;
  for (const WeightedValue& v : values) total += static_cast<double>(v.weight);
  if (!(total > 0.0)) return std::numeric_limits<double>::quiet_NaN();
  const double wanted = std::clamp(quantile, 0.0, 1.0) * total;
  double sum = 0.0;
  for (const WeightedValue& v : values) {
    sum += static_cast<double>(v.weight);
    if (sum >= wanted && v.weight > 0.0F) return static_cast<double>(v.value);
  }
  return static_cast<double>(values.back().value);
}

}  // namespace omnihdr
