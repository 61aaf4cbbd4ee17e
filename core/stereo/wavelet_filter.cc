#include "core/stereo/wavelet_filter.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/base/simd.h"

namespace omnihdr {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
// Of the cubic B-spline.
constexpr float kMiddle = 6.0F / 16;
constexpr float kInner = 4.0F / 16;
constexpr float kOuter = 1.0F / 16;
// Pixels of a row of which one counts for the noise.
constexpr std::size_t kNoiseStep = 3;

// Sums of known pixels' values, and of their weights, before they are divided.
struct Weighted {
  Image<float> value;
  Image<float> weight;
};

// `in` has 2·spacing values before the first and after the last.
OMNIHDR_SIMD_CLONES
void SmoothRow(const float* __restrict in, int count, int spacing, float* __restrict out) {
  const float* a = in - 2 * spacing;
  const float* b = in - spacing;
  const float* c = in + spacing;
  const float* d = in + 2 * spacing;
  for (int x = 0; x < count; ++x) {
    out[x] = kOuter * (a[x] + d[x]) + kInner * (b[x] + c[x]) + kMiddle * in[x];
  }
}

OMNIHDR_SIMD_CLONES
void KnownRow(const float* __restrict in, int count, float* __restrict value,
              float* __restrict weight) {
  for (int x = 0; x < count; ++x) {
    const bool known = in[x] >= 0.0F;  // not when NaN
    value[x] = known ? in[x] : 0.0F;
    weight[x] = known ? 1.0F : 0.0F;
  }
}

// Rows two, one, none, one and two spacings away; `in` decides what is known.
OMNIHDR_SIMD_CLONES
void SmoothColumns(const std::array<const float*, 5>& value,
                   const std::array<const float*, 5>& weight, const float* __restrict in, int count,
                   float* __restrict out) {
  for (int x = 0; x < count; ++x) {
    const float sum = kOuter * (value[0][x] + value[4][x]) + kInner * (value[1][x] + value[3][x]) +
                      kMiddle * value[2][x];
    const float share = kOuter * (weight[0][x] + weight[4][x]) +
                        kInner * (weight[1][x] + weight[3][x]) + kMiddle * weight[2][x];
    out[x] = in[x] >= 0.0F ? sum / share : kNan;
  }
}

// The columns of a row again on either side, so that it has no ends.
void CloseRow(int width, int room, float* row) {
  for (int x = 1; x <= room; ++x) {
    row[-x] = row[((-x % width) + width) % width];
    row[width - 1 + x] = row[(x - 1) % width];
  }
}

// The next scale's approximation. Rows beyond a pole do not exist: their share of the weight is
// missing, as that of unknown pixels.
Image<float> Coarser(const Image<float>& last, int spacing) {
  const int width = last.width();
  const int height = last.height();
  Weighted rows = {Image<float>::Uninitialized(width, height),
                   Image<float>::Uninitialized(width, height)};
  const int room = 2 * spacing;
  ParallelFor(height, 16, [&](int begin, int end) {
    Image<float> closed(width + 2 * room, 2);
    float* value = closed.row(0) + room;
    float* weight = closed.row(1) + room;
    for (int y = begin; y < end; ++y) {
      KnownRow(last.row(y), width, value, weight);
      CloseRow(width, room, value);
      CloseRow(width, room, weight);
      SmoothRow(value, width, spacing, rows.value.row(y));
      SmoothRow(weight, width, spacing, rows.weight.row(y));
    }
  });
  const Image<float> beyond(width, 1);
  Image<float> next = Image<float>::Uninitialized(width, height);
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      std::array<const float*, 5> value{};
      std::array<const float*, 5> weight{};
      for (int t = 0; t < 5; ++t) {
        const int from = y + (t - 2) * spacing;
        const bool exists = from >= 0 && from < height;
        const auto k = static_cast<std::size_t>(t);
        value[k] = exists ? rows.value.row(from) : beyond.row(0);
        weight[k] = exists ? rows.weight.row(from) : beyond.row(0);
      }
      SmoothColumns(value, weight, last.row(y), width, next.row(y));
    }
  });
  return next;
}

// The approximations of the map at scales 0 (itself) to `scales`; NaN where the map is unknown.
std::vector<Image<float>> Approximations(const Image<float>& map, int scales) {
  std::vector<Image<float>> out;
  out.push_back(map.Clone());
  for (int scale = 0; scale < scales; ++scale) out.push_back(Coarser(out.back(), 1 << scale));
  return out;
}

OMNIHDR_SIMD_CLONES
void LesserRow(const float* __restrict a, const float* __restrict b, int count,
               float* __restrict out) {
  for (int x = 0; x < count; ++x) out[x] = b[x] < a[x] ? b[x] : a[x];
}

