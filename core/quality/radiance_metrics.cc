#include "core/quality/radiance_metrics.h"

#include <cassert>
#include <cmath>
#include <cstddef>
#include <vector>

#include "core/photometry/tonemap.h"

namespace omnihdr {

Image<float> LuminanceOf(ImageView<const float> rgb) {
  assert(rgb.channels() >= 3);
  Image<float> luminance(rgb.width(), rgb.height(), 1);
  for (int y = 0; y < rgb.height(); ++y) {
    for (int x = 0; x < rgb.width(); ++x) luminance.at(x, y) = Luminance(rgb.pixel(x, y));
  }
  return luminance;
}

RadianceErrors CompareRadiance(ImageView<const float> tested, ImageView<const float> truth,
                               const ComparisonArea& area, ScaleFit fit) {
  assert(tested.width() == truth.width() && tested.height() == truth.height());
  std::vector<WeightedValue> errors;
  errors.reserve(static_cast<std::size_t>(truth.width()) *
                 static_cast<std::size_t>(truth.height()));
  double wanted = 0.0;
  double compared = 0.0;
  double sum_squares = 0.0;
  for (int y = 0; y < truth.height(); ++y) {
    const double weight = area.Weight(y);
    for (int x = 0; x < truth.width(); ++x) {
      if (!area.Has(x, y)) continue;
      wanted += weight;
      const float have = Luminance(tested.pixel(x, y));
      const float want = Luminance(truth.pixel(x, y));
      if (!(have > 0.0F) || !(want > 0.0F) || !std::isfinite(have) || !std::isfinite(want))
        continue;
      const double error = std::log10(static_cast<double>(have) / static_cast<double>(want));
      errors.push_back({static_cast<float>(error), static_cast<float>(weight)});
      compared += weight;
      sum_squares += weight * error * error;
    }
  }
  RadianceErrors result;
  if (!(compared > 0.0)) return result;
  result.compared = compared / wanted;
  result.log10_rmse_unscaled = std::sqrt(sum_squares / compared);
  const double median = fit == ScaleFit::kMedian ? WeightedQuantile(errors, 0.5) : 0.0;
  result.scale = std::pow(10.0, -median);
  double sum = 0.0;
  for (WeightedValue& e : errors) {
    const double centred = static_cast<double>(e.value) - median;
    sum += static_cast<double>(e.weight) * centred * centred;
    e.value = static_cast<float>(std::abs(centred));
  }
  result.log10_rmse = std::sqrt(sum / compared);
  result.log10_p50 = WeightedQuantile(errors, 0.5);
  result.log10_p95 = WeightedQuantile(errors, 0.95);
  result.log10_p99 = WeightedQuantile(errors, 0.99);
  result.log10_max = WeightedQuantile(errors, 1.0);
  return result;
}

}  // namespace omnihdr
