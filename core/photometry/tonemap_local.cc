// The two operators that look at a pixel's surroundings.
#include <algorithm>
#include <cassert>
#include <cmath>
#include <cstddef>
#include <limits>
#include <numbers>
#include <utility>
#include <vector>

#include "core/base/fast_math.h"
#include "core/base/parallel_for.h"
#include "core/photometry/tonemap_parts.h"

namespace omnihdr::tonemap {
namespace {

constexpr float kLog10Of2 = 0.301029996F;

// --- Reinhard's dodging and burning
// ---------------------------------------------------------------

// Eq. 5 has exp(−r²/(αs)²) with α = 0.35, s = 1.6^i: as a standard deviation in pixels.
double SigmaOfScale(int i) { return 0.35 * std::pow(1.6, i) / std::numbers::sqrt2; }
constexpr int kScales = 8;

// Unknown and infinite luminances become weightless.
OMNIHDR_SIMD_CLONES void Prepare(float* __restrict luminance, float* __restrict known, float scale,
                                 float cap, int count) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  for (int x = 0; x < count; ++x) {
    const float l = luminance[x];
    const float scaled = scale * (l > 0.0F ? l : 0.0F);
    const bool is_known = l < kInfinity;
    known[x] = is_known ? 1.0F : 0.0F;
    luminance[x] = is_known ? (scaled < cap ? scaled : cap) : 0.0F;
  }
}

// Keeps the centre's value while the neighbourhood has grown without contrast (eqs. 7 and 8).
OMNIHDR_SIMD_CLONES void Select(const float* __restrict centre, const float* __restrict surround,
                                float floor, float threshold, int count, float* __restrict active,
                                float* __restrict chosen) {
  for (int x = 0; x < count; ++x) {
    const float difference = centre[x] - surround[x];
    const float v = (difference < 0.0F ? -difference : difference) / (floor + centre[x]);
    active[x] = v < threshold ? active[x] : 0.0F;
    chosen[x] = active[x] > 0.0F ? centre[x] : chosen[x];
  }
}

// Eq. 9 over the luminance, with eq. 4's white.
OMNIHDR_SIMD_CLONES void LocalFactors(const float* __restrict luminance, float scale, float cap,
                                      float inverse_white_squared, int count,
                                      float* __restrict chosen) {
  constexpr float kInfinity = std::numeric_limits<float>::infinity();
  for (int x = 0; x < count; ++x) {
    const float l = luminance[x];
    const float scaled = scale * l < cap ? scale * l : cap;
    const float f = scale * (1.0F + scaled * inverse_white_squared) / (1.0F + chosen[x]);
    const float finite = l < kInfinity ? f : 1.0F;
    chosen[x] = l > 0.0F ? finite : 0.0F;
  }
}

void DivideBy(const Image<float>& weights, Image<float>* values) {
  for (std::size_t i = 0; i < weights.size(); ++i) {
    const float weight = weights.data()[i];
    values->data()[i] = weight > 1e-6F ? values->data()[i] / weight : 0.0F;
  }
}

// A picture and its blurs, growing scale by scale. Unknown pixels take no part: their weight is
// blurred along.
class BlurCascade {
 public:
  BlurCascade(const Image<float>& picture, const Image<float>& known, PictureShape shape)
      : shape_(shape), values_(picture.Clone()) {
    const auto weights = known.values();
    if (std::any_of(weights.begin(), weights.end(), [](float w) { return w < 1.0F; })) {
      weights_ = known.Clone();
    }
  }
  // The picture blurred by `sigma` in all, not less than before.
  Image<float> BlurTo(double sigma) {
    const double step = std::sqrt(std::max(sigma * sigma - sigma_ * sigma_, 0.0));
    sigma_ = sigma;
    Grow(step, &values_);
    Image<float> mean = values_.Clone();
    if (!weights_.empty()) {
      Grow(step, &weights_);
      DivideBy(weights_, &mean);
    }
    return mean;
  }

 private:
  void Grow(double step, Image<float>* image) const {
    Image<float> blurred;
    GaussianBlur(*image, step, shape_, &blurred);
    *image = std::move(blurred);
  }

