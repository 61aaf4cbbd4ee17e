#include "core/photometry/tonemap.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <vector>

#include "core/base/fast_math.h"
#include "core/base/parallel_for.h"
#include "core/photometry/tonemap_parts.h"

namespace omnihdr {
namespace tonemap {
namespace {

// Small enough that a block's intermediate values stay in the first-level cache.
constexpr int kBlock = 512;

// Compilers vectorise a stride known at compile time, so three channels have loops of their own.
OMNIHDR_SIMD_CLONES void LuminanceOfRgb(const float* __restrict rgb, int count,
                                        float* __restrict luminance) {
  for (int x = 0; x < count; ++x) {
    luminance[x] = 0.2126F * rgb[3 * x] + 0.7152F * rgb[3 * x + 1] + 0.0722F * rgb[3 * x + 2];
  }
}

OMNIHDR_SIMD_CLONES void Spread(const float* __restrict factor, int count,
                                float* __restrict spread) {
  for (int x = 0; x < count; ++x) {
    spread[3 * x] = factor[x];
    spread[3 * x + 1] = factor[x];
    spread[3 * x + 2] = factor[x];
  }
}

OMNIHDR_SIMD_CLONES void EncodeValues(const float* __restrict values,
                                      const float* __restrict factors, int count,
                                      std::uint8_t* __restrict out) {
  for (int i = 0; i < count; ++i) out[i] = EncodeSrgb(values[i] * factors[i]);
}

// Reinhard eq. 4 over the luminance. `scale` brings the log-average to the key.
OMNIHDR_SIMD_CLONES void ReinhardRow(const float* __restrict luminance, float scale,
                                     float inverse_white_squared, int count,
                                     float* __restrict factor) {
  for (int x = 0; x < count; ++x) {
    const float scaled = scale * luminance[x];
    const float l = scaled < kLargestLuminance ? scaled : kLargestLuminance;
    const float f = scale * (1.0F + l * inverse_white_squared) / (1.0F + l);
    factor[x] = luminance[x] > 0.0F ? f : 0.0F;
  }
}

// Drago eq. 4 with a display maximum of 1: log10(1 + l) / log10(1 + l_max) / log10(2 + 8 (l /
// l_max)^(ln bias / ln ½)) over the luminance.
OMNIHDR_SIMD_CLONES void DragoRow(const float* __restrict luminance, float scale, float l_max,
                                  float exponent, int count, float* __restrict factor) {
  // In log2: log10 a / (log10 b · log10 c) = log2 a · log2 10 / (log2 b · log2 c).
  const float constant =
      std::numbers::ln10_v<float> / std::numbers::ln2_v<float> / FastLog2(1.0F + l_max);
  const float log_max = FastLog2(l_max);
  for (int x = 0; x < count; ++x) {
    const float scaled = scale * luminance[x];
    const float l = scaled < l_max ? scaled : l_max;
    // Below 1/1000 log2(1 + l) would be rounding: its series instead.
    const float numerator = l > 1e-3F ? FastLog2(1.0F + l) : l * (1.44269504F - 0.72134752F * l);
    const float share = FastExp2(exponent * (FastLog2(l) - log_max));
    const float display = constant * numerator / FastLog2(2.0F + 8.0F * share);
    const float f = luminance[x] < kLargestLuminance ? display / luminance[x] : 1.0F;
    factor[x] = luminance[x] > 0.0F ? f : 0.0F;
  }
}

// Log2 luminance in steps of 1/64: 254 octaves of floats.
class LogHistogram {
 public:
  void Add(float log2, double weight) {
    weights_[BinOf(log2)] += weight;
    total_ += weight;
  }
  // The log2 below which the share `quantile` of the weight lies.
  double Quantile(double quantile) const {
    double sum = 0.0;
    for (std::size_t bin = 0; bin < weights_.size(); ++bin) {
      if (sum + weights_[bin] >= quantile * total_ && weights_[bin] > 0.0) {
        const double share = (quantile * total_ - sum) / weights_[bin];
        return kLowest + (static_cast<double>(bin) + std::clamp(share, 0.0, 1.0)) / kPerOctave;
      }
      sum += weights_[bin];
    }
    return 0.0;
  }

