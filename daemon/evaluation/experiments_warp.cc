#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>

#include "core/base/parallel_for.h"
#include "core/photometry/sampler.h"
#include "core/stereo/view_merge.h"
#include "core/stereo/view_synthesis.h"
#include "daemon/evaluation/experiments_parts.h"

namespace omnihdr::experiments {
namespace {

constexpr auto kHole = static_cast<std::uint8_t>(PixelOrigin::kNoData);

// A neighbour's frame on its own lat-long grid, and where it is.
struct WarpSource {
  Measurement picture;     // of that grid
  Image<float> disparity;  // of its own pixels
  Pose pose;
};

// What a measurement on a lat-long grid says beside its pixels; all of them unseen.
Measurement EmptyLatLong(const Measurement& noise_of, int width) {
  Measurement m;
  m.projection = Projection::Equirectangular(width, width / 2);
  m.radiance = Image<float>(width, width / 2, 4);
  m.flags = Image<std::uint8_t>(width, width / 2, 1, kMasked);
  m.saturation = noise_of.saturation;
  m.variance_floor = noise_of.variance_floor;
  m.variance_per_radiance = noise_of.variance_per_radiance;
  m.noise_floor = noise_of.noise_floor;
  m.longest_exposure_s = noise_of.longest_exposure_s;
  m.shortest_exposure_s = noise_of.shortest_exposure_s;
  return m;
}

void Put(const float* rgb, std::uint8_t flags, int x, int y, Measurement* target) {
  std::copy_n(rgb, 3, target->radiance.pixel(x, y));
  target->radiance.at(x, y, 3) = flags == 0 ? 1.0F : 0.0F;
  target->flags.at(x, y) = flags;
}

// A frame on the grid that all warps start from.
Measurement OnLatLong(const Measurement& frame, int width) {
  Measurement m = EmptyLatLong(frame, width);
  const PanoramaSampler sampler(frame);
  for (int y = 0; y < m.flags.height(); ++y) {
    for (int x = 0; x < width; ++x) {
      const RadianceSample sample =
          sampler.Sample(m.projection.RayFromPixel(x + 0.5, y + 0.5).cast<float>());
      if ((sample.flags & kMasked) == 0) Put(sample.rgb.data(), sample.flags, x, y, &m);
    }
  }
  return m;
}

// Every pixel of the source put where its disparity says, the nearest surface first (thesis fig.
// 5.11): holes where nothing lands.
Measurement WarpPixels(const WarpSource& source, const Pose& target_pose) {
  Measurement target = EmptyLatLong(source.picture, source.picture.flags.width());
  const int width = source.disparity.width();
  const int height = source.disparity.height();
  const Projection& grid = source.picture.projection;
  const Eigen::Matrix3d rotation =
      (target_pose.rotation.conjugate() * source.pose.rotation).toRotationMatrix();
  const Eigen::Vector3d offset = target_pose.CameraFromWorld(source.pose.translation);
  Image<float> nearest(width, height, 1, -1.0F);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const float disparity = source.disparity.at(x, y);
      if (!(disparity >= 0.0F) || (source.picture.flags.at(x, y) & kMasked) != 0) continue;
      const Eigen::Vector3d point =
          rotation * grid.RayFromPixel(x + 0.5, y + 0.5) + static_cast<double>(disparity) * offset;
      const double length = point.norm();
      if (!(length > 1e-9)) continue;
      const auto there = static_cast<float>(static_cast<double>(disparity) / length);
      const Eigen::Vector2d at = grid.PixelFromRay(point);
      const int tx = std::clamp(static_cast<int>(at.x()), 0, width - 1);
      const int ty = std::clamp(static_cast<int>(at.y()), 0, height - 1);
      float& z = nearest.at(tx, ty);
      if (z >= there) continue;
      z = there;
      Put(source.picture.radiance.pixel(x, y), source.picture.flags.at(x, y), tx, ty, &target);
    }
  }
  return target;
}

