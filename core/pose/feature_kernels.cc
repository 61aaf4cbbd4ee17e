#include "core/pose/feature_kernels.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <vector>

#include "core/base/parallel_for.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/pose/feature_kernels.cc"
#include <hwy/foreach_target.h>
//
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace omnihdr {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

// One row: `rows` are the 2·radius+1 source rows round it, `padded` is scratch of width + 2·radius.
void BlurRow(const float* const* rows, const float* kernel, int radius, int width, float* padded,
             float* to, float* difference) {
  const hn::ScalableTag<float> d;
  const int lanes = static_cast<int>(hn::Lanes(d));
  float* middle = padded + radius;
  int x = 0;
  for (; x + lanes <= width; x += lanes) {
    auto sum = hn::Mul(hn::Set(d, kernel[0]), hn::LoadU(d, rows[radius] + x));
    for (int k = 1; k <= radius; ++k) {
      sum = hn::MulAdd(
          hn::Set(d, kernel[k]),
          hn::Add(hn::LoadU(d, rows[radius - k] + x), hn::LoadU(d, rows[radius + k] + x)), sum);
    }
    hn::StoreU(sum, d, middle + x);
  }
  for (; x < width; ++x) {
    float sum = kernel[0] * rows[radius][x];
    for (int k = 1; k <= radius; ++k)
      sum += kernel[k] * (rows[radius - k][x] + rows[radius + k][x]);
    middle[x] = sum;
  }
  for (int k = 0; k < radius; ++k) {
    padded[k] = middle[width - radius + k];
    middle[width + k] = middle[k];
  }
  x = 0;
  for (; x + lanes <= width; x += lanes) {
    auto sum = hn::Mul(hn::Set(d, kernel[0]), hn::LoadU(d, middle + x));
    for (int k = 1; k <= radius; ++k) {
      sum = hn::MulAdd(hn::Set(d, kernel[k]),
                       hn::Add(hn::LoadU(d, middle + x - k), hn::LoadU(d, middle + x + k)), sum);
    }
    hn::StoreU(sum, d, to + x);
    if (difference != nullptr) {
      hn::StoreU(hn::Sub(sum, hn::LoadU(d, rows[radius] + x)), d, difference + x);
    }
  }
  for (; x < width; ++x) {
    float sum = kernel[0] * middle[x];
    for (int k = 1; k <= radius; ++k) sum += kernel[k] * (middle[x - k] + middle[x + k]);
    to[x] = sum;
    if (difference != nullptr) difference[x] = sum - rows[radius][x];
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace omnihdr
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace omnihdr {
namespace {

HWY_EXPORT(BlurRow);

}  // namespace

void BlurPanorama(const Image<float>& from, double sigma, Image<float>* to,
                  Image<float>* difference) {
  const int width = from.width();
  const int height = from.height();
  const int radius = std::min(std::max(1, static_cast<int>(std::ceil(3.5 * sigma))), width);
  std::vector<float> kernel(static_cast<std::size_t>(radius) + 1);
  double total = 0.0;
  for (int k = 0; k <= radius; ++k) {
    const double g = std::exp(-0.5 * k * k / (sigma * sigma));
    kernel[static_cast<std::size_t>(k)] = static_cast<float>(g);
    total += k == 0 ? g : 2.0 * g;
  }
  for (float& k : kernel) k = static_cast<float>(k / total);

  ParallelFor(height, 16, [&](int begin, int end) {
    std::vector<float> padded(static_cast<std::size_t>(width + 2 * radius));
    std::vector<const float*> rows(static_cast<std::size_t>(2 * radius) + 1);
    for (int y = begin; y < end; ++y) {
      for (int k = -radius; k <= radius; ++k) {
        rows[static_cast<std::size_t>(k + radius)] = from.row(std::clamp(y + k, 0, height - 1));
      }
      HWY_DYNAMIC_DISPATCH(BlurRow)
      (rows.data(), kernel.data(), radius, width, padded.data(), to->row(y),
       difference == nullptr ? nullptr : difference->row(y));
    }
  });
}

}  // namespace omnihdr
#endif
