#include "core/stereo/view_merge.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <memory>
#include <numbers>
#include <optional>
#include <utility>

#include <fmt/format.h>

#include "core/base/parallel_for.h"
#include "core/photometry/clipped.h"
#include "core/photometry/sampler.h"
#include "core/photometry/tonemap.h"
#include "core/sphere/latlong_grid.h"
#include "core/stereo/agreement_field.h"
#include "core/stereo/confidence.h"
#include "core/stereo/dark_surround.h"
#include "core/stereo/fuse.h"
#include "core/stereo/merge_row.h"
#include "core/stereo/merge_source.h"
#include "core/stereo/mover_region.h"
#include "core/stereo/row_geometry.h"

namespace omnihdr {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kSureConfidence = 0.7F;
constexpr float kLeastNoiseFloors = 4.0F;  // a source darker than this has no ratio worth averaging
constexpr float kLargestRatio = 6.0F;      // two samples farther apart do not show the same surface
constexpr float kLeastBlockSamples = 4.0F;         // of sixteen
constexpr float kLeastClippedBlockSamples = 8.0F;  // fewer beside clipped ones are an edge, no mean
constexpr float kLeastShare = 0.1F;                // of the weight, to be told as a source
constexpr int kLeastWitnesses = 2;  // views that must agree on what is behind a mover
constexpr float kHalfTrustSigmas =
    3.0F;  // disagreement in standard deviations that halves the trust

constexpr int kBlock = 8;  // output pixels

constexpr float kGuess = 0.5F;  // confidence in infinity where there is no map

// Expected error of a place, in pixels.
float Misregistration(const MergeOptions& options, float confidence) {
  return options.misalignment_px + (1.0F - confidence) * options.distrusted_px;
}

// Of the pixels of a block that both views measured.
struct BlockSums {
  float mine = 0.0F;
  float theirs = 0.0F;
  float noise = 0.0F;
  float count = 0.0F;
  float misregistration = 0.0F;  // pixels
  // Along x and y: of places, from the block's middle, their squares, and places times `theirs`.
  std::array<float, 2> place{};
  std::array<float, 2> place_squared{};
  std::array<float, 2> theirs_by_place{};

  void AddPlace(std::size_t axis, float at, float theirs_here) {
    place[axis] += at;
    place_squared[axis] += at * at;
    theirs_by_place[axis] += at * theirs_here;
  }
  // The square of how `theirs`, on average, changes from a pixel to the next: by so much a block's
  // mean is off when it was looked up a pixel away.
  float SlopeSquared() const {
    float sum = 0.0F;
    for (std::size_t axis = 0; axis < 2; ++axis) {
      const float spread = place_squared[axis] - place[axis] * place[axis] / count;
      if (!(spread > 0.5F * count)) continue;  // all in a line across
      const float slope = (theirs_by_place[axis] - place[axis] * theirs / count) / spread;
      sum += slope * slope;
    }
    return sum;
  }
};

// Whether a surface's radiance is within the good part of both views' ranges. The longer, cleaner
// exposure decides: a noisy value that chose itself would bias the ratio.
class WellExposed {
 public:
  WellExposed(const Measurement& mine, const Measurement& theirs)
      : by_mine_(mine.longest_exposure_s >= theirs.longest_exposure_s),
        low_(kLow * std::max(mine.saturation[1], theirs.saturation[1])),
        high_(kHigh * std::min(mine.saturation[1], theirs.saturation[1])) {}
  bool operator()(float mine_y, float theirs_y) const {
    const float y = Cleaner(mine_y, theirs_y);
    return y >= low_ && y <= high_;
  }
  // Whether the reference is the cleaner one.
  bool by_mine() const { return by_mine_; }
  float Cleaner(float mine_y, float theirs_y) const { return by_mine_ ? mine_y : theirs_y; }

