#include "core/photometry/row_sampler.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "core/base/parallel_for.h"
#include "core/base/simd.h"

namespace omnihdr {
namespace {

constexpr int kChunk = 64;  // points worked on at a time
// Of a blend, to count as clipped: points on a pixel are off it by rounding.
constexpr float kLeastClipped = 1.0F / 256.0F;

// Where the four pixels around each point lie, in pixels from the first one.
struct Taps {
  alignas(64) std::array<std::int32_t, kChunk> first;
  alignas(64) std::array<std::int32_t, kChunk> right;  // from there
  alignas(64) std::array<std::int32_t, kChunk> below;
  alignas(64) std::array<std::int32_t, kChunk> around;
  alignas(64) std::array<std::int32_t, kChunk> nearest;
  alignas(64) std::array<std::int32_t, kChunk> inside;
  alignas(64) std::array<float, kChunk> ax;
  alignas(64) std::array<float, kChunk> ay;
};

OMNIHDR_ALWAYS_INLINE int Clamp(int value, int last) {
  const int most = value < last ? value : last;
  return most > 0 ? most : 0;
}

OMNIHDR_SIMD_CLONES
void FindTaps(const float* __restrict x, const float* __restrict y, int count, int width,
              int height, bool ends, Taps* __restrict taps) {
  const auto bottom = static_cast<float>(height);
  const float least_y = ends ? 0.0F : -1e9F;
  const float most_y = ends ? bottom : 1e9F;
  for (int k = 0; k < count; ++k) {
    const auto i = static_cast<std::size_t>(k);
    const int inside = static_cast<int>(y[k] >= least_y) & static_cast<int>(y[k] <= most_y);
    const float py = inside != 0 ? y[k] : 0.0F;
    const float fx = x[k] - 0.5F;
    const float fy = py - 0.5F;
    const float floor_x = std::floor(fx);
    const float floor_y = std::floor(fy);
    taps->ax[i] = fx - floor_x;
    taps->ay[i] = fy - floor_y;
    int x0 = static_cast<int>(floor_x);
    x0 = x0 < 0 ? x0 + width : x0;
    x0 = x0 >= width ? x0 - width : x0;
    const int y_floor = static_cast<int>(floor_y);
    const int y0 = Clamp(y_floor, height - 1);
    const int y1 = Clamp(y_floor + 1, height - 1);
    taps->first[i] = y0 * width + x0;
    taps->right[i] = x0 + 1 == width ? 1 - width : 1;
    taps->below[i] = (y1 - y0) * width;
    taps->around[i] = Clamp(y_floor + 1, height) * width + x0;
    taps->nearest[i] =
        Clamp(static_cast<int>(py), height - 1) * width + Clamp(static_cast<int>(x[k]), width - 1);
    taps->inside[i] = inside;
  }
}

OMNIHDR_SIMD_CLONES
void TakeApart(const float* __restrict rgba, int count, float* __restrict r, float* __restrict g,
               float* __restrict b) {
  for (int i = 0; i < count; ++i) {
    r[i] = rgba[4 * i];
    g[i] = rgba[4 * i + 1];
    b[i] = rgba[4 * i + 2];
  }
}

OMNIHDR_SIMD_CLONES
void LuminanceRow(const float* __restrict rgba, int count, float* __restrict out) {
  for (int i = 0; i < count; ++i) {
    out[i] = 0.2126F * rgba[4 * i] + 0.7152F * rgba[4 * i + 1] + 0.0722F * rgba[4 * i + 2];
  }
}

// `middle` has a value before the first and after the last.
OMNIHDR_SIMD_CLONES
void ContrastRow(const float* __restrict above, const float* __restrict middle,
                 const float* __restrict below, int count, float* __restrict out) {
  for (int i = 0; i < count; ++i) {
    const float gx = middle[i + 1] - middle[i - 1];
    const float gy = below[i] - above[i];
    out[i] = 0.5F * std::sqrt(gx * gx + gy * gy);
  }
}

// Flags of a blend of pixels of which any has `any` and all have `all`, and in the upper byte which
// bits only some have of those for which the nearest pixel is taken.
OMNIHDR_ALWAYS_INLINE std::uint16_t FlagsOfBlend(std::uint8_t any, std::uint8_t all,
                                                 std::uint8_t take_nearest) {
  const auto some = static_cast<std::uint8_t>(any ^ all);
  // What is partly clipped is dark only where all of it is.
  const auto dark = static_cast<std::uint8_t>((some & kSaturatedAny) != 0 ? all : any);
  const auto flags = static_cast<std::uint8_t>((any & ~kDarkAny) | (dark & kDarkAny));
  return static_cast<std::uint16_t>(flags | (some & take_nearest) << 8);
}

// Of pixels and those right of them in two rows that are `width` long.
OMNIHDR_SIMD_CLONES
void AroundRow(const std::uint8_t* __restrict upper, const std::uint8_t* __restrict lower,
               int width, std::uint8_t take_nearest, std::uint16_t* __restrict out) {
  for (int i = 0; i + 1 < width; ++i) {
    const auto any = static_cast<std::uint8_t>(upper[i] | upper[i + 1] | lower[i] | lower[i + 1]);
    const auto all = static_cast<std::uint8_t>(upper[i] & upper[i + 1] & lower[i] & lower[i + 1]);
    out[i] = FlagsOfBlend(any, all, take_nearest);
  }
  const int i = width - 1;
  const auto any = static_cast<std::uint8_t>(upper[i] | upper[0] | lower[i] | lower[0]);
  const auto all = static_cast<std::uint8_t>(upper[i] & upper[0] & lower[i] & lower[0]);
  out[i] = FlagsOfBlend(any, all, take_nearest);
}

}  // namespace

Image<float> ContrastOf(const Measurement& m) {
  const int width = m.radiance.width();
  const int height = m.radiance.height();
  Image<float> contrast = Image<float>::Uninitialized(width, height);
  ParallelFor(height, 32, [&](int begin, int end) {
    const int first = std::max(0, begin - 1);
    const int last = std::min(height, end + 1);
    Image<float> luminance = Image<float>::Uninitialized(width + 2, last - first);
    for (int y = first; y < last; ++y) {
      float* row = luminance.row(y - first);
      LuminanceRow(m.radiance.row(y), width, row + 1);
      row[0] = row[width];
      row[width + 1] = row[1];
    }
    for (int y = begin; y < end; ++y) {
      ContrastRow(luminance.row(std::max(0, y - 1) - first) + 1, luminance.row(y - first) + 1,
                  luminance.row(std::min(height - 1, y + 1) - first) + 1, width, contrast.row(y));
    }
  });
  return contrast;
}

RowSampler::RowSampler(const Measurement& m, Contrast contrast, Rim rim)
    : m_(&m),
      rim_(rim),
      is_cylinder_(m.projection.kind() == ProjectionKind::kCylindrical),
      around_(Image<std::uint16_t>::Uninitialized(m.flags.width(), m.flags.height() + 1)),
      contrast_(contrast == Contrast::kSampled ? ContrastOf(m) : Image<float>()) {
  const int height = m.flags.height();
  const std::uint8_t take_nearest = rim == Rim::kBound ? kMasked : kSaturatedAny | kMasked;
  ParallelFor(height + 1, 32, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      AroundRow(m.flags.row(std::max(0, y - 1)), m.flags.row(std::min(height - 1, y)),
                m.flags.width(), take_nearest, around_.row(y));
    }
  });
}