OMNIHDR_SIMD_CLONES
void LesserInto(const float* __restrict a, int count, float* __restrict out) {
  for (int x = 0; x < count; ++x) out[x] = a[x] < out[x] ? a[x] : out[x];
}

OMNIHDR_SIMD_CLONES
void NoneForUnknown(const float* __restrict in, int count, float none, float* __restrict out) {
  for (int x = 0; x < count; ++x) out[x] = in[x] < none ? in[x] : none;
}

// Least value within `reach` pixels each side; NaN counts as none. Windows of 1, 2, 4 ... pixels
// are put together from two of half the length, the last one from two that overlap.
Image<float> LeastAround(const Image<float>& in, int reach) {
  const int width = in.width();
  const int height = in.height();
  constexpr float kNone = std::numeric_limits<float>::max();
  const int window = 2 * reach + 1;
  Image<float> rows = Image<float>::Uninitialized(width, height);
  ParallelFor(height, 8, [&](int begin, int end) {
    const int padded = width + 2 * reach;
    Image<float> closed(padded, 2);
    for (int y = begin; y < end; ++y) {
      float* now = closed.row(0);
      float* next = closed.row(1);
      NoneForUnknown(in.row(y), width, kNone, now + reach);
      CloseRow(width, reach, now + reach);
      int length = 1;  // now[x]: least of the `length` values from x on
      int valid = padded;
      while (2 * length <= window) {
        valid -= length;
        LesserRow(now, now + length, valid, next);
        std::swap(now, next);
        length *= 2;
      }
      LesserRow(now, now + (window - length), width, rows.row(y));
    }
  });
  Image<float> out = Image<float>::Uninitialized(width, height);
  ParallelFor(height, 32, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      const int first = std::max(0, y - reach);
      const int last = std::min(height - 1, y + reach);
      std::copy_n(rows.row(first), width, out.row(y));
      for (int t = first + 1; t <= last; ++t) {
        LesserInto(rows.row(t), width, out.row(y));
      }
    }
  });
  return out;
}

// Standard deviation of noise among a scale's details, from their median magnitude.
float NoiseOf(const Image<float>& finer, const Image<float>& coarser, const Image<float>& map) {
  std::vector<float> magnitudes;
  magnitudes.reserve(map.size() / kNoiseStep + 1);
  for (std::size_t k = 0; k < map.size(); k += kNoiseStep) {
    if (!(map.values()[k] >= 0.0F)) continue;
    magnitudes.push_back(std::abs(finer.values()[k] - coarser.values()[k]));
  }
  if (magnitudes.empty()) return 0.0F;
  const auto middle = magnitudes.begin() + static_cast<std::ptrdiff_t>(magnitudes.size() / 2);
  std::nth_element(magnitudes.begin(), middle, magnitudes.end());
  return 1.4826F * *middle;
}

// Takes the details of a scale that are smaller than `threshold` away. NaN stays.
OMNIHDR_SIMD_CLONES
void TakeDetails(const float* __restrict finer, const float* __restrict coarser, int count,
                 float threshold, float* __restrict out) {
  for (int x = 0; x < count; ++x) {
    const float detail = finer[x] - coarser[x];
    out[x] -= std::abs(detail) < threshold ? detail : 0.0F;
  }
}

}  // namespace

void FilterWavelet(const WaveletOptions& options, DisparityMap* map) {
  assert(options.scales >= 1 && options.scales <= 5);
  Image<float>& disparity = map->disparity;
  {
    const Image<float> coarse = std::move(Approximations(disparity, options.scales).back());
    const Image<float> floor = LeastAround(coarse, 2 << options.scales);
    for (std::size_t k = 0; k < disparity.size(); ++k) {
      float& d = disparity.values()[k];
      if (!(d >= 0.0F)) continue;
      const float least = floor.values()[k];
      const float near = std::max(static_cast<float>(options.tolerance),
                                  static_cast<float>(options.relative_tolerance) * least);
      if (d >= least - near) continue;
      d = kNan;
      map->confidence.values()[k] = 0.0F;
    }
  }
  const std::vector<Image<float>> scale = Approximations(disparity, options.scales);
  std::vector<float> threshold;
  for (std::size_t s = 0; s + 1 < scale.size(); ++s) {
    threshold.push_back(static_cast<float>(options.noise_sigmas) *
                        NoiseOf(scale[s], scale[s + 1], disparity));
  }
  ParallelFor(disparity.height(), 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (std::size_t s = 0; s < threshold.size(); ++s) {
        TakeDetails(scale[s].row(y), scale[s + 1].row(y), disparity.width(), threshold[s],
                    disparity.row(y));
      }
      for (int x = 0; x < disparity.width(); ++x) {
        float& d = disparity.at(x, y);
        d = d < 0.0F ? 0.0F : d;
      }
    }
  });
}

}  // namespace omnihdr
