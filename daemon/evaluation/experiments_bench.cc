#include "daemon/evaluation/experiments_bench.h"

#include <algorithm>
#include <cmath>

#include "core/photometry/tonemap.h"
#include "core/stereo/view_merge.h"
#include "daemon/evaluation/evaluation.h"

namespace omnihdr::experiments {
namespace {

constexpr auto kUnseen = static_cast<std::uint8_t>(PixelOrigin::kNoData);

bool HasValue(const MergedView& view, int x, int y) {
  const float* rgb = view.radiance.pixel(x, y);
  return view.origin.at(x, y) != kUnseen && std::isfinite(rgb[0]) && std::isfinite(rgb[1]) &&
         std::isfinite(rgb[2]);
}

MergedView AloneOf(const Measurement& measurement, int width) {
  MergeOptions merge;
  merge.refine_exposure = false;
  return MergeViews({&measurement, Pose{}, nullptr}, nullptr, {}, Eigen::Quaterniond::Identity(),
                    width, merge);
}

}  // namespace

std::vector<int> OrderedExposures(const Steps& steps, Order order, std::size_t count) {
  const std::vector<int> period =
      order == Order::kSawTooth
          ? std::vector<int>{steps.brief, steps.medium, steps.extended}
          : std::vector<int>{steps.brief, steps.medium, steps.extended, steps.medium};
  std::vector<int> exposures;
  for (std::size_t i = 0; i < count; ++i) exposures.push_back(period[i % period.size()]);
  return exposures;
}

PipelineOptions Bench::OptionsOf(Method method) const {
  PipelineOptions options = options_;
  if (method == Method::kThesis) {
    options = PipelineOptions::Thesis();
    options.mask_file = options_.mask_file;
    options.stereo_width = options_.stereo_width;
    options.labels = options_.labels;
    options.max_parallax_deg = options_.max_parallax_deg;
    options.white_balance = options_.white_balance;
  }
  options.orientation = OutputOrientation::kCamera;
  options.output_width = matrix_->output_width();
  return options;
}

std::optional<Steps> Bench::StepsOf(double stops, std::string* why_not) const {
  const std::optional<int> brief = matrix_->AtStops(-stops);
  const std::optional<int> extended = matrix_->AtStops(stops);
  if (brief && extended) return Steps{stops, *brief, matrix_->middle(), *extended};
  if (why_not != nullptr) {
    const int nearest = matrix_->NearestTo(brief ? stops : -stops);
    *why_not = fmt::format(
        "{}: no exposures {:.1f} stops apart (the nearest to {:+.1f} stops from the middle is at "
        "{:+.2f}): not run",
        place_, stops, brief ? stops : -stops, matrix_->StopsFromMiddle(nearest));
  }
  return std::nullopt;
}

Result<const std::vector<FinishedView>*> Bench::Views(const Sequence& sequence, Method method) {
  const std::pair<Sequence, Method> key(sequence, method);
  if (const auto* kept = views_.Find(key)) return kept;
  const PipelineOptions options = OptionsOf(method);
  OMNIHDR_ASSIGN(const std::unique_ptr<ViewPipeline> pipeline, ViewPipeline::Create(options));
  std::vector<FinishedView> views;
  const auto all = [](PositionId) { return true; };
  for (std::size_t i = 0; i < sequence.positions.size(); ++i) {
    const int position = sequence.positions[i];
    const std::array<int, 1> exposure = {sequence.exposures[i]};
    const FrameRecord& frame = matrix_->frame(position, exposure[0]);
    PositionInput input;
    input.position = PositionId{position};
    OMNIHDR_ASSIGN(input.measurement, matrix_->Measure(position, exposure, options));
    input.frames = {frame.frame};
    input.reference = frame.frame;
    input.odometer_m = frame.odometer_m;
    input.prior = frame.pose;
    if (std::optional<FinishedView> view = pipeline->Push(std::move(input), all)) {
      views.push_back(std::move(*view));
    }
  }
  for (FinishedView& view : pipeline->Finish(all)) views.push_back(std::move(view));
  return views_.Put(key, std::move(views));
}

Result<const MergedView*> Bench::Temporal(int position, std::span<const int> exposures) {
  const std::pair<int, std::vector<int>> key(position, {exposures.begin(), exposures.end()});
  if (const MergedView* kept = temporal_.Find(key)) return kept;
  OMNIHDR_ASSIGN(const Measurement measurement,
                 matrix_->Measure(position, exposures, OptionsOf(Method::kOurs)));
  return temporal_.Put(key, AloneOf(measurement, matrix_->output_width()));
}

Result<MergedView> Bench::Alone(int position, int exposure) {
  const std::array<int, 1> one = {exposure};
  OMNIHDR_ASSIGN(const Measurement measurement,
                 matrix_->Measure(position, one, OptionsOf(Method::kOurs)));
  return AloneOf(measurement, matrix_->output_width());
}

Result<const Reference::Picture*> Bench::Truth(int position) {
  if (matrix_->reference() == nullptr) return nullptr;
  if (const Reference::Picture* kept = truth_.Find(position)) return kept;
  const int width = matrix_->output_width();
  OMNIHDR_ASSIGN(Reference::Picture picture,
                 matrix_->reference()->Render(matrix_->frame(position, matrix_->middle()),
                                              Projection::Equirectangular(width, width / 2),
                                              Eigen::Quaterniond::Identity()));
  return truth_.Put(position, std::move(picture));
}

Result<ViewScore> Bench::Score(int position, std::span<const int> bracket, const MergedView& view) {
  OMNIHDR_ASSIGN(const MergedView* temporal, Temporal(position, bracket));
  OMNIHDR_ASSIGN(const Reference::Picture* truth, Truth(position));
  const int width = view.radiance.width();
  const int height = view.radiance.height();
  const double shortest = matrix_->Seconds(*std::min_element(bracket.begin(), bracket.end()));
  const double longest = matrix_->Seconds(*std::max_element(bracket.begin(), bracket.end()));
  const Response& response = matrix_->info().response;
  const auto low = static_cast<float>(response.ExposureFromValue(1, options_.value_low) / longest);
  const auto high =
      static_cast<float>(response.ExposureFromValue(1, options_.value_high) / shortest);
  Image<std::uint8_t> in_both(width, height);
  Image<std::uint8_t> measurable(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (!HasValue(*temporal, x, y) || !HasValue(view, x, y)) continue;
      in_both.at(x, y) = 1;
      if (truth == nullptr) continue;
      const float* want = truth->radiance.pixel(x, y);
      const bool is_known =
          std::isfinite(want[0]) && std::isfinite(want[1]) && std::isfinite(want[2]);
      measurable.at(x, y) =
          is_known && *std::max_element(want, want + 3) <= high && Luminance(want) >= low ? 1 : 0;
    }
  }
  const Projection grid = Projection::Equirectangular(width, height);
  ViewScore score;
  const RadianceScore beside =
      ScoreRadiance(view.radiance, temporal->radiance, SphereArea(grid, in_both.view()));
  score.ssim = beside.ssim;
  score.rmse_temporal = beside.errors.log10_rmse;
  if (truth != nullptr) {
    const RadianceScore true_score =
        ScoreRadiance(view.radiance, truth->radiance, SphereArea(grid, measurable.view()));
    score.rmse_truth = true_score.errors.log10_rmse;
    score.ssim_truth = true_score.ssim;
  }
  return score;
}

