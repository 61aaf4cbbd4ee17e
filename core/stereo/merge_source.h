#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <limits>
#include <memory>
#include <optional>

#include "core/image/image.h"
#include "core/photometry/measurement.h"
#include "core/photometry/sampler.h"
#include "core/photometry/tonemap.h"
#include "core/sphere/latlong_grid.h"
#include "core/stereo/agreement_field.h"
#include "core/stereo/row_geometry.h"
#include "core/stereo/sgm.h"
#include "core/stereo/view_merge.h"

namespace omnihdr {

// The parts of a merge (view_merge.h) that look at one view: where it sees a surface point and what
// it says of it. Values to be read from any thread once they are made.

// Everything needed to look a surface point up in one other view.
struct SourceLookup {
  const Measurement* measurement = nullptr;
  std::unique_ptr<PanoramaSampler> sampler;
  Eigen::Matrix3f camera_from_world = Eigen::Matrix3f::Identity();
  Eigen::Vector3f offset = Eigen::Vector3f::Zero();  // its centre from the reference's, world frame
  Image<float> nearest;  // nearest surface in each of its directions, world-aligned; NaN unknown
  Image<float> behind;   // its own map as seen from the reference; empty = not asked for
  AgreementField agreement;
  // reference / source where both are well exposed; nothing when too little is shared.
  std::optional<float> exposure_ratio;
  // How far the source is trusted in each block of output pixels, 0..1: a mean over a block shows a
  // wrong registration that the noise of a single dark pixel hides.
  Image<float> block_trust;
  // The same for pixels that are clipped in the reference. What it measured beside them is mostly
  // edges, whose means a slight misregistration moves.
  Image<float> clipped_trust;
};

enum class Sight : std::uint8_t { kUnknown, kHidden, kVisible };

// Whether a source sees the surface point of the row's i-th ray, at disparity `d`, or something
// nearer hides it there. kUnknown: the point has no place in the source.
inline Sight SightOf(const SourceLookup& source, const SeenRow& seen, std::size_t i, float d,
                     float occlusion_tolerance) {
  if (source.nearest.empty()) return Sight::kVisible;
  if (!(d >= 0.0F) || seen.distance[i] < 1e-4F) return Sight::kUnknown;
  const float expected = d / seen.distance[i];
  const float nearest = source.nearest.at(seen.grid_column[i], seen.grid_row[i]);
  const bool is_hidden = nearest > expected * (1.0F + occlusion_tolerance) + 0.003F;
  return is_hidden ? Sight::kHidden : Sight::kVisible;
}

// The nearest surface seen from a source in each direction: the reference's map warped there, and
// the source's own map where it has one.
Image<float> NearestSurface(const DisparityMap& reference, const MergeSource& source,
                            const Eigen::Vector3f& offset);

inline constexpr std::array<std::uint8_t, 3> kSaturatedBit = {kSaturatedR, kSaturatedG,
                                                              kSaturatedB};

// What a view says of a surface point.
struct MergeSample {
  std::array<float, 3> radiance{};
  std::array<float, 3> variance{};
  std::array<float, 3> hat{};  // weights in place of the inverse variance, when asked for
  std::uint8_t flags = kMasked;
  bool usable = false;  // no channel saturated, not masked
  bool hidden = false;  // behind something nearer, if the disparity maps are right
  float trust = 1.0F;
  // The part of the variance that neither noise nor registration makes, relative to the radiance's
  // square.
  float relative = 0.0F;
};

inline constexpr std::size_t kMaxMergeViews = 8;
using MergeSamples = std::array<MergeSample, kMaxMergeViews>;

// What a measurement says at a point, by itself.
inline MergeSample MakeMergeSample(const Measurement& m, const RadianceSample& raw) {
  MergeSample s;
  s.radiance = raw.rgb;
  s.flags = raw.flags;
  s.usable = (raw.flags & (kMasked | kSaturatedAny)) == 0;
  for (std::size_t c = 0; c < 3; ++c) {
    const float e = std::max(raw.rgb[c], 0.0F);
    s.variance[c] = m.variance_floor[c] + m.variance_per_radiance[c] * e;
  }
  return s;
}

// Whether two samples may show the same surface: as far apart as noise and registration explain, or
// nearly equal. What `a` has saturated only says "at least".
inline constexpr float kNearlyEqual = 0.3F;  // relative
inline bool MayShowTheSame(const MergeSample& a, const MergeSample& b,
                           float nearly_equal = kNearlyEqual) {
  constexpr float kSigmasSquared = 6.25F;
  for (std::size_t c = 0; c < 3; ++c) {
    float gap = b.radiance[c] - a.radiance[c];
    if ((a.flags & kSaturatedBit[c]) != 0) gap = std::min(gap, 0.0F);
    const float ea = a.radiance[c];
    const float eb = b.radiance[c];
    const float noise = a.variance[c] - a.relative * ea * ea + b.variance[c] - b.relative * eb * eb;
    const float nearly = nearly_equal * std::min(ea, eb);
    if (gap * gap > kSigmasSquared * std::max(noise, 0.0F) + nearly * nearly) return false;
  }
  return true;
}

// Whether a sample's noise leaves room to contradict another: a dark one agrees with everything.
inline bool IsTelling(const MergeSample& s) {
  constexpr float kMostNoise = 0.24F;  // relative standard deviation
  const float e = s.radiance[1];
  const float noise = s.variance[1] - s.relative * e * e;
  return s.usable && e > 0.0F && noise < kMostNoise * kMostNoise * e * e;
}

// The other views' samples (from 1 on) that may show the same as the one most of them side with.
struct MergeMajority {
  std::size_t winner = 0;  // 0: no usable sample at all
  int views = 0;
  int telling = 0;  // of those
  std::array<bool, kMaxMergeViews> member{};
};
// Takes usable samples that are not hidden; each counts once, plus by its trust. The order of the
// views does not matter.
inline MergeMajority FindMajority(const MergeSamples& samples, std::size_t count) {
  MergeMajority majority;
  float most = 0.0F;
  for (std::size_t k = 1; k < count; ++k) {
    const MergeSample& s = samples[k];
    if (!s.usable || s.hidden) continue;
    std::array<bool, kMaxMergeViews> member{};
    float votes = s.trust;
    int views = 0;
    int telling = 0;
    for (std::size_t j = 1; j < count; ++j) {
      if (!samples[j].usable || samples[j].hidden) continue;
      member[j] = j == k || MayShowTheSame(s, samples[j]);
      votes += member[j] ? 1.0F : 0.0F;
      views += member[j] ? 1 : 0;
      telling += member[j] && IsTelling(samples[j]) ? 1 : 0;
    }
    const bool is_better =
        votes > most || (votes == most && s.variance[1] < samples[majority.winner].variance[1]);
    if (majority.winner != 0 && !is_better) continue;
    majority = {k, views, telling, member};
    most = votes;
  }
  return majority;
}

inline constexpr float kLeastTrust = 0.2F;  // of a sample that has a say

// Where the own view says little: whether the others that have a say are so far apart that it takes
// a majority. `least`, `most`: their radiances of green.
inline bool IsContested(int voters, float least, float most) {
  constexpr float kConflict = 1.4F;  // brightest over darkest
  return voters >= 3 && most > kConflict * std::max(least, 0.0F);
}

// Whether a clipped sample is as bright as a clipped pixel demands, and so may show the same.
inline bool MeetsBound(const MergeSample& sample, const MergeSample& mine) {
  constexpr float kTolerance = 0.8F;
  if ((sample.flags & kSaturatedAny) == 0) return false;
  for (std::size_t c = 0; c < 3; ++c) {
    if ((mine.flags & kSaturatedBit[c]) != 0 &&
        sample.radiance[c] < kTolerance * mine.radiance[c]) {
      return false;
    }
  }
  return true;
}

// Contrast of a sample's neighbourhood, as relative luminance change per pixel.
inline float LocalContrast(const Measurement& m, float x, float y) {
  const int width = m.radiance.width();
  const int height = m.radiance.height();
  const int xi = std::clamp(static_cast<int>(x), 0, width - 1);
  const int yi = std::clamp(static_cast<int>(y), 0, height - 1);
  const int xl = xi == 0 ? width - 1 : xi - 1;
  const int xr = xi + 1 == width ? 0 : xi + 1;
  const int yu = std::max(0, yi - 1);
  const int yd = std::min(height - 1, yi + 1);
  const float gx = Luminance(m.radiance.pixel(xr, yi)) - Luminance(m.radiance.pixel(xl, yi));
  const float gy = Luminance(m.radiance.pixel(xi, yd)) - Luminance(m.radiance.pixel(xi, yu));
  return 0.5F * std::sqrt(gx * gx + gy * gy);
}

}  // namespace omnihdr