void RowSampler::Sample(const float* x, const float* y, std::size_t count, SampledRow* out) const {
  for (std::vector<float>& channel : out->radiance) channel.resize(count);
  const bool has_contrast = !contrast_.empty();
  out->contrast.resize(has_contrast ? count : 0);
  out->flags.resize(count);
  const bool bounds = rim_ == Rim::kBound;
  out->clipped.assign(bounds ? count : 0, 0.0F);
  const float* pixels = m_->radiance.data();
  const std::uint8_t* flags = m_->flags.data();
  const std::uint16_t* around = around_.data();
  const float* contrast = contrast_.data();
  Taps taps;
  alignas(64) std::array<float, 4 * kChunk> rgba;
  for (std::size_t from = 0; from < count; from += kChunk) {
    const int chunk = static_cast<int>(std::min<std::size_t>(kChunk, count - from));
    FindTaps(x + from, y + from, chunk, m_->radiance.width(), m_->radiance.height(), is_cylinder_,
             &taps);
    // Points lie along a curve through many rows: what is waited for is memory.
    for (std::size_t i = 0; i < static_cast<std::size_t>(chunk); ++i) {
      const std::ptrdiff_t first = taps.first[i];
      __builtin_prefetch(around + taps.around[i]);
      if (has_contrast) __builtin_prefetch(contrast + taps.nearest[i]);
      __builtin_prefetch(pixels + 4 * first);
      __builtin_prefetch(pixels + 4 * (first + taps.below[i]));
    }
    for (std::size_t i = 0; i < static_cast<std::size_t>(chunk); ++i) {
      Eigen::Map<Eigen::Array4f, Eigen::Aligned16> sample(rgba.data() + 4 * i);
      if (taps.inside[i] == 0) {
        sample.setZero();
        if (has_contrast) out->contrast[from + i] = 0.0F;
        out->flags[from + i] = kMasked;
        continue;
      }
      const auto at = [&](std::ptrdiff_t index) {
        return Eigen::Map<const Eigen::Array4f, Eigen::Aligned16>(pixels + 4 * index);
      };
      const std::ptrdiff_t first = taps.first[i];
      const std::ptrdiff_t nearest =
          first + (taps.ax[i] < 0.5F ? 0 : taps.right[i]) + (taps.ay[i] < 0.5F ? 0 : taps.below[i]);
      const std::uint16_t found = around[taps.around[i]];
      if (has_contrast) out->contrast[from + i] = contrast[taps.nearest[i]];
      if (found >> 8U != 0) {
        // The rim of a masked area has nothing to blend with. That of a clipped one has no value:
        // a blend is a bound at best.
        sample = at(nearest);
        out->flags[from + i] = flags[nearest];
        if (bounds && (flags[nearest] & kSaturatedAny) != 0) out->clipped[from + i] = 1.0F;
        continue;
      }
      const std::ptrdiff_t below = first + taps.below[i];
      const float ax = taps.ax[i];
      const float ay = taps.ay[i];
      sample = (1.0F - ay) * ((1.0F - ax) * at(first) + ax * at(first + taps.right[i])) +
               ay * ((1.0F - ax) * at(below) + ax * at(below + taps.right[i]));
      out->flags[from + i] = static_cast<std::uint8_t>(found);
      if (!bounds || (found & kSaturatedAny) == 0) continue;
      const auto clipped = [&](std::ptrdiff_t index) {
        return (flags[index] & kSaturatedAny) != 0 ? 1.0F : 0.0F;
      };
      const float share =
          (1.0F - ay) * ((1.0F - ax) * clipped(first) + ax * clipped(first + taps.right[i])) +
          ay * ((1.0F - ax) * clipped(below) + ax * clipped(below + taps.right[i]));
      out->clipped[from + i] = share;
      if (share < kLeastClipped) {
        out->clipped[from + i] = 0.0F;
        out->flags[from + i] = flags[nearest];
      }
    }
    TakeApart(rgba.data(), chunk, out->radiance[0].data() + from, out->radiance[1].data() + from,
              out->radiance[2].data() + from);
  }
}

}  // namespace omnihdr
