#include "core/quality/picture_metrics.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>

namespace omnihdr {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr int kRadius = 5;
constexpr int kTaps = 2 * kRadius + 1;

template <typename Transform>
double PsnrOf(ImageView<const float> tested, ImageView<const float> truth, double peak,
              const ComparisonArea& area, Transform transform) {
  assert(tested.width() == truth.width() && tested.height() == truth.height() &&
         tested.channels() == truth.channels());
  double sum = 0.0;
  double weights = 0.0;
  for (int y = 0; y < truth.height(); ++y) {
    for (int x = 0; x < truth.width(); ++x) {
      if (!area.Has(x, y)) continue;
      for (int c = 0; c < truth.channels(); ++c) {
        const double a = static_cast<double>(tested.at(x, y, c));
        const double b = static_cast<double>(truth.at(x, y, c));
        if (!std::isfinite(a) || !std::isfinite(b)) continue;
        const double difference = transform(a) - transform(b);
        sum += area.Weight(y) * difference * difference;
        weights += area.Weight(y);
      }
    }
  }
  if (!(weights > 0.0)) return kNaN;
  return 10.0 * std::log10(peak * peak * weights / sum);
}

std::array<double, kTaps> GaussianTaps() {
  std::array<double, kTaps> taps{};
  double sum = 0.0;
  for (int i = 0; i < kTaps; ++i) {
    const double d = static_cast<double>(i - kRadius);
    taps[static_cast<std::size_t>(i)] = std::exp(-d * d / (2.0 * 1.5 * 1.5));
    sum += taps[static_cast<std::size_t>(i)];
  }
  for (double& tap : taps) tap /= sum;
  return taps;
}

int Wrapped(int x, int width) { return ((x % width) + width) % width; }

}  // namespace

double Psnr(ImageView<const float> tested, ImageView<const float> truth, double peak,
            const ComparisonArea& area) {
  return PsnrOf(tested, truth, peak, area, [](double v) { return v; });
}

double PsnrMu(ImageView<const float> tested, ImageView<const float> truth, double white,
              const ComparisonArea& area) {
  constexpr double kMu = 5000.0;
  return PsnrOf(tested, truth, 1.0, area, [white](double v) {
    return std::log1p(kMu * std::clamp(v / white, 0.0, 1.0)) / std::log1p(kMu);
  });
}

double Ssim(ImageView<const float> tested, ImageView<const float> truth, double peak,
            const ComparisonArea& area, bool wraps) {
  const int width = truth.width();
  const int height = truth.height();
  assert(tested.width() == width && tested.height() == height);
  if (height < kTaps || width < kTaps) return kNaN;
  const std::array<double, kTaps> taps = GaussianTaps();
  // The weighted window sums of 1 (invalid pixels), a, b, a², b², ab, rows first: one row of each
  // of the last 11 picture rows is kept.
  enum Sum { kInvalid, kA, kB, kAA, kBB, kAB, kSums };
  Image<double> rows(width, kTaps, kSums);
  const int first = wraps ? 0 : kRadius;
  const int last = wraps ? width : width - kRadius;
  const double c1 = (0.01 * peak) * (0.01 * peak);
  const double c2 = (0.03 * peak) * (0.03 * peak);
  double total = 0.0;
  double weights = 0.0;
  Image<double> products(width, 1, kSums);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      double* out = products.pixel(x, 0);
      const double a = static_cast<double>(tested.at(x, y));
      const double b = static_cast<double>(truth.at(x, y));
      const bool usable = area.Has(x, y) && std::isfinite(a) && std::isfinite(b);
      out[kInvalid] = usable ? 0.0 : 1.0;
      out[kA] = usable ? a : 0.0;
      out[kB] = usable ? b : 0.0;
      out[kAA] = out[kA] * out[kA];
      out[kBB] = out[kB] * out[kB];
      out[kAB] = out[kA] * out[kB];
    }
    for (int x = first; x < last; ++x) {
      double* out = rows.pixel(x, y % kTaps);
      std::fill_n(out, static_cast<int>(kSums), 0.0);
      for (int k = -kRadius; k <= kRadius; ++k) {
        const double tap = taps[static_cast<std::size_t>(k + kRadius)];
        const double* in = products.pixel(wraps ? Wrapped(x + k, width) : x + k, 0);
        for (int s = 0; s < kSums; ++s) out[s] += tap * in[s];
      }
    }
    if (y < kTaps - 1) continue;
    const double weight = area.Weight(y - kRadius);
    for (int x = first; x < last; ++x) {
      std::array<double, kSums> sums{};
      for (int k = 0; k < kTaps; ++k) {
        const double* in = rows.pixel(x, (y - kTaps + 1 + k) % kTaps);
        for (std::size_t s = 0; s < kSums; ++s)
          sums[s] += taps[static_cast<std::size_t>(k)] * in[s];
      }
      if (sums[kInvalid] > 0.0) continue;
      const double variance_a = sums[kAA] - sums[kA] * sums[kA];
      const double variance_b = sums[kBB] - sums[kB] * sums[kB];
      const double covariance = sums[kAB] - sums[kA] * sums[kB];
      total += weight * ((2.0 * sums[kA] * sums[kB] + c1) * (2.0 * covariance + c2)) /
               ((sums[kA] * sums[kA] + sums[kB] * sums[kB] + c1) * (variance_a + variance_b + c2));
      weights += weight;
    }
  }
  return weights > 0.0 ? total / weights : kNaN;
}

ReinhardParameters ReinhardParametersOf(ImageView<const float> luminance,
                                        const ComparisonArea& area) {
  double sum = 0.0;
  double weights = 0.0;
  double largest = 0.0;
  for (int y = 0; y < luminance.height(); ++y) {
    for (int x = 0; x < luminance.width(); ++x) {
      const double value = static_cast<double>(luminance.at(x, y));
      if (!area.Has(x, y) || !std::isfinite(value) || !(value > 0.0)) continue;
      sum += area.Weight(y) * std::log(value);
      weights += area.Weight(y);
      largest = std::max(largest, value);
    }
  }
  ReinhardParameters parameters;
  if (weights > 0.0) {
    parameters.log_average = std::exp(sum / weights);
    parameters.white = 0.18 * largest / parameters.log_average;
  }
  return parameters;
}

Image<float> ReinhardDisplay(ImageView<const float> luminance,
                             const ReinhardParameters& parameters) {
  Image<float> display(luminance.width(), luminance.height(), 1);
  const double key = 0.18 / parameters.log_average;
  const double white_squared = parameters.white * parameters.white;
  for (int y = 0; y < luminance.height(); ++y) {
    for (int x = 0; x < luminance.width(); ++x) {
      const double l = key * static_cast<double>(luminance.at(x, y));
      display.at(x, y) =
          static_cast<float>(std::clamp(l * (1.0 + l / white_squared) / (1.0 + l), 0.0, 1.0));
    }
  }
  return display;
}

}  // namespace omnihdr