  PictureShape shape_;
  double sigma_ = 0.0;
  Image<float> values_;
  Image<float> weights_;  // empty: all 1
};

// --- Durand and Dorsey's bilateral base layer
// -----------------------------------------------------

// The grid's cells are half a standard deviation wide, in space and in range.
constexpr double kCellsPerSigma = 2.0;

// Log luminance of a picture on a coarse grid of columns, rows and range: per cell the weight and
// the weighted sum of what fell into it, blurred; dividing the two where a pixel lies in the grid
// is the bilateral filter.
class BilateralGrid {
 public:
  BilateralGrid(int width, int height, double sigma_space, double low, double high,
                double sigma_range)
      : columns_(CellCount(width, sigma_space)),
        rows_(CellCount(height, sigma_space)),
        x_scale_(static_cast<float>(columns_) / static_cast<float>(width)),
        y_scale_(static_cast<float>(rows_) / static_cast<float>(height)),
        sigma_cells_(sigma_space * static_cast<double>(columns_) / width),
        low_(static_cast<float>(low)),
        bins_per_decade_(static_cast<float>(kCellsPerSigma / sigma_range)),
        bins_(static_cast<int>(std::ceil((high - low) * kCellsPerSigma / sigma_range)) + 2) {
    for (int bin = 0; bin < bins_; ++bin) {
      sums_.emplace_back(columns_, rows_, 1);
      weights_.emplace_back(columns_, rows_, 1);
    }
  }

  void Add(int x, int y, float value, float weight) {
    const int column =
        std::min(static_cast<int>((static_cast<float>(x) + 0.5F) * x_scale_), columns_ - 1);
    const int row =
        std::min(static_cast<int>((static_cast<float>(y) + 0.5F) * y_scale_), rows_ - 1);
    const float position = Position(value);
    const int bin = std::min(static_cast<int>(position), bins_ - 2);
    const float share = position - static_cast<float>(bin);
    for (int i = 0; i < 2; ++i) {
      const float w = weight * (i == 0 ? 1.0F - share : share);
      sums_[static_cast<std::size_t>(bin + i)].at(column, row) += w * value;
      weights_[static_cast<std::size_t>(bin + i)].at(column, row) += w;
    }
  }

  void Blur(PictureShape shape) {
    Image<float> blurred;
    for (std::vector<Image<float>>* planes : {&sums_, &weights_}) {
      for (Image<float>& plane : *planes) {
        GaussianBlur(plane, sigma_cells_, shape, &blurred);
        std::swap(plane, blurred);
      }
    }
    // Along range, into the order slicing wants: all bins of a cell, sum and weight, together.
    const int radius = static_cast<int>(std::ceil(3.0 * kCellsPerSigma));
    std::vector<float> taps;
    for (int k = -radius; k <= radius; ++k) {
      taps.push_back(
          static_cast<float>(std::exp(-0.5 * k * k / (kCellsPerSigma * kCellsPerSigma))));
    }
    cells_.assign(static_cast<std::size_t>(columns_) * static_cast<std::size_t>(rows_) *
                      static_cast<std::size_t>(bins_) * 2,
                  0.0F);
    wraps_ = shape != PictureShape::kPlane;
    ParallelFor(rows_, 4, [&](int begin, int end) {
      for (int row = begin; row < end; ++row) {
        for (int column = 0; column < columns_; ++column) {
          float* cell = &cells_[CellOffset(column, row)];
          for (int bin = 0; bin < bins_; ++bin) {
            for (int k = -radius; k <= radius; ++k) {
              if (bin + k < 0 || bin + k >= bins_) continue;
              const float tap = taps[static_cast<std::size_t>(k + radius)];
              const auto from = static_cast<std::size_t>(bin + k);
              cell[2 * bin] += tap * sums_[from].at(column, row);
              cell[2 * bin + 1] += tap * weights_[from].at(column, row);
            }
          }
        }
      }
    });
  }

