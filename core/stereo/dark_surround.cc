#include "core/stereo/dark_surround.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/base/simd.h"

namespace omnihdr {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();
constexpr float kSide = 3.0F;                // of the squares, in pixels
constexpr float kSigmas = 3.0F;              // of a mean
constexpr float kTolerance = 0.1F;           // relative: gloss, vignetting
constexpr float kLeastRelativeNoise = 0.2F;  // of a pixel that is dark

// Sums of three pixels down, `rows` of W×H×4 each; NaN where one is not measured.
OMNIHDR_SIMD_CLONES
void SumDown(const std::array<const float*, 3>& rows,
             const std::array<const std::uint8_t*, 3>& flags, int width, float* __restrict sum) {
  constexpr int kUnmeasured = kMasked | kMover | kSaturatedAny;
  for (int x = 0; x < width; ++x) {
    const float green = rows[0][4 * x + 1] + rows[1][4 * x + 1] + rows[2][4 * x + 1];
    const int wrong = (flags[0][x] | flags[1][x] | flags[2][x]) & kUnmeasured;
    sum[x] = wrong == 0 ? green : kNan;
  }
}

OMNIHDR_SIMD_CLONES
void MeanAcross(const float* __restrict sum, int width, float* __restrict mean) {
  constexpr float kShare = 1.0F / (kSide * kSide);
  for (int x = 1; x < width - 1; ++x) mean[x] = kShare * (sum[x - 1] + sum[x] + sum[x + 1]);
  mean[0] = kShare * (sum[width - 1] + sum[0] + sum[1]);
  mean[width - 1] = kShare * (sum[width - 2] + sum[width - 1] + sum[0]);
}

}  // namespace

DarkSurround::DarkSurround(const Measurement& own)
    : own_(own), mean_(own.radiance.width(), own.radiance.height(), 1, kNan) {
  const int width = mean_.width();
  const int height = mean_.height();
  if (width < 3 || height < 3) return;
  ParallelFor(height - 2, 16, [&](int begin, int end) {
    std::vector<float> sum(static_cast<std::size_t>(width));
    for (int y = begin + 1; y < end + 1; ++y) {
      SumDown({own_.radiance.row(y - 1), own_.radiance.row(y), own_.radiance.row(y + 1)},
              {own_.flags.row(y - 1), own_.flags.row(y), own_.flags.row(y + 1)}, width, sum.data());
      MeanAcross(sum.data(), width, mean_.row(y));
    }
  });
}

float DarkSurround::Variance(float radiance) const {
  return own_.variance_floor[1] + own_.variance_per_radiance[1] * std::max(radiance, 0.0F);
}

void DarkSurround::LimitsOfRow(const PointRow& points, std::vector<float>* least,
                               std::vector<float>* most) const {
  least->assign(points.x.size(), -kInfinity);
  most->assign(points.x.size(), kInfinity);
  const int width = mean_.width();
  const int height = mean_.height();
  for (std::size_t i = 0; i < points.x.size(); ++i) {
    const int x = std::clamp(static_cast<int>(points.x[i]), 0, width - 1);
    const int y = std::clamp(static_cast<int>(points.y[i]), 0, height - 1);
    const float mean = mean_.at(x, y);
    const float dark = kLeastRelativeNoise * mean;
    if (std::isnan(mean) || Variance(mean) < dark * dark) continue;  // the outermost rows are NaN
    bool is_known = true;
    float low = mean;
    float high = mean;
    for (int dy = -1; dy <= 1; ++dy) {
      const float* row = mean_.row(y + dy);
      for (int dx = -1; dx <= 1; ++dx) {
        const int column = x + dx < 0 ? width - 1 : (x + dx == width ? 0 : x + dx);
        low = std::min(low, row[column]);
        high = std::max(high, row[column]);
        is_known = is_known && !std::isnan(row[column]);
      }
    }
    if (!is_known) continue;
    constexpr float kSigmasOfPixel = kSigmas / kSide;
    (*least)[i] = (1.0F - kTolerance) * (low - kSigmasOfPixel * std::sqrt(Variance(low)));
    (*most)[i] = (1.0F + kTolerance) * (high + kSigmasOfPixel * std::sqrt(Variance(high)));
  }
}

}  // namespace omnihdr
