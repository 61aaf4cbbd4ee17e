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
#include "core/stereo/fuse.h"
#include "core/stereo/row_geometry.h"

namespace omnihdr {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr std::size_t kMaxSources = 8;
constexpr float kTrustedConfidence = 0.4F;
constexpr float kSureConfidence = 0.7F;
constexpr float kLeastNoiseFloors = 4.0F;  // a source darker than this has no ratio worth averaging
constexpr float kLargestRatio = 6.0F;      // two samples farther apart do not show the same surface
constexpr float kLeastBlockSamples = 4.0F;
constexpr float kLeastTrust = 0.2F;
constexpr float kHalfTrustSigmas =
    3.0F;  // disagreement in standard deviations that halves the trust
constexpr std::array<std::uint8_t, 3> kSaturatedBit = {kSaturatedR, kSaturatedG, kSaturatedB};

// The reference's disparity at full resolution: low-resolution pixels around, weighed by nearness
// and by likeness of brightness (joint bilateral upsampling, Kopf et al. 2007), but never a mean of
// two surfaces: only values close to the heaviest one take part.
class DisparityLookup {
 public:
  DisparityLookup(const DisparityMap& map, const Image<std::uint8_t>& brightness)
      : map_(map), brightness_(brightness), grid_(map.disparity.width(), map.disparity.height()) {}

  struct Value {
    float disparity = kNan;
    float confidence = 0.0F;
  };

  // At a point of the map. `code` is the full-resolution brightness on the scale of the map's
  // brightness, < 0 if unknown.
  Value At(float px, float py, float code) const {
    const float fx = px - 0.5F;
    const float fy = py - 0.5F;
    const int x0 = static_cast<int>(std::floor(fx));
    const int y0 = static_cast<int>(std::floor(fy));
    std::array<float, 4> d{};
    std::array<float, 4> w{};
    std::array<float, 4> c{};
    std::size_t count = 0;
    std::size_t heaviest = 0;
    for (int k = 0; k < 4; ++k) {
      const int x = Wrap(x0 + (k & 1));
      const int y = std::clamp(y0 + (k >> 1), 0, grid_.height() - 1);
      const float value = map_.disparity.at(x, y);
      if (!(value >= 0.0F)) continue;
      const float ax = 1.0F - std::abs(fx - static_cast<float>(x0 + (k & 1)));
      const float ay = 1.0F - std::abs(fy - static_cast<float>(y0 + (k >> 1)));
      float weight = std::max(ax * ay, 1e-3F);
      if (code >= 0.0F) {
        const float unlike = std::abs(code - static_cast<float>(brightness_.at(x, y)));
        weight *= 1.0F / (1.0F + 0.05F * unlike * unlike);
      }
      d[count] = value;
      w[count] = weight;
      c[count] = map_.confidence.at(x, y);
      if (weight > w[heaviest]) heaviest = count;
      ++count;
    }
    if (count == 0) return {};
    const float centre = d[heaviest];
    const float near = 0.05F * centre + 0.002F;
    float sum = 0.0F;
    float weight_sum = 0.0F;
    for (std::size_t k = 0; k < count; ++k) {
      if (std::abs(d[k] - centre) > near) continue;
      sum += w[k] * d[k];
      weight_sum += w[k];
    }
    return {sum / weight_sum, c[heaviest]};
  }