  // The filtered value for a pixel of log luminance `value`.
  float Slice(int x, int y, float value) const {
    const float column = (static_cast<float>(x) + 0.5F) * x_scale_ - 0.5F;
    const float row = std::clamp((static_cast<float>(y) + 0.5F) * y_scale_ - 0.5F, 0.0F,
                                 static_cast<float>(rows_ - 1));
    const float position = Position(value);
    const float column_floor = std::floor(column);
    const int row0 = std::min(static_cast<int>(row), std::max(rows_ - 2, 0));
    const int bin = std::min(static_cast<int>(position), bins_ - 2);
    const float ax = column - column_floor;
    const float ay = row - static_cast<float>(row0);
    const float az = position - static_cast<float>(bin);
    float sum = 0.0F;
    float weight = 0.0F;
    for (int j = 0; j < 2; ++j) {
      for (int i = 0; i < 2; ++i) {
        const float w = (i == 0 ? 1.0F - ax : ax) * (j == 0 ? 1.0F - ay : ay);
        const int cell_row = std::min(row0 + j, rows_ - 1);
        const float* cell =
            &cells_[CellOffset(Column(static_cast<int>(column_floor) + i), cell_row)] + 2 * bin;
        sum += w * ((1.0F - az) * cell[0] + az * cell[2]);
        weight += w * ((1.0F - az) * cell[1] + az * cell[3]);
      }
    }
    return weight > 0.0F ? sum / weight : value;
  }

 private:
  static int CellCount(int pixels, double sigma_space) {
    return std::max(1, static_cast<int>(std::lround(pixels * kCellsPerSigma / sigma_space)));
  }
  float Position(float value) const {
    return std::clamp((value - low_) * bins_per_decade_, 0.0F, static_cast<float>(bins_ - 1));
  }
  int Column(int column) const {
    return wraps_ ? (column + columns_) % columns_ : std::clamp(column, 0, columns_ - 1);
  }
  std::size_t CellOffset(int column, int row) const {
    return (static_cast<std::size_t>(row) * static_cast<std::size_t>(columns_) +
            static_cast<std::size_t>(column)) *
           static_cast<std::size_t>(bins_) * 2;
  }

  int columns_;
  int rows_;
  float x_scale_;
  float y_scale_;
  double sigma_cells_;
  float low_;
  float bins_per_decade_;
  int bins_;
  bool wraps_ = false;
  std::vector<Image<float>> sums_;  // one plane a bin
  std::vector<Image<float>> weights_;
  std::vector<float> cells_;
};

// log10 of a row's luminances within [low, high].
OMNIHDR_SIMD_CLONES void Log10Row(float* values, float low, float high, int count) {
  for (int x = 0; x < count; ++x) {
    const float log10 = kLog10Of2 * FastLog2(values[x]);
    const float raised = log10 > low ? log10 : low;
    values[x] = raised < high ? raised : high;
  }
}

// factor = 10^((gamma − 1)·base + offset), where `known` is positive.
OMNIHDR_SIMD_CLONES void BaseFactors(const float* __restrict known, float slope, float offset,
                                     int count, float* __restrict base) {
  for (int x = 0; x < count; ++x) {
    const float f = FastExp2((slope * base[x] + offset) / kLog10Of2);
    base[x] = known[x] > 0.0F ? f : 0.0F;
  }
}

// Low and high quantile of a regular sample of the known pixels, by the area they stand for.
std::pair<double, double> QuantilesOf(const Image<float>& base, const Image<float>& known,
                                      double low, double high) {
  std::vector<float> sample;
  const int step = std::max(1, base.width() / 512);
  for (int y = step / 2; y < base.height(); y += step) {
    for (int x = step / 2; x < base.width(); x += step) {
      if (known.at(x, y) > 0.0F) sample.push_back(base.at(x, y));
    }
  }
  if (sample.empty()) return {0.0, 0.0};
  const auto quantile = [&sample](double q) {
    const auto nth =
        sample.begin() + static_cast<std::ptrdiff_t>(q * static_cast<double>(sample.size() - 1));
    std::nth_element(sample.begin(), nth, sample.end());
    return static_cast<double>(*nth);
  };
  const double first = quantile(low);
  return {first, quantile(high)};
}

}  // namespace