Result<std::optional<DisparityErrors>> Bench::ScoreDisparity(int position,
                                                             const Image<float>& disparity,
                                                             double baseline) {
  OMNIHDR_ASSIGN(const Reference::Picture* truth, Truth(position));
  if (truth == nullptr || truth->disparity.empty() || disparity.empty() || !(baseline > 0.0)) {
    return std::optional<DisparityErrors>();
  }
  // Where the camera sees something.
  const std::array<int, 1> own = {matrix_->middle()};
  OMNIHDR_ASSIGN(const MergedView* seen, Temporal(position, own));
  Image<std::uint8_t> area(disparity.width(), disparity.height());
  for (int y = 0; y < area.height(); ++y) {
    for (int x = 0; x < area.width(); ++x) {
      area.at(x, y) = seen->origin.at(x, y) != kUnseen ? 1 : 0;
    }
  }
  const Projection grid = Projection::Equirectangular(disparity.width(), disparity.height());
  return std::optional(
      CompareDisparity(disparity, truth->disparity, baseline, SphereArea(grid, area.view())));
}

RadianceRange Bench::MeasuredRange(const MergedView& view, const MergedView& seen_by) {
  Image<std::uint8_t> counted(view.origin.width(), view.origin.height());
  for (int y = 0; y < counted.height(); ++y) {
    for (int x = 0; x < counted.width(); ++x) {
      counted.at(x, y) =
          view.origin.at(x, y) == static_cast<std::uint8_t>(PixelOrigin::kMeasured) &&
                  seen_by.origin.at(x, y) != kUnseen
              ? 1
              : 0;
    }
  }
  return RangeOfRadiance(view.radiance, counted);
}

}  // namespace omnihdr::experiments