// One value a channel of the source, warped as view_synthesis.h does: its disparity forward, its
// cracks closed, then values fetched. NaN where it has none.
Result<Image<float>> WarpValues(const WarpSource& source, const Pose& target_pose,
                                const std::function<float(int x, int y, int c)>& value) {
  const int width = source.disparity.width();
  const int height = source.disparity.height();
  std::array<SynthesisSource, 1> from;
  from[0].radiance = Image<float>(width, height, 3, std::numeric_limits<float>::quiet_NaN());
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if ((source.picture.flags.at(x, y) & kMasked) != 0) continue;
      for (int c = 0; c < 3; ++c) from[0].radiance.at(x, y, c) = value(x, y, c);
    }
  }
  from[0].disparity = source.disparity.Clone();
  from[0].world_from_output = source.pose;
  OMNIHDR_ASSIGN(SynthesizedView view, SynthesizeView(from, target_pose, width, {}));
  return std::move(view.radiance);
}

Result<Measurement> WarpSurfaces(const WarpSource& source, const Pose& target_pose) {
  const Measurement& picture = source.picture;
  const auto flag = [&picture](int first) {
    return [&picture, first](int x, int y, int c) {
      return (picture.flags.at(x, y) & (first << c)) != 0 ? 1.0F : 0.0F;
    };
  };
  OMNIHDR_ASSIGN(const Image<float> rgb, WarpValues(source, target_pose, [&](int x, int y, int c) {
                   return picture.radiance.at(x, y, c);
                 }));
  OMNIHDR_ASSIGN(const Image<float> saturated, WarpValues(source, target_pose, flag(kSaturatedR)));
  OMNIHDR_ASSIGN(const Image<float> dark, WarpValues(source, target_pose, flag(kDarkR)));
  Measurement target = EmptyLatLong(picture, picture.flags.width());
  for (int y = 0; y < rgb.height(); ++y) {
    for (int x = 0; x < rgb.width(); ++x) {
      if (!std::isfinite(rgb.at(x, y))) continue;
      int flags = 0;
      for (int c = 0; c < 3; ++c) {
        // A blend with a clipped pixel is no measurement.
        if (saturated.at(x, y, c) > 0.01F) flags |= kSaturatedR << c;
        if (dark.at(x, y, c) > 0.5F) flags |= kDarkR << c;
      }
      Put(rgb.pixel(x, y), static_cast<std::uint8_t>(flags), x, y, &target);
    }
  }
  return target;
}

// Every pixel of the target sought in the source through the target's disparity (thesis fig. 5.12).
Measurement WarpBackward(const WarpSource& source, const Image<float>& target_disparity,
                         const Pose& target_pose) {
  Measurement target = EmptyLatLong(source.picture, source.picture.flags.width());
  const Projection& grid = source.picture.projection;
  const PanoramaSampler sampler(source.picture);
  const Eigen::Matrix3d rotation =
      (source.pose.rotation.conjugate() * target_pose.rotation).toRotationMatrix();
  const Eigen::Vector3d offset = source.pose.CameraFromWorld(target_pose.translation);
  ParallelFor(target_disparity.height(), 8, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < target_disparity.width(); ++x) {
        const float disparity = target_disparity.at(x, y);
        if (!(disparity >= 0.0F)) continue;
        const Eigen::Vector3d point = rotation * grid.RayFromPixel(x + 0.5, y + 0.5) +
                                      static_cast<double>(disparity) * offset;
        const RadianceSample sample = sampler.Sample(point.cast<float>());
        if ((sample.flags & kMasked) != 0) continue;
        Put(sample.rgb.data(), sample.flags, x, y, &target);
      }
    }
  });
  return target;
}

MergedView ViewOf(const Measurement& warped) {
  MergeOptions merge;
  merge.refine_exposure = false;
  return MergeViews({&warped, Pose{}, nullptr}, nullptr, {}, Eigen::Quaterniond::Identity(),
                    warped.radiance.width(), merge);
}

