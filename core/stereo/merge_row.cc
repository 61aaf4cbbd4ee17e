#include "core/stereo/merge_row.h"

#include <Eigen/Core>
#include <algorithm>
#include <cmath>

#include "core/base/parallel_for.h"
#include "core/base/simd.h"

namespace omnihdr {
namespace {

constexpr int kChunk = 64;  // points worked on at a time

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

// Of pixels and those right of them in two rows that are `width` long.
OMNIHDR_SIMD_CLONES
void AroundRow(const std::uint8_t* __restrict upper, const std::uint8_t* __restrict lower,
               int width, std::uint16_t* __restrict out) {
  for (int i = 0; i + 1 < width; ++i) {
    const auto any = static_cast<std::uint8_t>(upper[i] | upper[i + 1] | lower[i] | lower[i + 1]);
    const auto all = static_cast<std::uint8_t>(upper[i] & upper[i + 1] & lower[i] & lower[i + 1]);
    const auto some = static_cast<std::uint16_t>((any ^ all) & (kSaturatedAny | kMasked));
    out[i] = static_cast<std::uint16_t>(any | some << 8);
  }
  const int i = width - 1;
  const auto any = static_cast<std::uint8_t>(upper[i] | upper[0] | lower[i] | lower[0]);
  const auto all = static_cast<std::uint8_t>(upper[i] & upper[0] & lower[i] & lower[0]);
  const auto some = static_cast<std::uint16_t>((any ^ all) & (kSaturatedAny | kMasked));
  out[i] = static_cast<std::uint16_t>(any | some << 8);
}

// Whether a source sees each point, see SightOf.
OMNIHDR_SIMD_CLONES
void FindSights(const float* __restrict nearest, const int* __restrict column,
                const int* __restrict row, const float* __restrict disparity,
                const float* __restrict distance, int count, int grid_width, float tolerance,
                std::uint8_t* __restrict sight) {
  constexpr auto kUnknown = static_cast<int>(Sight::kUnknown);
  constexpr auto kHidden = static_cast<int>(Sight::kHidden);
  constexpr auto kVisible = static_cast<int>(Sight::kVisible);
  for (int i = 0; i < count; ++i) {
    const float expected = disparity[i] / distance[i];
    const float found = nearest[row[i] * grid_width + column[i]];
    int s = found > expected * (1.0F + tolerance) + 0.003F ? kHidden : kVisible;
    s = disparity[i] >= 0.0F ? s : kUnknown;
    s = distance[i] >= 1e-4F ? s : kUnknown;
    sight[i] = static_cast<std::uint8_t>(s);
  }
}

// Radiance to the reference's, and its variance: noise, what a wrong place makes, a constant part.
OMNIHDR_SIMD_CLONES
void ScaleAndVary(const float* __restrict factor, const float* __restrict contrast,
                  const float* __restrict misregistration, int count, float floor,
                  float per_radiance, float relative, float* __restrict radiance,
                  float* __restrict variance) {
  for (int i = 0; i < count; ++i) {
    const float raw = radiance[i] > 0.0F ? radiance[i] : 0.0F;
    const float e = radiance[i] * factor[i];
    const float misplaced = factor[i] * contrast[i] * misregistration[i];
    radiance[i] = e;
    variance[i] = (floor + per_radiance * raw) * factor[i] * factor[i] + misplaced * misplaced +
                  relative * e * e;
  }
}

OMNIHDR_SIMD_CLONES
void StartMean(const float* __restrict radiance, int count, float floor, float per_radiance,
               float* __restrict sum, float* __restrict weight) {
  for (int i = 0; i < count; ++i) {
    const float e = radiance[i] > 0.0F ? radiance[i] : 0.0F;
    const float w = 1.0F / (floor + per_radiance * e);
    weight[i] = w;
    sum[i] = w * radiance[i];
  }
}

OMNIHDR_SIMD_CLONES
void AddDisagreement(const float* __restrict theirs, const float* __restrict variance,
                     const float* __restrict mine, int count, float floor, float per_radiance,
                     float relative_tolerance, float* __restrict chi) {
  for (int i = 0; i < count; ++i) {
    const float gap = theirs[i] - mine[i];
    const float here = floor + per_radiance * (theirs[i] > 0.0F ? theirs[i] : 0.0F);
    const float tolerance = relative_tolerance * mine[i];
    chi[i] += gap * gap / (variance[i] + here + tolerance * tolerance);
  }
}

// Trust by agreement; none in what is not seen or not measured.
OMNIHDR_SIMD_CLONES
void TrustPlain(const float* __restrict chi, const float* __restrict block_trust,
                const std::uint8_t* __restrict flags, const std::uint8_t* __restrict sight,
                int count, float chi_scale, float* __restrict trust) {
  constexpr auto kVisible = static_cast<std::uint8_t>(Sight::kVisible);
  for (int i = 0; i < count; ++i) {
    const float r = chi[i] * chi_scale;
    const int counts = static_cast<int>(sight[i] == kVisible) &
                       static_cast<int>((flags[i] & (kMasked | kMover | kSaturatedAny)) == 0);
    trust[i] = counts != 0 ? block_trust[i] / (1.0F + r * r) : 0.0F;
  }
}

OMNIHDR_SIMD_CLONES
void AddWeighted(const float* __restrict radiance, const float* __restrict variance,
                 const float* __restrict trust, int count, float* __restrict sum,
                 float* __restrict weight, float* __restrict weights) {
  for (int i = 0; i < count; ++i) {
    const float w = trust[i] / variance[i];
    weights[i] = w;
    weight[i] += w;
    // What is not seen may hold anything.
    sum[i] += w > 0.0F ? w * radiance[i] : 0.0F;
  }
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

RowSampler::RowSampler(const Measurement& m)
    : m_(&m),
      is_cylinder_(m.projection.kind() == ProjectionKind::kCylindrical),
      around_(Image<std::uint16_t>::Uninitialized(m.flags.width(), m.flags.height() + 1)),
      contrast_(ContrastOf(m)) {
  const int height = m.flags.height();
  ParallelFor(height + 1, 32, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      AroundRow(m.flags.row(std::max(0, y - 1)), m.flags.row(std::min(height - 1, y)),
                m.flags.width(), around_.row(y));
    }
  });
}

void RowSampler::Sample(const PointRow& points, SampledRow* out) const {
  const std::size_t count = points.x.size();
  for (std::vector<float>& channel : out->radiance) channel.resize(count);
  out->contrast.resize(count);
  out->flags.resize(count);
  const float* pixels = m_->radiance.data();
  const std::uint8_t* flags = m_->flags.data();
  const std::uint16_t* around = around_.data();
  const float* contrast = contrast_.data();
  Taps taps;
  alignas(64) std::array<float, 4 * kChunk> rgba;
  for (std::size_t from = 0; from < count; from += kChunk) {
    const int chunk = static_cast<int>(std::min<std::size_t>(kChunk, count - from));
    FindTaps(points.x.data() + from, points.y.data() + from, chunk, m_->radiance.width(),
             m_->radiance.height(), is_cylinder_, &taps);
    for (std::size_t i = 0; i < static_cast<std::size_t>(chunk); ++i) {
      Eigen::Map<Eigen::Array4f, Eigen::Aligned16> sample(rgba.data() + 4 * i);
      if (taps.inside[i] == 0) {
        sample.setZero();
        out->contrast[from + i] = 0.0F;
        out->flags[from + i] = kMasked;
        continue;
      }
      const auto at = [&](std::ptrdiff_t index) {
        return Eigen::Map<const Eigen::Array4f, Eigen::Aligned16>(pixels + 4 * index);
      };
      const std::ptrdiff_t first = taps.first[i];
      const std::uint16_t found = around[taps.around[i]];
      out->contrast[from + i] = contrast[taps.nearest[i]];
      if (found >> 8U != 0) {
        // The rim of a clipped or masked area: a blend would be neither measured nor a bound.
        const std::ptrdiff_t one = first + (taps.ax[i] < 0.5F ? 0 : taps.right[i]) +
                                   (taps.ay[i] < 0.5F ? 0 : taps.below[i]);
        sample = at(one);
        out->flags[from + i] = flags[one];
        continue;
      }
      const std::ptrdiff_t below = first + taps.below[i];
      const float ax = taps.ax[i];
      const float ay = taps.ay[i];
      sample = (1.0F - ay) * ((1.0F - ax) * at(first) + ax * at(first + taps.right[i])) +
               ay * ((1.0F - ax) * at(below) + ax * at(below + taps.right[i]));
      out->flags[from + i] = static_cast<std::uint8_t>(found);
    }
    TakeApart(rgba.data(), chunk, out->radiance[0].data() + from, out->radiance[1].data() + from,
              out->radiance[2].data() + from);
  }
}

void SampleSource(const SourceLookup& source, const RowSampler& sampler, int y, int width,
                  int block, const float* disparity, float occlusion_tolerance,
                  const MergeErrors& errors, SourceRow* row) {
  const auto count = static_cast<std::size_t>(width);
  const Measurement& m = *source.measurement;
  sampler.Sample(row->seen.image, &row->sampled);
  row->sight.resize(count);
  if (source.nearest.empty()) {
    std::fill(row->sight.begin(), row->sight.end(), Sight::kVisible);
  } else {
    static_assert(sizeof(Sight) == 1);
    FindSights(source.nearest.data(), row->seen.grid_column.data(), row->seen.grid_row.data(),
               disparity, row->seen.distance.data(), width, source.nearest.width(),
               occlusion_tolerance, reinterpret_cast<std::uint8_t*>(row->sight.data()));
  }
  row->trust.resize(count);
  const float* blocks = source.block_trust.row(y / block);
  for (int x = 0; x < width; x += block) {
    std::fill_n(row->trust.begin() + x, std::min(block, width - x), blocks[x / block]);
  }
  row->weight.resize(count);
  std::vector<float>& factor = row->weight;  // until the weights are known
  source.agreement.FactorsOfRow(
      (static_cast<float>(y) + 0.5F) * AgreementField::kHeight / (0.5F * static_cast<float>(width)),
      static_cast<float>(AgreementField::kWidth) / static_cast<float>(width), width, factor.data());
  const float relative = errors.model_error * errors.model_error + source.agreement.excess();
  for (std::size_t c = 0; c < 3; ++c) {
    row->variance[c].resize(count);
    ScaleAndVary(factor.data(), row->sampled.contrast.data(), errors.misregistration, width,
                 m.variance_floor[c], m.variance_per_radiance[c], relative,
                 row->sampled.radiance[c].data(), row->variance[c].data());
  }
}

void PlainRow::Start(const Measurement& own, const SampledRow& mine) {
  for (std::size_t c = 0; c < 3; ++c) {
    sum_[c].resize(mine.size());
    weight_[c].resize(mine.size());
    StartMean(mine.radiance[c].data(), static_cast<int>(mine.size()), own.variance_floor[c],
              own.variance_per_radiance[c], sum_[c].data(), weight_[c].data());
  }
  own_weight_ = weight_[1];
}

void PlainRow::Add(const Measurement& own, const SampledRow& mine, bool consistency,
                   float half_trust_sigmas, float relative_tolerance, SourceRow* source) {
  const auto count = static_cast<int>(mine.size());
  chi_.assign(mine.size(), 0.0F);
  trust_.resize(mine.size());
  for (std::size_t c = 0; c < 3 && consistency; ++c) {
    AddDisagreement(source->sampled.radiance[c].data(), source->variance[c].data(),
                    mine.radiance[c].data(), count, own.variance_floor[c],
                    own.variance_per_radiance[c], relative_tolerance, chi_.data());
  }
  TrustPlain(chi_.data(), source->trust.data(), source->sampled.flags.data(),
             reinterpret_cast<const std::uint8_t*>(source->sight.data()), count,
             1.0F / (3.0F * half_trust_sigmas * half_trust_sigmas), trust_.data());
  for (const std::size_t c : {0U, 2U, 1U}) {  // the weights of green stay
    AddWeighted(source->sampled.radiance[c].data(), source->variance[c].data(), trust_.data(),
                count, sum_[c].data(), weight_[c].data(), source->weight.data());
  }
}

}  // namespace omnihdr
