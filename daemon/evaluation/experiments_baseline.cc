#include <algorithm>
#include <cmath>
#include <memory>

#include "core/base/units.h"
#include "core/stereo/fuse.h"
#include "core/stereo/pairwise_costs.h"
#include "core/stereo/sgm.h"
#include "core/stereo/view_merge.h"
#include "daemon/evaluation/experiments_parts.h"
#include "daemon/evaluation/false_colour.h"

namespace omnihdr::experiments {
namespace {

constexpr int kLength = 6;       // positions of the sequence
constexpr int kApart = 3;        // after so many a saw tooth of three has the same exposure again
constexpr int kWideSpacing = 2;  // positions between those of the thinned sequence

// A frame of the sequence, ready to be matched.
struct MatchedFrame {
  Measurement measurement;
  Pose pose;
  double nearest = 0.0;  // inverse distance of the nearest points seen
  StereoView stereo;
};

Eigen::Vector3f Offset(const MatchedFrame& from, const MatchedFrame& to) {
  return (to.pose.translation - from.pose.translation).cast<float>();
}

Result<std::vector<MatchedFrame>> PrepareFrames(Bench& bench, const Sequence& sequence,
                                                const std::vector<FinishedView>& views,
                                                const PipelineOptions& options) {
  std::vector<MatchedFrame> frames;
  float floor = 0.0F;
  float brightest = 0.0F;
  for (std::size_t i = 0; i < sequence.positions.size(); ++i) {
    MatchedFrame frame;
    const std::array<int, 1> exposure = {sequence.exposures[i]};
    OMNIHDR_ASSIGN(frame.measurement,
                   bench.matrix().Measure(sequence.positions[i], exposure, options));
    frame.pose = views[i].pose.world_from_camera;
    frame.nearest = views[i].pose.max_inverse_distance;
    const Measurement& m = frame.measurement;
    floor = floor == 0.0F ? m.noise_floor : std::min(floor, m.noise_floor);
    brightest = std::max(brightest, *std::max_element(m.saturation.begin(), m.saturation.end()));
    frames.push_back(std::move(frame));
  }
  const LogScale scale = LogScale::For(floor, brightest);
  for (MatchedFrame& frame : frames) {
    frame.stereo =
        MakeStereoView(frame.measurement, frame.pose.rotation, 2 * options.stereo_width, scale);
  }
  return frames;
}

// A frame's disparity from those partners alone, and theirs from it, fused and filled: the
// pipeline's parts with chosen neighbours.
DisparityMap MatchWith(const std::vector<MatchedFrame>& frames, std::size_t reference,
                       const std::vector<std::size_t>& partners, const SweepOptions& sweep,
                       const Image<std::uint8_t>& brightness, const PipelineOptions& options) {
  const auto match = [&](std::size_t own, const std::vector<std::size_t>& others) {
    std::vector<SweepNeighbour> neighbours;
    for (const std::size_t n : others) {
      neighbours.push_back({&frames[n].stereo, Offset(frames[own], frames[n])});
    }
    const StereoView& view = frames[own].stereo;
    return OptimiseSemiGlobal(MatchingCosts(options.cost, view, neighbours, sweep), view,
                              SgmOptions{});
  };
  const DisparityMap own = match(reference, partners);
  std::vector<DisparityMap> maps;
  for (const std::size_t n : partners) maps.push_back(match(n, {reference}));
  std::vector<NeighbourMap> neighbours;
  for (std::size_t k = 0; k < partners.size(); ++k) {
    neighbours.push_back({&maps[k], Offset(frames[reference], frames[partners[k]])});
  }
  FuseOptions fuse;
  fuse.tolerance = 1.5 * sweep.max_disparity / (sweep.labels - 1);
  DisparityMap fused = FuseDisparity(own, neighbours, fuse);
  FillHoles(brightness, FillOptions{}, &fused);
  return fused;
}

struct BaselineRow {
  ViewScore score;
  std::optional<double> bad1;
};

// Means over the positions; a share in percent.
struct BaselineMean {
  double ssim = 0.0;
  double rmse = 0.0;
  double bad1 = 0.0;
  int count = 0;
  bool has_truth = true;
  bool has_bad1 = true;
  void Add(const BaselineRow& row) {
    ++count;
    ssim += row.score.ssim;
    rmse += row.score.rmse_truth.value_or(0.0);
    bad1 += row.bad1.value_or(0.0);
    has_truth = has_truth && row.score.rmse_truth.has_value();
    has_bad1 = has_bad1 && row.bad1.has_value();
  }
  std::vector<Cell> Cells() const {
    return {Number(ssim / count, 3),
            Number(has_truth ? std::optional(rmse / count) : std::nullopt, 4),
            Number(has_bad1 ? std::optional(100.0 * bad1 / count) : std::nullopt, 1)};
  }
};

std::vector<Cell> CellsOf(const BaselineRow& row) {
  return {Number(row.score.ssim, 3), Number(row.score.rmse_truth, 4),
          Number(row.bad1 ? std::optional(100.0 * *row.bad1) : std::nullopt, 1)};
}

// Every second position with the whole pipeline, against every one.
Status ThinnedSequence(Bench& bench, const Steps& steps, Section* section) {
  const std::array<int, 3> bracket = steps.all();
  Sequence thinned;
  for (int position = 0; position < bench.matrix().positions(); position += kWideSpacing) {
    thinned.positions.push_back(position);
  }
  if (thinned.positions.size() < 3) return {};
  thinned.exposures = OrderedExposures(steps, Order::kSawTooth, thinned.positions.size());
  Table table;
  table.title = "The whole pipeline at every position, and at every second one";
  table.columns = {"positions taken", "exposures", "means of positions", "SSIM to temporal HDR",
                   "RMSE to truth"};
  for (const Sequence& sequence :
       {DrawSequence(bench, steps, Order::kSawTooth, kLength), thinned}) {
    OMNIHDR_ASSIGN(const std::vector<FinishedView>* views, bench.Views(sequence, Method::kOurs));
    BaselineMean mean;
    std::vector<int> scored;
    for (std::size_t i = 1; i + 1 < sequence.positions.size(); ++i) {
      BaselineRow row;
      OMNIHDR_ASSIGN(row.score, bench.Score(sequence.positions[i], bracket, (*views)[i].merged));
      mean.Add(row);
      scored.push_back(sequence.positions[i]);
    }
    const std::vector<Cell> cells = mean.Cells();
    table.rows.push_back({Words(fmt::format("{}", fmt::join(sequence.positions, ", "))),
                          Words(Numbered(sequence.exposures)),
                          Words(fmt::format("{}", fmt::join(scored, ", "))), cells[0], cells[1]});
  }
  section->tables.push_back(std::move(table));
  return {};
}

}  // namespace

Status RunBaseline(const Benches& benches, const std::filesystem::path& out, Section* section) {
  Bench& bench = *benches.indoor;
  std::string why_not;
  const std::optional<Steps> steps = bench.StepsOf(1.6, &why_not);
  if (!steps) {
    section->notes.push_back(why_not);
    return {};
  }
  const Sequence sequence = DrawSequence(bench, *steps, Order::kSawTooth, kLength);
  const auto length = static_cast<int>(sequence.positions.size());
  if (length < kApart + 2) {
    section->notes.push_back(fmt::format(
        "{}: {} positions, expected {} or more for a position with neighbours and one {} further: "
        "not run",
        bench.place(), length, kApart + 2, kApart));
    return {};
  }
  OMNIHDR_ASSIGN(const std::vector<FinishedView>* views, bench.Views(sequence, Method::kOurs));
  for (const FinishedView& view : *views) {
    if (view.pose.chain == views->front().pose.chain && view.pose.has_baseline) continue;
    section->notes.push_back(fmt::format("{}: position {} could not be linked to the first: {}",
                                         bench.place(), Value(view.pose.position),
                                         view.pose.chain_reason));
    return {};
  }
  const PipelineOptions options = bench.OptionsOf(Method::kOurs);
  OMNIHDR_ASSIGN(const std::vector<MatchedFrame> frames,
                 PrepareFrames(bench, sequence, *views, options));
  const bool is_metric = views->front().pose.metric;
  const std::array<int, 3> bracket = steps->all();

  Table table;
  table.title = fmt::format("{}: disparity from other positions, pixels always from the two next",
                            Numbered(sequence.exposures));
  table.columns = {"position",      "disparity from",
                   "distance",      "SSIM to temporal HDR",
                   "RMSE to truth", "disparity off by more than a pixel, %"};
  std::array<BaselineMean, 3> means;
  std::vector<PictureRow> rows;
  for (int i = 1; i + 1 < length; ++i) {
    const auto own = static_cast<std::size_t>(i);
    const int partner = i + kApart < length ? i + kApart : i - kApart;
    if (partner < 0) continue;
    const MatchedFrame& reference = frames[own];
    const std::vector<std::size_t> next = {own - 1, own + 1};
    double next_distance = 0.0;
    double nearest = reference.nearest;
    for (const std::size_t n : next) {
      next_distance += 0.5 * static_cast<double>(Offset(reference, frames[n]).norm());
      nearest = std::max(nearest, frames[n].nearest);
    }
    // One range of distances for both, as the pipeline would search it for the nearer pair.
    SweepOptions sweep;
    sweep.labels = options.labels;
    sweep.max_disparity =
        std::sin(Radians::FromDegrees(options.max_parallax_deg).value()) / next_distance;
    if (nearest > 0.0) sweep.max_disparity = std::min(sweep.max_disparity, 1.6 * nearest);
    const Image<std::uint8_t> brightness = MapBrightness(reference.stereo);

    std::vector<MergeSource> others;
    for (const std::size_t n : next)
      others.push_back({&frames[n].measurement, frames[n].pose, nullptr});
    MergeOptions merge;
    merge.consistency_log10 = static_cast<float>(options.consistency_sigma);
    merge.refine_exposure = false;

    const std::array<std::vector<std::size_t>, 2> from = {
        next, std::vector<std::size_t>{static_cast<std::size_t>(partner)}};
    PictureRow row;
    row.label = fmt::format("position {}, exposure #{}", i, sequence.exposures[own]);
    OMNIHDR_ASSIGN(const MergedView* temporal, bench.Temporal(i, bracket));
    row.pictures.push_back(Shown(*temporal));
    std::array<Image<float>, 2> disparities;
    for (std::size_t k = 0; k < 2; ++k) {
      const DisparityMap map = MatchWith(frames, own, from[k], sweep, brightness, options);
      MergedView view = MergeViews({&reference.measurement, reference.pose, nullptr}, &map, others,
                                   reference.pose.rotation, bench.matrix().output_width(), merge);
      BaselineRow result;
      OMNIHDR_ASSIGN(result.score, bench.Score(i, bracket, view));
      if (is_metric) {
        OMNIHDR_ASSIGN(const std::optional<DisparityErrors> errors,
                       bench.ScoreDisparity(i, view.disparity, next_distance));
        if (errors) result.bad1 = errors->bad1;
      }
      means[k].Add(result);
      std::vector<Cell> cells = {
          Number(i, 0),
          Words(k == 0 ? fmt::format("{} and {}, other exposures", i - 1, i + 1)
                       : fmt::format("{}, the same exposure", partner)),
          Number(k == 0 ? next_distance
                        : static_cast<double>(
                              Offset(reference, frames[static_cast<std::size_t>(partner)]).norm()),
                 2)};
      for (Cell& cell : CellsOf(result)) cells.push_back(std::move(cell));
      table.rows.push_back(std::move(cells));
      row.pictures.push_back(Shown(view));
      disparities[k] = std::move(view.disparity);
    }
    BaselineRow whole;
    const MergedView& pipeline = (*views)[own].merged;
    OMNIHDR_ASSIGN(whole.score, bench.Score(i, bracket, pipeline));
    if (is_metric) {
      OMNIHDR_ASSIGN(const std::optional<DisparityErrors> errors,
                     bench.ScoreDisparity(i, pipeline.disparity, next_distance));
      if (errors) whole.bad1 = errors->bad1;
    }
    means[2].Add(whole);
    const double near = NearDisparity(disparities[0]);
    for (const Image<float>& disparity : disparities) {
      row.pictures.push_back(DisparityColours(disparity, near));
    }
    rows.push_back(std::move(row));
  }
  const std::array<const char*, 3> names = {"mean, the next positions",
                                            "mean, same exposure three positions apart",
                                            "mean, the pipeline (four neighbours)"};
  for (std::size_t k = 0; k < 3; ++k) {
    std::vector<Cell> cells = {Words(names[k]), Words("-"), Words("-")};
    for (Cell& cell : means[k].Cells()) cells.push_back(std::move(cell));
    table.rows.push_back(std::move(cells));
  }
  const auto said = [](const BaselineMean& mean) {
    const std::vector<Cell> cells = mean.Cells();
    return fmt::format("SSIM {}, RMSE {}, {} % of disparity off", cells[0].text, cells[1].text,
                       cells[2].text);
  };
  section->found = fmt::format("next positions: {}; same exposure three apart: {}; pipeline: {}",
                               said(means[0]), said(means[1]), said(means[2]));
  section->tables.push_back(std::move(table));
  if (!is_metric) {
    section->notes.emplace_back(
        "The session has no odometer: lengths are in units of the first baseline and disparity is "
        "not compared with the truth.");
  }
  OMNIHDR_TRY(ThinnedSequence(bench, *steps, section));
  OMNIHDR_TRY(WritePictures(
      out / "baseline.png",
      {"temporal HDR", "HDR, disparity of the next positions", "HDR, same exposure three apart",
       "disparity, next positions", "disparity, three apart"},
      rows));
  section->figures.push_back(
      {"baseline.png", "Disparity from near and from far partners (thesis fig. 6.14)"});
  return {};
}

}  // namespace omnihdr::experiments