 private:
  static constexpr float kLow = 0.06F;  // of the radiance that saturates
  static constexpr float kHigh = 0.8F;
  bool by_mine_;
  float low_;
  float high_;
};

constexpr float kLeastHat = 1e-3F;
constexpr float kDarkWeight = 1e-6F;  // counts only where there is nothing else

// Thesis eq. 2.5 of each channel's value, as its share of the one that saturates.
void SetHatWeights(const Measurement& m, const std::array<float, 3>& raw, MergeSample* s) {
  for (std::size_t c = 0; c < 3; ++c) {
    const float value = raw[c] / m.saturation[c];
    const bool is_dark = (s->flags & kDarkAny) != 0;
    s->hat[c] = is_dark ? kDarkWeight : std::max(std::min(value, 1.0F - value), kLeastHat);
  }
}

// Where the own view says little - it is clipped, or dark - what a single other view saw passing by
// would count as much as what all others saw: only those stay that most of them side with.
void DropMinority(std::size_t count, MergeSamples* samples) {
  float least = std::numeric_limits<float>::infinity();
  float most = 0.0F;
  int voters = 0;
  for (std::size_t k = 1; k < count; ++k) {
    const MergeSample& s = (*samples)[k];
    if (!s.usable || s.hidden || s.trust <= kLeastTrust) continue;
    ++voters;
    least = std::min(least, s.radiance[1]);
    most = std::max(most, s.radiance[1]);
  }
  if (!IsContested(voters, least, most)) return;
  const MergeMajority majority = FindMajority(*samples, count);
  if (2 * majority.views <= voters) return;
  for (std::size_t k = 1; k < count; ++k) {
    MergeSample& s = (*samples)[k];
    if (s.usable && !s.hidden && !majority.member[k]) s.trust = 0.0F;
  }
}

// Puts what is behind a mover in the own view's place: of the others, which are those that show it,
// the ones that side with each other. `is_sure`: the own view does show a mover; else, at its edge,
// two others have to agree, and the own view stays where it shows the same. False: none of them
// says enough.
bool TakeBackground(bool is_sure, std::size_t count, MergeSamples* samples) {
  MergeSample& mine = (*samples)[0];
  const MergeMajority majority = FindMajority(*samples, count);
  if (!is_sure && majority.views > 0 && majority.telling < kLeastWitnesses) return false;
  if (majority.views == 0) {
    // A background that is clipped in every view that saw it has a bound at least.
    const bool is_bounded =
        std::any_of(samples->begin() + 1, samples->begin() + static_cast<std::ptrdiff_t>(count),
                    [](const MergeSample& s) { return (s.flags & kSaturatedAny) != 0; });
    if (!is_bounded || (!is_sure && (mine.flags & kSaturatedAny) != 0)) return false;
    mine.flags = kMasked;
    mine.usable = false;
    return true;
  }
  if (!is_sure && MayShowTheSame(mine, (*samples)[majority.winner])) return true;
  mine.flags = kMasked;
  mine.usable = false;
  for (std::size_t k = 1; k < count; ++k) {
    (*samples)[k].trust = majority.member[k] ? 1.0F : 0.0F;
  }
  return true;
}

std::optional<float> Median(std::vector<float> values) {
  constexpr std::size_t kLeast = 1000;
  if (values.size() < kLeast) return {};
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

// A pixel of the output.
struct MergedPixel {
  std::array<float, 3> radiance{};
  PixelOrigin origin = PixelOrigin::kNoData;
  std::uint8_t sources = 0;
};

// The mean of a pixel's samples, the reference's first; `view_bit`: of MergedView::sources, each
// sample's.
MergedPixel MergePixel(std::size_t count, const std::array<std::uint8_t, kMaxMergeViews>& view_bit,
                       float confidence, bool by_hat, bool consistency, MergeSamples* in) {
  MergeSamples& samples = *in;
  const MergeSample& mine = samples[0];
  MergedPixel result;
  bool dark = true;
  float most_trusted = 0.0F;
  float most_trusted_hidden = 0.0F;
  for (std::size_t k = 0; k < count; ++k) {
    if (!samples[k].usable) continue;
    float& most = samples[k].hidden ? most_trusted_hidden : most_trusted;
    most = std::max(most, samples[k].trust);
  }
  // A single wrong disparity "hides" a surface in every other view at once. Where none sees
  // the point but what lies there is as bright as the clipped own pixel demands, that is a
  // better estimate than the bare bound.
  const bool take_hidden = most_trusted <= kLeastTrust && most_trusted_hidden > kLeastTrust;
  if (take_hidden) most_trusted = most_trusted_hidden;
  for (std::size_t k = 0; k < count; ++k) {
    if (samples[k].hidden && !take_hidden) samples[k].usable = false;
  }
  // Where this view is saturated and all that others offer contradicts that, they see
  // something else.
  if (most_trusted > kLeastTrust) {
    // A common estimate of the signal first, so that noise does not bias the weights.
    std::array<float, 3> signal{};
    std::array<float, 3> signal_weight{};
    std::array<float, kMaxMergeViews> share{};
    for (std::size_t k = 0; k < count; ++k) {
      const MergeSample& s = samples[k];
      if (!s.usable) continue;
      for (std::size_t c = 0; c < 3; ++c) {
        const float w = by_hat ? s.trust * s.hat[c] : s.trust / s.variance[c];
        signal[c] += w * s.radiance[c];
        signal_weight[c] += w;
        if (c == 1) share[k] = w;
      }
      dark = dark && (s.flags & kDarkAny) == kDarkAny;
    }
    for (std::size_t c = 0; c < 3; ++c) {
      result.radiance[c] = signal[c] / signal_weight[c];
      if (consistency && (mine.flags & kSaturatedBit[c]) != 0) {
        result.radiance[c] = std::max(result.radiance[c], mine.radiance[c]);
      }
    }
    for (std::size_t k = 0; k < count; ++k) {
      if (share[k] >= kLeastShare * signal_weight[1]) result.sources |= view_bit[k];
    }
    result.origin = dark ? PixelOrigin::kDark : PixelOrigin::kMeasured;
  } else {
    // Saturated wherever it was seen: each says "at least"; the largest bound says most.
    // Clipped areas have no texture, so that wrong disparities "hide" their pixels here and
    // there: a view's bound counts in spite of that unless the disparity is sure.
    bool is_bounded = false;
    std::uint8_t clipped = kSaturatedAny;
    for (std::size_t k = 0; k < count; ++k) {
      if ((samples[k].flags & kMasked) != 0) continue;
      if (samples[k].hidden && (confidence >= kSureConfidence || !MeetsBound(samples[k], mine))) {
        continue;
      }
      if (samples[k].usable && k > 0) continue;
      if (k > 0 && (mine.flags & kMasked) == 0 && samples[k].trust <= kLeastTrust) continue;
      is_bounded = true;
      clipped = static_cast<std::uint8_t>(clipped & samples[k].flags);
      if (samples[k].radiance[1] > result.radiance[1]) result.sources = view_bit[k];
      for (std::size_t c = 0; c < 3; ++c)
        result.radiance[c] = std::max(result.radiance[c], samples[k].radiance[c]);
    }
    NeutraliseClipped(clipped, result.radiance.data());
    result.origin = is_bounded ? PixelOrigin::kClipped : PixelOrigin::kNoData;
  }
  return result;
}

// On the rim of a clipped area the reference did measure a part of a pixel: of the rest alone, the
// share `clipped`, do the others say how bright it is. Edges of lamps and windows are sharper than
// registration is good, and what the others hold may be of either side.
void FillClippedPart(const MergeSample& mine, float clipped, const std::array<float, 3>& saturation,
                     MergedPixel* pixel) {
  for (std::size_t c = 0; c < 3; ++c) {
    const float others = pixel->radiance[c];
    pixel->radiance[c] = (mine.flags & kSaturatedBit[c]) != 0
                             ? mine.radiance[c] + clipped * std::max(others - saturation[c], 0.0F)
                             : (1.0F - clipped) * mine.radiance[c] + clipped * others;
  }
  if (1.0F - clipped >= kLeastShare) pixel->sources |= 1U;
}

constexpr float kLeastExposureChange = 0.03F;  // less is light, gloss and vignetting
constexpr std::size_t kLeastExposureViews = 2;

ExposureTest TestExposure(const std::vector<SourceLookup>& sources, float limit) {
  ExposureTest test;
  std::vector<float> ratios;
  for (const SourceLookup& source : sources) {
    if (source.exposure_ratio) ratios.push_back(*source.exposure_ratio);
  }
  test.views = static_cast<int>(ratios.size());
  if (ratios.size() < kLeastExposureViews) return test;
  ratios.push_back(1.0F);
  std::sort(ratios.begin(), ratios.end());
  const std::size_t middle = ratios.size() / 2;
  test.measured = ratios.size() % 2 == 1
                      ? ratios[middle]
                      : (std::abs(ratios[middle] - 1.0F) < std::abs(ratios[middle - 1] - 1.0F)
                             ? ratios[middle]
                             : ratios[middle - 1]);
  const float change = std::abs(std::log(test.measured));
  if (change > std::log1p(kLeastExposureChange) && change <= std::log1p(limit)) {
    test.scale = test.measured;
  }
  return test;
}

}  // namespace

std::string DescribeExposureTest(const ExposureTest& test, const MergeOptions& options) {
  const float change = std::abs(std::log(test.measured));
  const float percent = 100.0F * (test.measured - 1.0F);
  if (test.scale != 1.0F) {
    return fmt::format("exposure: {:+.1f} % against the {} views around: radiance corrected",
                       percent, test.views);
  }
  if (change > std::log1p(options.refine_limit)) {
    return fmt::format(
        "exposure: {:+.1f} % against the {} views around, beyond the limit of {:.0f} %: kept as "
        "labelled",
        percent, test.views, 100.0F * options.refine_limit);
  }
  return {};
}

MergedView MergeViews(const MergeSource& reference, const DisparityMap* map,
                      const std::vector<MergeSource>& others,
                      const Eigen::Quaterniond& world_from_output, int width,
                      const MergeOptions& options) {
  const int height = width / 2;
  const LatLongGrid output(width, height);
  const Eigen::Matrix3f world_from_output_matrix =
      world_from_output.toRotationMatrix().cast<float>();
  const Measurement& own = *reference.measurement;
  const PanoramaSampler own_sampler(own);
  const Eigen::Matrix3f own_from_world =
      reference.world_from_camera.rotation.conjugate().toRotationMatrix().cast<float>();

  const bool removes = options.movers == MergeMovers::kRemove && map != nullptr;
  std::vector<SourceLookup> sources(std::min(others.size(), kMaxMergeViews - 1));
  ParallelFor(static_cast<int>(sources.size()), 1, [&](int begin, int end) {
    for (int n = begin; n < end; ++n) {
      const MergeSource& other = others[static_cast<std::size_t>(n)];
      SourceLookup& s = sources[static_cast<std::size_t>(n)];
      s.measurement = other.measurement;
      s.sampler = std::make_unique<PanoramaSampler>(*other.measurement);
      s.camera_from_world =
          other.world_from_camera.rotation.conjugate().toRotationMatrix().cast<float>();
      s.offset = (other.world_from_camera.translation - reference.world_from_camera.translation)
                     .cast<float>();
      if (map == nullptr) continue;
      s.nearest = NearestSurface(*map, other, s.offset);
      if (removes && other.matched != nullptr) {
        s.behind = WarpDisparity(*other.matched, -s.offset);
      }
    }
  });
  const LatLongGrid map_grid(map != nullptr ? map->disparity.width() : 2,
                             map != nullptr ? map->disparity.height() : 1);

  const float occlusion_tolerance =
      options.occlusion ? options.occlusion_tolerance : std::numeric_limits<float>::infinity();
  const float relative_tolerance =
      options.consistency_log10 * std::numbers::ln10_v<float> / kHalfTrustSigmas;

  MergedView view;
  view.radiance = Image<float>(width, height, 3);
  view.disparity = Image<float>(width, height, 1, kNan);
  view.confidence = Image<float>(width, height);
  view.origin = Image<std::uint8_t>(width, height);
  view.sources = Image<std::uint8_t>(width, height);

  const bool by_hat = options.weights == MergeWeights::kHat;

  const float cells_per_pixel_x =
      static_cast<float>(AgreementField::kWidth) / static_cast<float>(width);
  const float cells_per_pixel_y =
      static_cast<float>(AgreementField::kHeight) / static_cast<float>(height);
  const RowSampler own_rows(
      own, RowSampler::Contrast::kNone,
      options.consistency ? RowSampler::Rim::kBound : RowSampler::Rim::kNearest);
  std::vector<RowSampler> source_rows;
  source_rows.reserve(sources.size());
  for (const SourceLookup& source : sources) {
    source_rows.emplace_back(*source.measurement, RowSampler::Contrast::kSampled);
  }
  // What the reference says of every second pixel of every second row, once for all sources.
  constexpr int kStep = 2;
  const int sampled_width = (width - kStep / 2 + kStep - 1) / kStep;
  const int sampled_height = (height - kStep / 2 + kStep - 1) / kStep;
  Image<float> own_luminance(sampled_width, sampled_height);  // 0 where it counts for nothing
  Image<float> own_disparity(sampled_width, sampled_height);
  Image<float> own_confidence(sampled_width, sampled_height);
  ParallelFor(sampled_height, 16, [&](int begin, int end) {
    RayRow rays;
    PointRow points;
    SampledRow sampled;
    for (int row = begin; row < end; ++row) {
      RaysOfRow(output, row * kStep + kStep / 2, kStep / 2, kStep, world_from_output_matrix, &rays);
      PointsInView(rays, own_from_world, own_sampler, &points);
      own_rows.Sample(points.x.data(), points.y.data(), rays.size(), &sampled);
      for (std::size_t i = 0; i < rays.size(); ++i) {
        const RadianceSample mine = SampleOf(sampled, i);
        const bool counts = (mine.flags & (kMasked | kMover | kSaturatedAny)) == 0;
        own_luminance.at(static_cast<int>(i), row) = counts ? Luminance(mine.rgb.data()) : 0.0F;
      }
      if (map == nullptr) continue;
      PointsOnGrid(rays, map_grid, &points);
      LookUpDisparity(*map, points, own_disparity.row(row), own_confidence.row(row));
    }
  });

  ParallelFor(static_cast<int>(sources.size()), 1, [&](int begin, int end) {
    RayRow rays;
    SeenRow seen;
    SampledRow sampled;
    std::vector<float> known_disparity(static_cast<std::size_t>(sampled_width));
    for (int n = begin; n < end; ++n) {
      SourceLookup& source = sources[static_cast<std::size_t>(n)];
      std::vector<AgreementField::Residual> residuals;
      std::vector<float> exposure_ratios;
      const WellExposed well_exposed(own, *source.measurement);
      const auto ratio_of = well_exposed.by_mine() ? AgreementField::Ratio::kSourceToReference
                                                   : AgreementField::Ratio::kReferenceToSource;
      const int blocks_x = (width + kBlock - 1) / kBlock;
      const int blocks_y = (height + kBlock - 1) / kBlock;
      std::vector<BlockSums> blocks(static_cast<std::size_t>(blocks_x) *
                                    static_cast<std::size_t>(blocks_y));
      for (int row = 0; row < sampled_height; ++row) {
        const int y = row * kStep + kStep / 2;
        RaysOfRow(output, y, kStep / 2, kStep, world_from_output_matrix, &rays);
        const float* disparities = own_disparity.row(row);
        std::transform(disparities, disparities + sampled_width, known_disparity.begin(),
                       [](float d) { return d >= 0.0F ? d : 0.0F; });
        SurfacePointsInView(rays, known_disparity, source.offset, source.camera_from_world,
                            *source.sampler, map_grid, &seen);
        source_rows[static_cast<std::size_t>(n)].Sample(seen.image.x.data(), seen.image.y.data(),
                                                        rays.size(), &sampled);
        for (std::size_t i = 0; i < rays.size(); ++i) {
          const int x = static_cast<int>(i) * kStep + kStep / 2;
          const float mine_y = own_luminance.at(static_cast<int>(i), row);
          if (!(mine_y > 0.0F)) continue;
          if (SightOf(source, seen, i, disparities[i], occlusion_tolerance) != Sight::kVisible) {
            continue;
          }
          const RadianceSample theirs = SampleOf(sampled, i);
          if ((theirs.flags & (kMasked | kMover | kSaturatedAny)) != 0) continue;
          const float theirs_y = Luminance(theirs.rgb.data());
          if (!(theirs_y > 0.0F)) continue;
          BlockSums& block = blocks[static_cast<std::size_t>((y / kBlock) * blocks_x + x / kBlock)];
          const auto variance = [](const Measurement& m, float e) {
            return m.variance_floor[1] + m.variance_per_radiance[1] * e;
          };
          const float signal = well_exposed.Cleaner(mine_y, theirs_y);
          const float noise = variance(own, signal) + variance(*source.measurement, signal);
          block.mine += mine_y;
          block.theirs += theirs_y;
          block.noise += noise;
          block.count += 1.0F;
          block.misregistration += Misregistration(
              options, map == nullptr ? kGuess : own_confidence.at(static_cast<int>(i), row));
          constexpr float kMiddle = 0.5F * (kBlock - 1);
          block.AddPlace(0, static_cast<float>(x % kBlock) - kMiddle, theirs_y);
          block.AddPlace(1, static_cast<float>(y % kBlock) - kMiddle, theirs_y);
          if (map != nullptr && own_confidence.at(static_cast<int>(i), row) < kTrustedScore)
            continue;
          if (signal < kLeastNoiseFloors * source.measurement->noise_floor) continue;
          const float ratio = mine_y / theirs_y;
          if (ratio < 1.0F / kLargestRatio || ratio > kLargestRatio) continue;
          if (well_exposed(mine_y, theirs_y)) exposure_ratios.push_back(ratio);
          const float contrast = sampled.contrast[i] * options.misalignment_px;
          const int cell = static_cast<int>((static_cast<float>(y) + 0.5F) * cells_per_pixel_y) *
                               AgreementField::kWidth +
                           static_cast<int>((static_cast<float>(x) + 0.5F) * cells_per_pixel_x);
          residuals.push_back({cell, well_exposed.by_mine() ? 1.0F / ratio : ratio,
                               (noise + contrast * contrast) / (signal * signal)});
        }
      }
      if (!options.consistency) residuals.clear();  // a field of ones
      source.agreement.Fit(residuals, ratio_of);
      source.exposure_ratio = Median(std::move(exposure_ratios));
      source.block_trust = Image<float>(blocks_x, blocks_y, 1, 1.0F);
      source.clipped_trust = Image<float>(blocks_x, blocks_y, 1, 1.0F);
      if (!options.consistency) continue;
      for (int by = 0; by < blocks_y; ++by) {
        for (int bx = 0; bx < blocks_x; ++bx) {
          const BlockSums& b =
              blocks[static_cast<std::size_t>(by) * static_cast<std::size_t>(blocks_x) +
                     static_cast<std::size_t>(bx)];
          if (b.count < kLeastBlockSamples) continue;
          const float factor =
              source.agreement.Factor((static_cast<float>(bx) + 0.5F) * kBlock * cells_per_pixel_x,
                                      (static_cast<float>(by) + 0.5F) * kBlock * cells_per_pixel_y);
          const float gap = b.mine - factor * b.theirs;
          const float tolerance = options.block_error * std::max(b.mine, factor * b.theirs);
          const float variance = b.noise + tolerance * tolerance;
          const auto trust = [gap](float v) {
            const float r = gap * gap / (9.0F * v);
            return 1.0F / (1.0F + r * r);
          };
          source.block_trust.at(bx, by) = trust(variance);
          if (b.count < kLeastClippedBlockSamples) continue;
          const float misplaced = factor * b.misregistration;
          source.clipped_trust.at(bx, by) =
              trust(variance + misplaced * misplaced * b.SlopeSquared());
        }
      }
    }
  });

  MoverRegion movers;
  if (removes) {
    movers = FindMovers(
        {.own = own,
         .own_from_world = own_from_world,
         .map = *map,
         .sources = sources,
         .grid = LatLongGrid(std::max(2, width / kMoverStep), std::max(1, height / kMoverStep)),
         .world_from_grid = world_from_output_matrix,
         .misalignment_px = options.misalignment_px});
  }

  std::optional<DarkSurround> surround;
  if (options.consistency) surround.emplace(own);

  if (options.refine_exposure) view.exposure = TestExposure(sources, options.refine_limit);
  ParallelFor(height, 8, [&](int begin, int end) {
    MergeSamples samples;
    std::array<std::uint8_t, kMaxMergeViews> view_bit{};  // of each sample
    RayRow rays;
    PointRow own_points;
    PointRow map_points;
    SampledRow mine_row;
    std::array<SourceRow, kMaxMergeViews> rows;
    PlainRow plain;
    std::vector<float> least;
    std::vector<float> most;
    std::vector<float> misregistration(static_cast<std::size_t>(width));
    std::vector<float> known_disparity(static_cast<std::size_t>(width), 0.0F);
    for (int y = begin; y < end; ++y) {
      RaysOfRow(output, y, 0, 1, world_from_output_matrix, &rays);
      PointsInView(rays, own_from_world, own_sampler, &own_points);
      if (map != nullptr) {
        PointsOnGrid(rays, map_grid, &map_points);
        float* disparities = view.disparity.row(y);
        LookUpDisparity(*map, map_points, disparities, view.confidence.row(y));
        for (int x = 0; x < width && !movers.inside.empty(); ++x) {
          if (movers.Has(x / kMoverStep, y / kMoverStep)) {
            disparities[x] = movers.disparity.at(x / kMoverStep, y / kMoverStep);
          }
        }
        for (std::size_t i = 0; i < known_disparity.size(); ++i) {
          known_disparity[i] = disparities[i] >= 0.0F ? disparities[i] : 0.0F;
        }
      }
      for (std::size_t n = 0; n < sources.size(); ++n) {
        SurfacePointsInView(rays, known_disparity, sources[n].offset, sources[n].camera_from_world,
                            *sources[n].sampler, map_grid, &rows[n].seen);
      }
      own_rows.Sample(own_points.x.data(), own_points.y.data(), own_points.x.size(), &mine_row);
      const float* confidences = view.confidence.row(y);
      const float* disparities = view.disparity.row(y);
      for (std::size_t i = 0; i < misregistration.size(); ++i) {
        misregistration[i] = Misregistration(options, map == nullptr ? kGuess : confidences[i]);
      }
      if (surround) surround->LimitsOfRow(own_points, &least, &most);
      plain.Start(own, mine_row);
      for (std::size_t n = 0; n < sources.size(); ++n) {
        SampleSource(sources[n], source_rows[n], y, width, kBlock, disparities, occlusion_tolerance,
                     {misregistration.data(), options.model_error}, &rows[n]);
        if (surround) DistrustOutside(least, most, &rows[n]);
        plain.Add(own, mine_row, options.consistency, kHalfTrustSigmas, relative_tolerance,
                  &rows[n]);
      }
      for (int x = 0; x < width; ++x) {
        const auto i = static_cast<std::size_t>(x);
        const bool by_mover = movers.Has(x / kMoverStep, y / kMoverStep);
        float* out = view.radiance.pixel(x, y);
        const bool is_dark = mine_row.flags[i] != 0;  // of plain pixels
        const bool is_plain = !is_dark || ((mine_row.flags[i] & ~kDarkAny) == 0 &&
                                           options.consistency && plain.IsAgreedDark(i));
        if (is_plain && !by_mover && !by_hat) {
          const float least_weight = kLeastShare * plain.weight()[i];
          unsigned contributed = plain.own_weight()[i] >= least_weight ? 1U : 0U;
          for (std::size_t n = 0; n < sources.size(); ++n) {
            contributed |= rows[n].weight[i] >= least_weight ? 2U << n : 0U;
          }
          for (std::size_t c = 0; c < 3; ++c) out[c] = plain.Mean(i, c);
          view.sources.at(x, y) = static_cast<std::uint8_t>(contributed);
          view.origin.at(x, y) = static_cast<std::uint8_t>(
              is_dark && plain.IsDarkEverywhere(i) ? PixelOrigin::kDark : PixelOrigin::kMeasured);
          continue;
        }
        const RadianceSample own_raw = SampleOf(mine_row, i);
        samples[0] = MakeMergeSample(own, own_raw);
        if (by_hat) SetHatWeights(own, own_raw.rgb, &samples[0]);
        MergeSample& mine = samples[0];
        view_bit[0] = 1;
        const bool is_marked = (mine.flags & kMover) != 0;
        const bool own_is_clipped =
            (mine.flags & kMasked) == 0 && (mine.flags & kSaturatedAny) != 0;
        std::size_t count = 1;
        // Where this view saw nothing, its disparity is a guess unless others agreed on it: better
        // no data than other views' pixels strewn about.
        const bool is_guess =
            (mine.flags & kMasked) != 0 && map != nullptr && confidences[i] < kTrustedScore;
        const bool asks_others = !is_guess && (!is_marked || by_mover);
        for (std::size_t n = 0; n < sources.size() && asks_others; ++n) {
          const SourceLookup& source = sources[n];
          const SourceRow& row = rows[n];
          if (by_mover && !movers.ShowsBackground(x / kMoverStep, y / kMoverStep, n)) continue;
          // Beside a mover the map tells of the mover.
          const Sight sight = by_mover ? Sight::kVisible : row.sight[i];
          // What a disparity map calls hidden is asked only where this view itself does not know.
          if (sight == Sight::kUnknown || (sight == Sight::kHidden && !own_is_clipped)) continue;
          const RadianceSample scaled = SampleOf(row.sampled, i);
          if ((scaled.flags & (kMasked | kMover)) != 0) continue;
          MergeSample& s = samples[count];
          s = MergeSample{};
          s.radiance = scaled.rgb;
          s.flags = scaled.flags;
          s.usable = (scaled.flags & kSaturatedAny) == 0;
          s.hidden = sight == Sight::kHidden;
          s.trust = own_is_clipped ? source.clipped_trust.at(x / kBlock, y / kBlock) : row.trust[i];
          s.relative = options.model_error * options.model_error + source.agreement.excess();
          for (std::size_t c = 0; c < 3; ++c) s.variance[c] = row.variance[c][i];
          if (by_hat) {
            const float factor =
                source.agreement.Factor((static_cast<float>(x) + 0.5F) * cells_per_pixel_x,
                                        (static_cast<float>(y) + 0.5F) * cells_per_pixel_y);
            std::array<float, 3> raw = scaled.rgb;
            for (float& value : raw) value /= factor;
            SetHatWeights(*source.measurement, raw, &s);
          }
          view_bit[count++] = static_cast<std::uint8_t>(2U << n);
        }
        if (by_mover && !TakeBackground(is_marked || movers.IsCore(x / kMoverStep, y / kMoverStep),
                                        count, &samples))
          count = 1;

        // How well each other sample agrees with what this view itself saw, as an interval per
        // channel.
        if (options.consistency && (mine.flags & kMasked) == 0) {
          for (std::size_t k = 1; k < count; ++k) {
            MergeSample& s = samples[k];
            if (!s.usable) continue;
            float chi = 0.0F;
            for (std::size_t c = 0; c < 3; ++c) {
              float gap = s.radiance[c] - mine.radiance[c];
              if ((mine.flags & kSaturatedBit[c]) != 0) gap = std::min(gap, 0.0F);
              // Noise of what the other view claims, had this view measured it.
              const float here = own.variance_floor[c] +
                                 own.variance_per_radiance[c] * std::max(s.radiance[c], 0.0F);
              const float tolerance = relative_tolerance * mine.radiance[c];
              chi += gap * gap / (s.variance[c] + here + tolerance * tolerance);
            }
            const float r = chi / (3.0F * kHalfTrustSigmas * kHalfTrustSigmas);
            s.trust *= 1.0F / (1.0F + r * r);
          }
          if ((mine.flags & (kSaturatedAny | kDarkAny)) != 0) DropMinority(count, &samples);
        }

        MergedPixel pixel =
            MergePixel(count, view_bit, confidences[i], by_hat, options.consistency, &samples);
        if (options.consistency && mine_row.clipped[i] > 0.0F && mine_row.clipped[i] < 1.0F &&
            (mine.flags & kMasked) == 0) {
          FillClippedPart(mine, mine_row.clipped[i], own.saturation, &pixel);
        }
        std::copy(pixel.radiance.begin(), pixel.radiance.end(), out);
        view.sources.at(x, y) = pixel.sources;
        view.origin.at(x, y) = static_cast<std::uint8_t>(pixel.origin);
      }
      if (view.exposure.scale != 1.0F) {
        float* row = view.radiance.row(y);
        for (int k = 0; k < 3 * width; ++k) row[k] /= view.exposure.scale;
      }
    }
  });
  return view;
}

}  // namespace omnihdr