// The own frame and pictures already brought to its place, merged there.
MergedView MergeInPlace(const Measurement& own, const std::vector<Measurement>& warped,
                        bool as_thesis) {
  MergeOptions merge;
  merge.refine_exposure = false;
  if (as_thesis) {
    merge.weights = MergeWeights::kHat;
    merge.consistency = false;
    merge.occlusion = false;
  }
  std::vector<MergeSource> others;
  for (const Measurement& each : warped) others.push_back({&each, Pose{}, nullptr});
  return MergeViews({&own, Pose{}, nullptr}, nullptr, others, Eigen::Quaterniond::Identity(),
                    own.radiance.width(), merge);
}

// Share of what the target's camera sees that a warped picture leaves without a value.
double HoleShare(const Measurement& warped, const MergedView& own) {
  const Projection& grid = warped.projection;
  double seen = 0.0;
  double holes = 0.0;
  for (int y = 0; y < own.origin.height(); ++y) {
    for (int x = 0; x < own.origin.width(); ++x) {
      if (own.origin.at(x, y) == kHole) continue;
      const double weight = grid.PixelSolidAngle(y);
      seen += weight;
      if ((warped.flags.at(x, y) & kMasked) != 0) holes += weight;
    }
  }
  return seen > 0.0 ? holes / seen : 0.0;
}

struct WarpMethod {
  const char* name;
  std::vector<Measurement> warped;  // of both neighbours
};

Cell Percent(double share) { return Number(100.0 * share, 2); }

std::string Ssim3(double value) { return fmt::format("{:.3f}", value); }

}  // namespace

