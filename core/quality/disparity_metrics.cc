#include "core/quality/disparity_metrics.h"

#include <cassert>
#include <cmath>
#include <cstddef>
#include <vector>

namespace omnihdr {

DisparityErrors CompareDisparity(ImageView<const float> tested, ImageView<const float> truth,
                                 double baseline, const ComparisonArea& area) {
  assert(tested.width() == truth.width() && tested.height() == truth.height());
  double total = 0.0;
  double known = 0.0;
  double wrong = 0.0;
  std::vector<WeightedValue> relative;
  relative.reserve(static_cast<std::size_t>(truth.width()) *
                   static_cast<std::size_t>(truth.height()));
  for (int y = 0; y < truth.height(); ++y) {
    const double weight = area.Weight(y);
    for (int x = 0; x < truth.width(); ++x) {
      const double want = static_cast<double>(truth.at(x, y));
      if (!area.Has(x, y) || !std::isfinite(want)) continue;
      total += weight;
      const double have = static_cast<double>(tested.at(x, y));
      if (!std::isfinite(have)) continue;
      known += weight;
      const double error = std::abs(have - want);
      if (error * baseline > kOnePixelOfParallax) wrong += weight;
      if (want > 0.0) {
        relative.push_back({static_cast<float>(error / want), static_cast<float>(weight)});
      }
    }
  }
  DisparityErrors result;
  if (!(total > 0.0)) return result;
  result.unknown = 1.0 - known / total;
  result.bad1 = (total - known + wrong) / total;
  if (known > 0.0) result.bad1_of_known = wrong / known;
  result.median_relative = WeightedQuantile(relative, 0.5);
  return result;
}

}  // namespace omnihdr
