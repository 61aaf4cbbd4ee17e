#include "core/quality/picture_metrics.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "core/base/parallel_for.h"

namespace omnihdr {
namespace {

constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();
constexpr int kRadius = 5;
constexpr std::size_t kTaps = 2 * kRadius + 1;

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
  for (std::size_t i = 0; i < kTaps; ++i) {
    const double d = static_cast<double>(i) - kRadius;
    taps[i] = std::exp(-d * d / (2.0 * 1.5 * 1.5));
    sum += taps[i];
  }
  for (double& tap : taps) tap /= sum;
  return taps;
}

// What a window is made of, one plane each: 1 where a pixel cannot be compared, a, b, a², b², ab.
enum Plane : std::size_t { kInvalid, kA, kB, kAA, kBB, kAB, kPlanes };

// One picture row's planes, each `width` long.
using PlaneRow = std::array<std::vector<double>, kPlanes>;

PlaneRow EmptyPlanes(int width) {
  PlaneRow planes;
  for (std::vector<double>& plane : planes) plane.resize(static_cast<std::size_t>(width));
  return planes;
}

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
  if (height < 2 * kRadius + 1 || width < 2 * kRadius + 1) return kNaN;
  const std::array<double, kTaps> taps = GaussianTaps();
  const double c1 = (0.01 * peak) * (0.01 * peak);
  const double c2 = (0.03 * peak) * (0.03 * peak);

  // Rows filtered along x, for the whole picture: row y's planes begin at y · kPlanes · width.
  const auto columns = static_cast<std::size_t>(width);
  std::vector<double> along_x(columns * static_cast<std::size_t>(height) * kPlanes);
  ParallelFor(height, 16, [&](int begin, int end) {
    // With a border of kRadius on both sides: the other edge of a panorama, or invalid.
    PlaneRow padded = EmptyPlanes(width + 2 * kRadius);
    for (int y = begin; y < end; ++y) {
      for (int i = 0; i < width + 2 * kRadius; ++i) {
        const int x = wraps ? (i - kRadius + width) % width : i - kRadius;
        const bool inside = x >= 0 && x < width;
        const double a = inside ? static_cast<double>(tested.at(x, y)) : kNaN;
        const double b = inside ? static_cast<double>(truth.at(x, y)) : kNaN;
        const bool usable = inside && area.Has(x, y) && std::isfinite(a) && std::isfinite(b);
        const auto at = static_cast<std::size_t>(i);
        padded[kInvalid][at] = usable ? 0.0 : 1.0;
        padded[kA][at] = usable ? a : 0.0;
        padded[kB][at] = usable ? b : 0.0;
        padded[kAA][at] = usable ? a * a : 0.0;
        padded[kBB][at] = usable ? b * b : 0.0;
        padded[kAB][at] = usable ? a * b : 0.0;
      }
      for (std::size_t plane = 0; plane < kPlanes; ++plane) {
        double* out = &along_x[(static_cast<std::size_t>(y) * kPlanes + plane) * columns];
        for (std::size_t k = 0; k < kTaps; ++k) {
          const double* in = padded[plane].data() + k;
          for (std::size_t x = 0; x < columns; ++x) out[x] += taps[k] * in[x];
        }
      }
    }
  });

  // Sums a row, added up in order afterwards: the same result however the rows were shared out.
  std::vector<double> row_total(static_cast<std::size_t>(height), 0.0);
  std::vector<double> row_count(static_cast<std::size_t>(height), 0.0);
  ParallelFor(height - 2 * kRadius, 16, [&](int begin, int end) {
    PlaneRow sums = EmptyPlanes(width);
    for (int y = begin + kRadius; y < end + kRadius; ++y) {
      for (std::size_t plane = 0; plane < kPlanes; ++plane) {
        std::fill(sums[plane].begin(), sums[plane].end(), 0.0);
        for (std::size_t k = 0; k < kTaps; ++k) {
          const std::size_t row = static_cast<std::size_t>(y) - kRadius + k;
          const double* in = &along_x[(row * kPlanes + plane) * columns];
          for (std::size_t x = 0; x < columns; ++x) sums[plane][x] += taps[k] * in[x];
        }
      }
      for (std::size_t x = 0; x < columns; ++x) {
        if (sums[kInvalid][x] > 0.0) continue;
        const double a = sums[kA][x];
        const double b = sums[kB][x];
        const double variance_a = sums[kAA][x] - a * a;
        const double variance_b = sums[kBB][x] - b * b;
        const double covariance = sums[kAB][x] - a * b;
        row_total[static_cast<std::size_t>(y)] +=
            ((2.0 * a * b + c1) * (2.0 * covariance + c2)) /
            ((a * a + b * b + c1) * (variance_a + variance_b + c2));
        row_count[static_cast<std::size_t>(y)] += 1.0;
      }
    }
  });
  double total = 0.0;
  double weights = 0.0;
  for (int y = 0; y < height; ++y) {
    total += area.Weight(y) * row_total[static_cast<std::size_t>(y)];
    weights += area.Weight(y) * row_count[static_cast<std::size_t>(y)];
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