 private:
  int Wrap(int x) const {
    if (x < 0) return x + grid_.width();
    return x >= grid_.width() ? x - grid_.width() : x;
  }
  const DisparityMap& map_;
  const Image<std::uint8_t>& brightness_;
  LatLongGrid grid_;
};

// Everything needed to look a surface point up in one other view.
struct SourceLookup {
  const Measurement* measurement = nullptr;
  std::unique_ptr<PanoramaSampler> sampler;
  Eigen::Matrix3f camera_from_world = Eigen::Matrix3f::Identity();
  Eigen::Vector3f offset = Eigen::Vector3f::Zero();  // its centre from the reference's, world frame
  Image<float> nearest;  // nearest surface in each of its directions, world-aligned; NaN unknown
  AgreementField agreement;
  // reference / source where both are well exposed; nothing when too little is shared.
  std::optional<float> exposure_ratio;
  // How far the source is trusted in each block of output pixels, 0..1: a mean over a block shows a
  // wrong registration that the noise of a single dark pixel hides.
  Image<float> block_trust;
};

constexpr int kBlock = 8;  // output pixels

struct BlockSums {
  float mine = 0.0F;
  float theirs = 0.0F;
  float noise = 0.0F;
  float count = 0.0F;
};

enum class Sight { kUnknown, kHidden, kVisible };

// Whether a source sees the surface point of the row's i-th ray, at disparity `d`, or something
// nearer hides it there. kUnknown: the point has no place in the source.
Sight SightOf(const SourceLookup& source, const SeenRow& seen, std::size_t i, float d,
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
                            const Eigen::Vector3f& offset) {
  Image<float> nearest = WarpDisparity(reference, offset);
  if (source.disparity != nullptr && source.disparity->disparity.width() == nearest.width()) {
    for (int y = 0; y < nearest.height(); ++y) {
      for (int x = 0; x < nearest.width(); ++x) {
        if (source.disparity->confidence.at(x, y) < 0.3F) continue;
        const float d = source.disparity->disparity.at(x, y);
        float& n = nearest.at(x, y);
        if (d >= 0.0F && !(n >= d)) n = d;
      }
    }
  }
  return nearest;
}

struct Sample {
  std::array<float, 3> radiance{};
  std::array<float, 3> variance{};
  std::array<float, 3> hat{};  // weights in place of the inverse variance, when asked for
  std::uint8_t flags = kMasked;
  bool usable = false;  // no channel saturated, not masked
  bool hidden = false;  // behind something nearer, if the disparity maps are right
  float trust = 1.0F;
};

// Whether a clipped sample is as bright as a clipped pixel demands, and so may show the same.
bool MeetsBound(const Sample& sample, const Sample& mine) {
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
float LocalContrast(const Measurement& m, float x, float y) {
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

// Whether a surface's radiance is within the good part of both views' ranges. The longer, cleaner
// exposure decides: a noisy value that chose itself would bias the ratio.
class WellExposed {
 public:
  WellExposed(const Measurement& mine, const Measurement& theirs)
      : by_mine_(mine.longest_exposure_s >= theirs.longest_exposure_s),
        low_(kLow * std::max(mine.saturation[1], theirs.saturation[1])),
        high_(kHigh * std::min(mine.saturation[1], theirs.saturation[1])) {}
  bool operator()(float mine_y, float theirs_y) const {
    const float y = by_mine_ ? mine_y : theirs_y;
    return y >= low_ && y <= high_;
  }

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
void SetHatWeights(const Measurement& m, const std::array<float, 3>& raw, Sample* s) {
  for (std::size_t c = 0; c < 3; ++c) {
    const float value = raw[c] / m.saturation[c];
    const bool is_dark = (s->flags & kDarkAny) != 0;
    s->hat[c] = is_dark ? kDarkWeight : std::max(std::min(value, 1.0F - value), kLeastHat);
  }
}

std::optional<float> Median(std::vector<float> values) {
  constexpr std::size_t kLeast = 1000;
  if (values.size() < kLeast) return {};
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
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
                      const Image<std::uint8_t>* map_brightness,
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

  std::vector<SourceLookup> sources(std::min(others.size(), kMaxSources - 1));
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
      if (map != nullptr) s.nearest = NearestSurface(*map, other, s.offset);
    }
  });
  std::unique_ptr<DisparityLookup> disparity;
  if (map != nullptr) disparity = std::make_unique<DisparityLookup>(*map, *map_brightness);
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

  const auto make_sample = [&](const Measurement& m, const RadianceSample& raw) {
    Sample s;
    s.radiance = raw.rgb;
    s.flags = raw.flags;
    s.usable = (raw.flags & (kMasked | kSaturatedAny)) == 0;
    for (std::size_t c = 0; c < 3; ++c) {
      const float e = std::max(raw.rgb[c], 0.0F);
      s.variance[c] = m.variance_floor[c] + m.variance_per_radiance[c] * e;
    }
    return s;
  };
  const bool by_hat = options.weights == MergeWeights::kHat;

  const float cells_per_pixel_x =
      static_cast<float>(AgreementField::kWidth) / static_cast<float>(width);
  const float cells_per_pixel_y =
      static_cast<float>(AgreementField::kHeight) / static_cast<float>(height);
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
    for (int row = begin; row < end; ++row) {
      RaysOfRow(output, row * kStep + kStep / 2, kStep / 2, kStep, world_from_output_matrix, &rays);
      PointsInView(rays, own_from_world, own_sampler, &points);
      for (std::size_t i = 0; i < rays.size(); ++i) {
        const RadianceSample mine = own_sampler.SampleAt(points.x[i], points.y[i]);
        const bool counts = (mine.flags & (kMasked | kSaturatedAny)) == 0;
        own_luminance.at(static_cast<int>(i), row) = counts ? Luminance(mine.rgb.data()) : 0.0F;
      }
      if (disparity == nullptr) continue;
      PointsOnGrid(rays, map_grid, &points);
      for (std::size_t i = 0; i < rays.size(); ++i) {
        const DisparityLookup::Value d = disparity->At(points.x[i], points.y[i], -1.0F);
        own_disparity.at(static_cast<int>(i), row) = d.disparity;
        own_confidence.at(static_cast<int>(i), row) = d.confidence;
      }
    }
  });

  ParallelFor(static_cast<int>(sources.size()), 1, [&](int begin, int end) {
    RayRow rays;
    SeenRow seen;
    std::vector<float> known_disparity(static_cast<std::size_t>(sampled_width));
    for (int n = begin; n < end; ++n) {
      SourceLookup& source = sources[static_cast<std::size_t>(n)];
      std::vector<AgreementField::Residual> residuals;
      std::vector<float> exposure_ratios;
      const WellExposed well_exposed(own, *source.measurement);
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
        for (std::size_t i = 0; i < rays.size(); ++i) {
          const int x = static_cast<int>(i) * kStep + kStep / 2;
          const float mine_y = own_luminance.at(static_cast<int>(i), row);
          if (!(mine_y > 0.0F)) continue;
          const DisparityLookup::Value d = {disparities[i],
                                            own_confidence.at(static_cast<int>(i), row)};
          if (SightOf(source, seen, i, d.disparity, occlusion_tolerance) != Sight::kVisible) {
            continue;
          }
          const float px = seen.image.x[i];
          const float py = seen.image.y[i];
          const RadianceSample theirs = source.sampler->SampleAt(px, py);
          if ((theirs.flags & (kMasked | kSaturatedAny)) != 0) continue;
          const float theirs_y = Luminance(theirs.rgb.data());
          if (!(theirs_y > 0.0F)) continue;
          BlockSums& block = blocks[static_cast<std::size_t>((y / kBlock) * blocks_x + x / kBlock)];
          const auto variance = [](const Measurement& m, float e) {
            return m.variance_floor[1] + m.variance_per_radiance[1] * e;
          };
          const float noise = variance(own, theirs_y) + variance(*source.measurement, theirs_y);
          block.mine += mine_y;
          block.theirs += theirs_y;
          block.noise += noise;
          block.count += 1.0F;
          if (disparity != nullptr && d.confidence < kTrustedConfidence) continue;
          if (theirs_y < kLeastNoiseFloors * source.measurement->noise_floor) continue;
          const float ratio = mine_y / theirs_y;
          if (ratio < 1.0F / kLargestRatio || ratio > kLargestRatio) continue;
          if (well_exposed(mine_y, theirs_y)) exposure_ratios.push_back(ratio);
          const float contrast =
              LocalContrast(*source.measurement, px, py) * options.misalignment_px;
          const int cell = static_cast<int>((static_cast<float>(y) + 0.5F) * cells_per_pixel_y) *
                               AgreementField::kWidth +
                           static_cast<int>((static_cast<float>(x) + 0.5F) * cells_per_pixel_x);
          residuals.push_back({cell, ratio, (noise + contrast * contrast) / (theirs_y * theirs_y)});
        }
      }
      if (!options.consistency) residuals.clear();  // a field of ones
      source.agreement.Fit(residuals);
      source.exposure_ratio = Median(std::move(exposure_ratios));
      source.block_trust = Image<float>(blocks_x, blocks_y, 1, 1.0F);
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
          const float r = gap * gap / (9.0F * (b.noise + tolerance * tolerance));
          source.block_trust.at(bx, by) = 1.0F / (1.0F + r * r);
        }
      }
    }
  });

  if (options.refine_exposure) view.exposure = TestExposure(sources, options.refine_limit);
  ParallelFor(height, 8, [&](int begin, int end) {
    std::array<Sample, kMaxSources> samples;
    RayRow rays;
    PointRow own_points;
    PointRow map_points;
    std::array<SeenRow, kMaxSources> seen;
    std::vector<float> known_disparity(static_cast<std::size_t>(width), 0.0F);
    for (int y = begin; y < end; ++y) {
      RaysOfRow(output, y, 0, 1, world_from_output_matrix, &rays);
      PointsInView(rays, own_from_world, own_sampler, &own_points);
      if (disparity != nullptr) {
        PointsOnGrid(rays, map_grid, &map_points);
        for (std::size_t i = 0; i < rays.size(); ++i) {
          const int x = static_cast<int>(i);
          const DisparityLookup::Value d = disparity->At(map_points.x[i], map_points.y[i], -1.0F);
          view.disparity.at(x, y) = d.disparity;
          view.confidence.at(x, y) = d.confidence;
          known_disparity[i] = d.disparity >= 0.0F ? d.disparity : 0.0F;
        }
      }
      for (std::size_t n = 0; n < sources.size(); ++n) {
        SurfacePointsInView(rays, known_disparity, sources[n].offset, sources[n].camera_from_world,
                            *sources[n].sampler, map_grid, &seen[n]);
      }
      for (int x = 0; x < width; ++x) {
        const auto i = static_cast<std::size_t>(x);
        const RadianceSample own_raw = own_sampler.SampleAt(own_points.x[i], own_points.y[i]);
        samples[0] = make_sample(own, own_raw);
        if (by_hat) SetHatWeights(own, own_raw.rgb, &samples[0]);
        const Sample& mine = samples[0];
        const bool own_is_clipped =
            (mine.flags & kMasked) == 0 && (mine.flags & kSaturatedAny) != 0;
        std::size_t count = 1;
        const DisparityLookup::Value d = {view.disparity.at(x, y), view.confidence.at(x, y)};
        // Where this view saw nothing, its disparity is a guess unless others agreed on it: better
        // no data than other views' pixels strewn about.
        const bool is_guess = (mine.flags & kMasked) != 0 && disparity != nullptr &&
                              d.confidence < kTrustedConfidence;
        const bool by_rotation = disparity == nullptr;
        const float misregistration =
            options.misalignment_px +
            (1.0F - (by_rotation ? 0.5F : d.confidence)) * options.distrusted_px;

        const float cell_x = (static_cast<float>(x) + 0.5F) * cells_per_pixel_x;
        const float cell_y = (static_cast<float>(y) + 0.5F) * cells_per_pixel_y;
        for (std::size_t n = 0; n < sources.size() && !is_guess; ++n) {
          const SourceLookup& source = sources[n];
          const Sight sight = SightOf(source, seen[n], i, d.disparity, occlusion_tolerance);
          // What a disparity map calls hidden is asked only where this view itself does not know.
          if (sight == Sight::kUnknown || (sight == Sight::kHidden && !own_is_clipped)) continue;
          const float px = seen[n].image.x[i];
          const float py = seen[n].image.y[i];
          const RadianceSample raw = source.sampler->SampleAt(px, py);
          if ((raw.flags & kMasked) != 0) continue;
          Sample s = make_sample(*source.measurement, raw);
          s.hidden = sight == Sight::kHidden;
          s.trust = source.block_trust.at(x / kBlock, y / kBlock);
          const float factor = source.agreement.Factor(cell_x, cell_y);
          for (std::size_t c = 0; c < 3; ++c) {
            s.radiance[c] *= factor;
            s.variance[c] *= factor * factor;
          }
          if (s.usable) {
            const float contrast =
                factor * LocalContrast(*source.measurement, px, py) * misregistration;
            const float relative =
                options.model_error * options.model_error + source.agreement.excess();
            for (std::size_t c = 0; c < 3; ++c) {
              s.variance[c] += contrast * contrast + relative * s.radiance[c] * s.radiance[c];
            }
          }
          if (by_hat) SetHatWeights(*source.measurement, raw.rgb, &s);
          samples[count++] = s;
        }

        // How well each other sample agrees with what this view itself saw, as an interval per
        // channel.
        if (options.consistency && (mine.flags & kMasked) == 0) {
          for (std::size_t k = 1; k < count; ++k) {
            Sample& s = samples[k];
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
        }

        float* out = view.radiance.pixel(x, y);
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
          for (std::size_t k = 0; k < count; ++k) {
            const Sample& s = samples[k];
            if (!s.usable) continue;
            for (std::size_t c = 0; c < 3; ++c) {
              const float w = by_hat ? s.trust * s.hat[c] : s.trust / s.variance[c];
              signal[c] += w * s.radiance[c];
              signal_weight[c] += w;
            }
            dark = dark && (s.flags & kDarkAny) == kDarkAny;
          }
          for (std::size_t c = 0; c < 3; ++c) {
            out[c] = signal[c] / signal_weight[c];
            if (options.consistency && (mine.flags & kSaturatedBit[c]) != 0) {
              out[c] = std::max(out[c], mine.radiance[c]);
            }
          }
          view.origin.at(x, y) =
              static_cast<std::uint8_t>(dark ? PixelOrigin::kDark : PixelOrigin::kMeasured);
        } else {
          // Saturated wherever it was seen: each says "at least"; the largest bound says most.
          // Clipped areas have no texture, so that wrong disparities "hide" their pixels here and
          // there: a view's bound counts in spite of that unless the disparity is sure.
          bool is_bounded = false;
          std::uint8_t clipped = kSaturatedAny;
          for (std::size_t k = 0; k < count; ++k) {
            if ((samples[k].flags & kMasked) != 0) continue;
            if (samples[k].hidden &&
                (d.confidence >= kSureConfidence || !MeetsBound(samples[k], mine))) {
              continue;
            }
            if (samples[k].usable && k > 0) continue;
            if (k > 0 && (mine.flags & kMasked) == 0 && samples[k].trust <= kLeastTrust) continue;
            is_bounded = true;
            clipped = static_cast<std::uint8_t>(clipped & samples[k].flags);
            for (std::size_t c = 0; c < 3; ++c) out[c] = std::max(out[c], samples[k].radiance[c]);
          }
          NeutraliseClipped(clipped, out);
          view.origin.at(x, y) =
              static_cast<std::uint8_t>(is_bounded ? PixelOrigin::kClipped : PixelOrigin::kNoData);
        }
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