Status RunWarp(const Benches& benches, const std::filesystem::path& out, Section* section) {
  Bench& bench = *benches.indoor;
  std::string why_not;
  const std::optional<Steps> steps = bench.StepsOf(1.6, &why_not);
  if (!steps) {
    section->notes.push_back(why_not);
    return {};
  }
  constexpr int kTarget = 1;
  const std::array<int, 3> bracket = steps->all();
  const Sequence sequence = DrawSequence(bench, *steps, Order::kSawTooth, 3);
  OMNIHDR_ASSIGN(const std::vector<FinishedView>* views, bench.Views(sequence, Method::kOurs));
  if ((*views)[0].pose.chain != (*views)[2].pose.chain) {
    section->notes.push_back(fmt::format("{}: its first three positions could not be linked: {}",
                                         bench.place(), (*views)[2].pose.chain_reason));
    return {};
  }
  const Pose target = (*views)[kTarget].pose.world_from_camera;
  std::vector<WarpSource> sources;
  std::vector<MergedView> alone;
  for (int i = 0; i < 3; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const std::array<int, 1> exposure = {sequence.exposures[k]};
    OMNIHDR_ASSIGN(MergedView frame, bench.Alone(i, exposure[0]));
    OMNIHDR_ASSIGN(const Measurement measured,
                   bench.matrix().Measure(i, exposure, bench.OptionsOf(Method::kOurs)));
    sources.push_back({OnLatLong(measured, bench.matrix().output_width()),
                       (*views)[k].merged.disparity.Clone(), (*views)[k].pose.world_from_camera});
    alone.push_back(std::move(frame));
  }
  std::array<WarpMethod, 3> methods = {
      {{"forward, pixel by pixel", {}}, {"forward, surfaces closed", {}}, {"backward", {}}}};
  for (const std::size_t n : {std::size_t{0}, std::size_t{2}}) {
    methods[0].warped.push_back(WarpPixels(sources[n], target));
    OMNIHDR_ASSIGN(Measurement surfaces, WarpSurfaces(sources[n], target));
    methods[1].warped.push_back(std::move(surfaces));
    methods[2].warped.push_back(WarpBackward(sources[n], sources[kTarget].disparity, target));
  }

  Table warped;
  warped.title = fmt::format("Exposures {} of positions 0 and 2, warped to position 1",
                             Numbered({bracket[0], bracket[2]}));
  // Held against the same exposure taken at the target itself.
  warped.columns = {"warp",
                    "from position",
                    "exposure",
                    "without a value, %",
                    "SSIM to the same exposure at position 1",
                    "RMSE to the same exposure at position 1",
                    "RMSE to truth"};
  Table merged;
  merged.title = "HDR of position 1: its own frame and the two warped ones";
  merged.columns = {"warp", "merge", "SSIM to temporal HDR", "RMSE to temporal HDR",
                    "RMSE to truth"};
  std::vector<PictureRow> rows;
  std::vector<std::string> ssim;
  for (const WarpMethod& method : methods) {
    PictureRow row;
    row.label = method.name;
    for (std::size_t n = 0; n < 2; ++n) {
      const int from = n == 0 ? 0 : 2;
      const int exposure = sequence.exposures[static_cast<std::size_t>(from)];
      const MergedView picture = ViewOf(method.warped[n]);
      const std::array<int, 1> own_bracket = {exposure};
      OMNIHDR_ASSIGN(const ViewScore score, bench.Score(kTarget, own_bracket, picture));
      warped.rows.push_back({Words(method.name), Number(from, 0), Words(Numbered(exposure)),
                             Percent(HoleShare(method.warped[n], alone[kTarget])),
                             Number(score.ssim, 3), Number(score.rmse_temporal, 4),
                             Number(score.rmse_truth, 4)});
      row.pictures.push_back(ShownFrame(picture, bench.matrix().Seconds(exposure)));
    }
    for (const bool as_thesis : {true, false}) {
      const MergedView view = MergeInPlace(sources[kTarget].picture, method.warped, as_thesis);
      OMNIHDR_ASSIGN(const ViewScore score, bench.Score(kTarget, bracket, view));
      merged.rows.push_back({Words(method.name), Words(as_thesis ? "thesis's" : "ours"),
                             Number(score.ssim, 3), Number(score.rmse_temporal, 4),
                             Number(score.rmse_truth, 4)});
      if (as_thesis) {
        ssim.push_back(Ssim3(score.ssim));
        row.pictures.push_back(Shown(view));
      }
    }
    rows.push_back(std::move(row));
  }
  OMNIHDR_ASSIGN(const ViewScore whole, bench.Score(kTarget, bracket, (*views)[kTarget].merged));
  merged.rows.push_back({Words("the pipeline (backward, occlusion test)"), Words("ours"),
                         Number(whole.ssim, 3), Number(whole.rmse_temporal, 4),
                         Number(whole.rmse_truth, 4)});

  const auto hole = [&](std::size_t row) {
    return fmt::format("{:.1f}", *warped.rows[row].at(3).number);
  };
  section->found = fmt::format(
      "without a value {} and {} % (forward, pixel by pixel), {} and {} % (surfaces closed), {} "
      "and "
      "{} % (backward); SSIM of the HDR {}, {}, {} with the thesis's merge",
      hole(0), hole(1), hole(2), hole(3), hole(4), hole(5), ssim[0], ssim[1], ssim[2]);
  section->tables = {std::move(warped), std::move(merged)};
  section->notes.emplace_back(
      "SSIM and RMSE are of the pixels that have a value: a warp with more holes is spared the "
      "half-occluded ones.");
  section->notes.emplace_back(
      "\"Pixel by pixel\" is the thesis's forward warp; \"surfaces closed\" is `omnihdr view`'s: "
      "the "
      "source's disparity is warped, the cracks of stretched surfaces are closed, then colours are "
      "fetched. All three start from the same lat-long pictures and disparity maps.");
  OMNIHDR_TRY(WritePictures(out / "warp.png",
                            {fmt::format("position 0, #{}, warped to 1", bracket[0]),
                             fmt::format("position 2, #{}, warped to 1", bracket[2]),
                             "HDR of position 1, thesis's merge"},
                            rows));
  section->figures.push_back(
      {"warp.png",
       "Warped frames and the HDR made of them (thesis figs. 6.5 to 6.7); no value is "
       "black"});
  return {};
}

}  // namespace omnihdr::experiments