 private:
  static constexpr double kLowest = -127.0;
  static constexpr int kPerOctave = 64;
  static std::size_t BinOf(float log2) {
    const auto bin = static_cast<int>((log2 - static_cast<float>(kLowest)) * kPerOctave);
    return static_cast<std::size_t>(std::clamp(bin, 0, 256 * kPerOctave - 1));
  }
  std::vector<double> weights_ = std::vector<double>(256 * kPerOctave, 0.0);
  double total_ = 0.0;
};

OMNIHDR_SIMD_CLONES void Log2Row(const float* __restrict values, int count,
                                 float* __restrict logarithms) {
  for (int i = 0; i < count; ++i) logarithms[i] = FastLog2(values[i]);
}

}  // namespace

void LuminanceRow(const float* pixels, int channels, int count, float* luminance) {
  if (channels == 3) {
    LuminanceOfRgb(pixels, count, luminance);
    return;
  }
  for (int x = 0; x < count; ++x) {
    luminance[x] = Luminance(pixels + static_cast<std::ptrdiff_t>(x) * channels);
  }
}

void EncodeRow(const float* pixels, int channels, const float* factor, int count,
               std::uint8_t* out) {
  std::array<float, 3 * kBlock> spread;
  std::array<float, 3 * kBlock> packed;
  for (int begin = 0; begin < count; begin += kBlock) {
    const int n = std::min(kBlock, count - begin);
    const float* in = pixels + static_cast<std::ptrdiff_t>(begin) * channels;
    if (channels != 3) {
      for (int x = 0; x < n; ++x) {
        std::copy_n(in + static_cast<std::ptrdiff_t>(x) * channels, 3, packed.data() + 3 * x);
      }
      in = packed.data();
    }
    Spread(factor + begin, n, spread.data());
    EncodeValues(in, spread.data(), 3 * n, out + static_cast<std::ptrdiff_t>(begin) * 3);
  }
}

LuminanceStatistics StatisticsOf(ImageView<const float> radiance, const ToneMapOptions& options) {
  constexpr double kSamples = 65536.0;
  const int width = radiance.width();
  const int height = radiance.height();
  const int step =
      std::max(1, static_cast<int>(std::sqrt(static_cast<double>(width) * height / kSamples)));
  std::vector<float> luminance;
  std::vector<float> logarithm;
  LogHistogram histogram;
  double sum = 0.0;
  double weights = 0.0;
  for (int y = step / 2; y < height; y += step) {
    luminance.clear();
    for (int x = step / 2; x < width; x += step) {
      const float l = Luminance(radiance.pixel(x, y));
      if (l > 0.0F && std::isfinite(l)) luminance.push_back(l);
    }
    logarithm.resize(luminance.size());
    Log2Row(luminance.data(), static_cast<int>(luminance.size()), logarithm.data());
    const double weight = options.shape == PictureShape::kSphere
                              ? std::sin(std::numbers::pi * (y + 0.5) / height)
                              : 1.0;
    double row_sum = 0.0;
    for (const float log2 : logarithm) {
      row_sum += static_cast<double>(log2);
      histogram.Add(log2, weight);
    }
    sum += weight * row_sum;
    weights += weight * static_cast<double>(luminance.size());
  }
  LuminanceStatistics statistics;
  if (!(weights > 0.0)) return statistics;
  statistics.any = true;
  statistics.log_average = std::exp2(sum / weights);
  statistics.high = std::exp2(histogram.Quantile(options.white_percentile));
  statistics.median = std::exp2(histogram.Quantile(0.5));
  return statistics;
}

namespace {

// `factors(luminance, count, factor)`: of a piece of a row.
template <typename Factors>
Image<std::uint8_t> MapRows(ImageView<const float> radiance, Factors factors) {
  const int width = radiance.width();
  const int channels = radiance.channels();
  auto out = Image<std::uint8_t>::Uninitialized(width, radiance.height(), 3);
  ParallelFor(radiance.height(), 16, [&](int begin, int end) {
    std::array<float, kBlock> luminance;
    std::array<float, kBlock> factor;
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; x += kBlock) {
        const int n = std::min(kBlock, width - x);
        LuminanceRow(radiance.pixel(x, y), channels, n, luminance.data());
        factors(luminance.data(), n, factor.data());
        EncodeRow(radiance.pixel(x, y), channels, factor.data(), n, out.pixel(x, y));
      }
    }
  });
  return out;
}

Image<std::uint8_t> MapByFactors(ImageView<const float> radiance, const Image<float>& factors) {
  auto out = Image<std::uint8_t>::Uninitialized(radiance.width(), radiance.height(), 3);
  ParallelFor(radiance.height(), 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      EncodeRow(radiance.row(y), radiance.channels(), factors.row(y), radiance.width(), out.row(y));
    }
  });
  return out;
}