Image<float> ReinhardLocalFactors(ImageView<const float> radiance, const ToneMapOptions& options,
                                  const LuminanceStatistics& statistics) {
  const int width = radiance.width();
  const int height = radiance.height();
  const auto scale =
      static_cast<float>(options.key * std::exp2(options.exposure_stops) / statistics.log_average);
  const float white = std::max(scale * static_cast<float>(statistics.high), 1.0F);
  const float cap = 1024.0F * white;
  Image<float> luminance(width, height, 1);
  Image<float> known(width, height, 1);
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      LuminanceRow(radiance.row(y), radiance.channels(), width, luminance.row(y));
      Prepare(luminance.row(y), known.row(y), scale, cap, width);
    }
  });

  BlurCascade cascade(luminance, known, options.shape);
  Image<float> centre = cascade.BlurTo(SigmaOfScale(0));
  Image<float> chosen = centre.Clone();
  Image<float> active(width, height, 1, 1.0F);
  for (int i = 0; i < kScales; ++i) {
    Image<float> surround = cascade.BlurTo(SigmaOfScale(i + 1));
    const double s = std::pow(1.6, i);
    // The exposure counts to the key, so that it does not change which scales are chosen.
    const auto floor = static_cast<float>(std::exp2(options.sharpening + options.exposure_stops) *
                                          options.key / (s * s));
    ParallelFor(height, 16, [&](int begin, int end) {
      for (int y = begin; y < end; ++y) {
        Select(centre.row(y), surround.row(y), floor, static_cast<float>(options.threshold), width,
               active.row(y), chosen.row(y));
      }
    });
    centre = std::move(surround);
  }
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      LuminanceRow(radiance.row(y), radiance.channels(), width, luminance.row(y));
      LocalFactors(luminance.row(y), scale, cap, 1.0F / (white * white), width, chosen.row(y));
    }
  });
  return chosen;
}

Image<float> DurandFactors(ImageView<const float> radiance, const ToneMapOptions& options,
                           const LuminanceStatistics& statistics) {
  const int width = radiance.width();
  const int height = radiance.height();
  Image<float> logarithm(width, height, 1);
  Image<float> known(width, height, 1);
  // What lies far outside the bulk of the picture (noise around zero, one hot pixel) is held at
  // these, so that the grid stays small whatever the picture holds.
  constexpr double kMostDecades = 16.0;
  const double high = std::log10(statistics.high) + 3.0;
  const double low = std::max(std::log10(statistics.median) - 6.0, high - kMostDecades);
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      LuminanceRow(radiance.row(y), radiance.channels(), width, logarithm.row(y));
      for (int x = 0; x < width; ++x) known.at(x, y) = logarithm.at(x, y) > 0.0F ? 1.0F : 0.0F;
      Log10Row(logarithm.row(y), static_cast<float>(low), static_cast<float>(high), width);
    }
  });

  const double sigma_space = std::max(options.sigma_space * std::max(width, height), 1.0);
  BilateralGrid grid(width, height, sigma_space, low, high, options.sigma_range);
  for (int y = 0; y < height; ++y) {
    const auto weight = static_cast<float>(options.shape == PictureShape::kSphere
                                               ? std::sin(std::numbers::pi * (y + 0.5) / height)
                                               : 1.0);
    for (int x = 0; x < width; ++x) {
      if (known.at(x, y) > 0.0F) grid.Add(x, y, logarithm.at(x, y), weight);
    }
  }
  grid.Blur(options.shape);
  Image<float> base(width, height, 1);
  ParallelFor(height, 8, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) base.at(x, y) = grid.Slice(x, y, logarithm.at(x, y));
    }
  });

  const auto [base_low, base_high] =
      QuantilesOf(base, known, 1.0 - options.white_percentile, options.white_percentile);
  // A picture of less contrast than the display's is left as it is.
  const double gamma =
      std::min(options.contrast_decades / std::max(base_high - base_low, 1e-3), 1.0);
  const double offset = -gamma * base_high + options.exposure_stops * std::log10(2.0);
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      BaseFactors(known.row(y), static_cast<float>(gamma - 1.0), static_cast<float>(offset), width,
                  base.row(y));
    }
  });
  return base;
}

}  // namespace omnihdr::tonemap