Image<std::uint8_t> Reinhard(ImageView<const float> radiance, const ToneMapOptions& options,
                             const LuminanceStatistics& statistics) {
  const double scale = options.key * std::exp2(options.exposure_stops) / statistics.log_average;
  // White never lies below 1, the operator's own asymptote: low contrast is not stretched.
  const double white = std::max(scale * statistics.high, 1.0);
  return MapRows(radiance, [&](const float* luminance, int count, float* factor) {
    ReinhardRow(luminance, static_cast<float>(scale), static_cast<float>(1.0 / (white * white)),
                count, factor);
  });
}

Image<std::uint8_t> Drago(ImageView<const float> radiance, const ToneMapOptions& options,
                          const LuminanceStatistics& statistics) {
  // The paper divides by the log-average, which the key of 0.18 leaves as it is.
  const double scale =
      options.key / 0.18 * std::exp2(options.exposure_stops) / statistics.log_average;
  // One grey alone is its own maximum, and would be white.
  const double l_max = std::max(scale * statistics.high, 10.0);
  const double exponent = std::log(options.bias) / std::log(0.5);
  return MapRows(radiance, [&](const float* luminance, int count, float* factor) {
    DragoRow(luminance, static_cast<float>(scale), static_cast<float>(l_max),
             static_cast<float>(exponent), count, factor);
  });
}

}  // namespace
}  // namespace tonemap

std::string_view ToString(ToneOperator tone_operator) {
  switch (tone_operator) {
    case ToneOperator::kReinhard:
      return "reinhard";
    case ToneOperator::kReinhardLocal:
      return "reinhard-local";
    case ToneOperator::kDrago:
      return "drago";
    case ToneOperator::kDurand:
      return "durand";
  }
  return "?";
}

std::optional<ToneOperator> ToneOperatorFromString(std::string_view name) {
  for (const ToneOperator o : {ToneOperator::kReinhard, ToneOperator::kReinhardLocal,
                               ToneOperator::kDrago, ToneOperator::kDurand}) {
    if (name == ToString(o)) return o;
  }
  return std::nullopt;
}

Status ToneMapOptions::Validate() const {
  struct Range {
    const char* name;
    double value;
    double low;
    double high;
  };
  for (const Range& r :
       {Range{"key", key, 1e-4, 1.0}, Range{"exposure", exposure_stops, -20.0, 20.0},
        Range{"white percentile", white_percentile, 0.5, 1.0},
        Range{"sharpening", sharpening, 0.0, 20.0}, Range{"threshold", threshold, 1e-4, 1.0},
        Range{"bias", bias, 0.5, 1.0}, Range{"contrast", contrast_decades, 0.3, 10.0},
        Range{"sigma space", sigma_space, 0.005, 0.2},
        Range{"sigma range", sigma_range, 0.1, 2.0}}) {
    if (!(r.value >= r.low && r.value <= r.high)) {
      return Fail(ErrorKind::kConfig, "tone mapping: {}: {}, expected {} to {}", r.name, r.value,
                  r.low, r.high);
    }
  }
  return {};
}

Image<std::uint8_t> ToneMap(ImageView<const float> radiance, const ToneMapOptions& options) {
  assert(radiance.empty() || radiance.channels() == 3 || radiance.channels() == 4);
  if (radiance.empty()) return {radiance.width(), radiance.height(), 3};
  const tonemap::LuminanceStatistics statistics = tonemap::StatisticsOf(radiance, options);
  switch (options.tone_operator) {
    case ToneOperator::kReinhard:
      break;
    case ToneOperator::kReinhardLocal:
      return tonemap::MapByFactors(radiance,
                                   tonemap::ReinhardLocalFactors(radiance, options, statistics));
    case ToneOperator::kDrago:
      return tonemap::Drago(radiance, options, statistics);
    case ToneOperator::kDurand:
      return tonemap::MapByFactors(radiance, tonemap::DurandFactors(radiance, options, statistics));
  }
  return tonemap::Reinhard(radiance, options, statistics);
}

Image<std::uint8_t> ToneMapReinhard(ImageView<const float> radiance,
                                    const ToneMapOptions& options) {
  ToneMapOptions reinhard = options;
  reinhard.tone_operator = ToneOperator::kReinhard;
  return ToneMap(radiance, reinhard);
}

}  // namespace omnihdr
