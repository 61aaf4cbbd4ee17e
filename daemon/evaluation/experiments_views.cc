#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/photometry/tonemap.h"
#include "daemon/evaluation/experiments_parts.h"

namespace omnihdr::experiments {
namespace {

constexpr int kSequencePositions = 6;  // as many as the thesis draws indoors
constexpr int kOutdoorPositions = 8;

std::vector<double> PositionsOf(const std::vector<JudgedView>& judged) {
  std::vector<double> positions;
  for (const JudgedView& view : judged) positions.push_back(view.position);
  return positions;
}

PlotSeries SsimCurve(const std::string& name, std::size_t colour,
                     const std::vector<JudgedView>& judged, bool thesis_parts) {
  std::vector<double> ssim;
  for (const JudgedView& view : judged) {
    ssim.push_back(!thesis_parts       ? view.ours.ssim
                   : view.thesis_parts ? view.thesis_parts->ssim
                                       : std::numeric_limits<double>::quiet_NaN());
  }
  return Curve(name, colour, PositionsOf(judged), std::move(ssim));
}

PlotSeries ThesisDots(const std::string& name, std::size_t colour,
                      const std::map<int, double>& ssim) {
  std::vector<double> x;
  std::vector<double> y;
  for (const auto& [position, value] : ssim) {
    x.push_back(position);
    y.push_back(value);
  }
  return Curve(name, colour, std::move(x), std::move(y), true);
}

std::string Words3(std::optional<double> value) { return Number(value, 3).text; }
std::string Words4(std::optional<double> value) { return Number(value, 4).text; }

// Which of the wanted positions a sequence has.
std::vector<int> Within(const std::vector<int>& wanted, const Sequence& sequence) {
  std::vector<int> there;
  for (const int position : wanted) {
    if (position < static_cast<int>(sequence.positions.size())) there.push_back(position);
  }
  return there;
}

void NoteMissingMethod(const Bench& bench, Section* section) {
  if (bench.HasMethod(Method::kThesis)) return;
  section->notes.push_back(fmt::format(
      "{}: the thesis's parts are not run: their hat weights cannot take the raw frames of a rig",
      bench.place()));
}

struct RangeRow {
  RadianceRange frame;
  RadianceRange spatiotemporal;
  RadianceRange temporal;
};

Plot RangePlot(const std::string& title, const std::vector<RangeRow>& rows) {
  constexpr double kBreak = std::numeric_limits<double>::quiet_NaN();
  Plot plot;
  plot.title = title;
  plot.x_label = "relative radiance, 0.1 to 99.9 % of the pixels";
  plot.y_label = "position";
  plot.log_x = true;
  const auto add = [&](const char* name, std::size_t colour, double shift, auto member) {
    PlotSeries series = Curve(name, colour, {}, {});
    for (std::size_t k = 0; k < rows.size(); ++k) {
      const RadianceRange& range = rows[k].*member;
      series.x.insert(series.x.end(), {range.low, range.high, kBreak});
      const double y = static_cast<double>(k + 1) + shift;
      series.y.insert(series.y.end(), {y, y, kBreak});
    }
    plot.series.push_back(std::move(series));
  };
  add("own frame", 0, -0.15, &RangeRow::frame);
  add("spatiotemporal HDR", 2, 0.0, &RangeRow::spatiotemporal);
  add("temporal HDR", 1, 0.15, &RangeRow::temporal);
  return plot;
}

}  // namespace

std::vector<Bench*> Benches::all() const {
  std::vector<Bench*> each;
  if (indoor != nullptr) each.push_back(indoor);
  if (outdoor != nullptr && outdoor != indoor) each.push_back(outdoor);
  return each;
}

Sequence DrawSequence(const Bench& bench, const Steps& steps, Order order, int count) {
  Sequence sequence;
  sequence.positions.resize(static_cast<std::size_t>(std::min(count, bench.matrix().positions())));
  std::iota(sequence.positions.begin(), sequence.positions.end(), 0);
  sequence.exposures = OrderedExposures(steps, order, sequence.positions.size());
  return sequence;
}

Image<std::uint8_t> Shown(const MergedView& view) {
  ToneMapOptions options;
  options.shape = PictureShape::kSphere;
  return ToneMap(view.radiance, options);
}

Image<std::uint8_t> ShownFrame(const MergedView& alone, double exposure_s) {
  Image<std::uint8_t> picture(alone.radiance.width(), alone.radiance.height(), 3);
  const auto scale = static_cast<float>(exposure_s * 128.0 / 255.0);
  for (std::size_t i = 0; i < picture.size(); ++i) {
    picture.data()[i] = EncodeSrgb(alone.radiance.data()[i] * scale);
  }
  return picture;
}

std::string Numbered(int exposure) { return fmt::format("#{}", exposure); }

std::string Numbered(const std::vector<int>& exposures) {
  std::string text;
  for (const int exposure : exposures)
    text += (text.empty() ? "#" : ", #") + std::to_string(exposure);
  return text;
}

Result<std::vector<JudgedView>> Judge(Bench& bench, const Sequence& sequence, const Steps& steps) {
  const std::array<int, 3> bracket = steps.all();
  OMNIHDR_ASSIGN(const std::vector<FinishedView>* ours, bench.Views(sequence, Method::kOurs));
  const std::vector<FinishedView>* thesis_parts = nullptr;
  if (bench.HasMethod(Method::kThesis)) {
    OMNIHDR_ASSIGN(thesis_parts, bench.Views(sequence, Method::kThesis));
  }
  std::vector<JudgedView> judged;
  for (std::size_t i = 0; i < sequence.positions.size(); ++i) {
    JudgedView view;
    view.position = sequence.positions[i];
    view.exposure = sequence.exposures[i];
    OMNIHDR_ASSIGN(view.ours, bench.Score(view.position, bracket, (*ours)[i].merged));
    if (thesis_parts != nullptr) {
      OMNIHDR_ASSIGN(view.thesis_parts,
                     bench.Score(view.position, bracket, (*thesis_parts)[i].merged));
    }
    OMNIHDR_ASSIGN(const MergedView alone, bench.Alone(view.position, view.exposure));
    OMNIHDR_ASSIGN(view.own, bench.Score(view.position, bracket, alone));
    OMNIHDR_ASSIGN(const MergedView* temporal, bench.Temporal(view.position, bracket));
    OMNIHDR_ASSIGN(view.temporal, bench.Score(view.position, bracket, *temporal));
    judged.push_back(std::move(view));
  }
  return judged;
}

JudgedMean MeanOf(const std::vector<JudgedView>& judged) {
  // The ends have neighbours on one side only; the thesis leaves them out.
  std::size_t first = 0;
  std::size_t end = judged.size();
  if (judged.size() > 2) {
    first = 1;
    end = judged.size() - 1;
  }
  const auto mean = [&](const auto& value) -> std::optional<double> {
    double sum = 0.0;
    for (std::size_t i = first; i < end; ++i) {
      const std::optional<double> each = value(judged[i]);
      if (!each) return std::nullopt;
      sum += *each;
    }
    return sum / static_cast<double>(end - first);
  };
  using View = const JudgedView&;
  JudgedMean means;
  means.ours_ssim = *mean([](View v) { return std::optional(v.ours.ssim); });
  means.thesis_parts_ssim = mean(
      [](View v) { return v.thesis_parts ? std::optional(v.thesis_parts->ssim) : std::nullopt; });
  means.own_ssim = *mean([](View v) { return std::optional(v.own.ssim); });
  means.ours_rmse = mean([](View v) { return v.ours.rmse_truth; });
  means.thesis_parts_rmse = mean(
      [](View v) { return v.thesis_parts ? v.thesis_parts->rmse_truth : std::optional<double>(); });
  means.own_rmse = mean([](View v) { return v.own.rmse_truth; });
  means.temporal_rmse = mean([](View v) { return v.temporal.rmse_truth; });
  return means;
}

Table JudgedTable(const std::string& title, const std::vector<JudgedView>& judged,
                  const std::map<int, double>& thesis_ssim) {
  Table table;
  table.title = title;
  table.columns = {"position",
                   "exposure",
                   "SSIM in the thesis",
                   "SSIM ours",
                   "SSIM thesis's parts",
                   "SSIM own frame",
                   "RMSE to truth ours",
                   "RMSE to truth thesis's parts",
                   "RMSE to truth own frame",
                   "RMSE to truth temporal HDR"};
  for (const JudgedView& view : judged) {
    const auto thesis = thesis_ssim.find(view.position);
    table.rows.push_back(
        {Number(view.position, 0), Words(Numbered(view.exposure)),
         Number(thesis != thesis_ssim.end() ? std::optional(thesis->second) : std::nullopt, 2),
         Number(view.ours.ssim, 3),
         Number(view.thesis_parts ? std::optional(view.thesis_parts->ssim) : std::nullopt, 3),
         Number(view.own.ssim, 3), Number(view.ours.rmse_truth, 4),
         Number(view.thesis_parts ? view.thesis_parts->rmse_truth : std::nullopt, 4),
         Number(view.own.rmse_truth, 4), Number(view.temporal.rmse_truth, 4)});
  }
  std::optional<double> thesis_mean;
  for (const auto& [position, ssim] : thesis_ssim) {
    thesis_mean = thesis_mean.value_or(0.0) + ssim / static_cast<double>(thesis_ssim.size());
  }
  const JudgedMean mean = MeanOf(judged);
  table.rows.push_back({Words("mean, without the ends"), Words("-"), Number(thesis_mean, 2),
                        Number(mean.ours_ssim, 3), Number(mean.thesis_parts_ssim, 3),
                        Number(mean.own_ssim, 3), Number(mean.ours_rmse, 4),
                        Number(mean.thesis_parts_rmse, 4), Number(mean.own_rmse, 4),
                        Number(mean.temporal_rmse, 4)});
  return table;
}

Status WriteJudgedPictures(Bench& bench, const Sequence& sequence, const Steps& steps,
                           const std::vector<int>& positions, const std::filesystem::path& file) {
  const std::array<int, 3> bracket = steps.all();
  std::vector<std::string> titles = {"own frame", "temporal HDR", "spatiotemporal HDR, ours"};
  if (bench.HasMethod(Method::kThesis)) titles.emplace_back("spatiotemporal HDR, thesis's parts");
  std::vector<PictureRow> rows;
  for (const int position : positions) {
    const auto i = static_cast<std::size_t>(position);
    const int exposure = sequence.exposures[i];
    PictureRow row;
    row.label = fmt::format("position {}, exposure #{}", position, exposure);
    OMNIHDR_ASSIGN(const MergedView alone, bench.Alone(position, exposure));
    row.pictures.push_back(ShownFrame(alone, bench.matrix().Seconds(exposure)));
    OMNIHDR_ASSIGN(const MergedView* temporal, bench.Temporal(position, bracket));
    row.pictures.push_back(Shown(*temporal));
    OMNIHDR_ASSIGN(const std::vector<FinishedView>* ours, bench.Views(sequence, Method::kOurs));
    row.pictures.push_back(Shown((*ours)[i].merged));
    if (bench.HasMethod(Method::kThesis)) {
      OMNIHDR_ASSIGN(const std::vector<FinishedView>* parts,
                     bench.Views(sequence, Method::kThesis));
      row.pictures.push_back(Shown((*parts)[i].merged));
    }
    rows.push_back(std::move(row));
  }
  return WritePictures(file, titles, rows);
}

Status RunStep(const Benches& benches, const std::filesystem::path& out, Section* section) {
  Bench& bench = *benches.indoor;
  const std::map<double, std::map<int, double>> thesis = {{0.8, {{1, 0.86}, {2, 0.86}, {3, 0.87}}},
                                                          {1.6, {{1, 0.83}, {2, 0.80}}}};
  Plot plot;
  plot.title = "SSIM to the temporal HDR";
  plot.x_label = "position";
  plot.y_label = "SSIM";
  std::size_t colour = 0;
  for (const double stops : {0.8, 1.6}) {
    std::string why_not;
    const std::optional<Steps> steps = bench.StepsOf(stops, &why_not);
    if (!steps) {
      section->notes.push_back(why_not);
      continue;
    }
    const Sequence sequence = DrawSequence(bench, *steps, Order::kSawTooth, kSequencePositions);
    OMNIHDR_ASSIGN(const std::vector<JudgedView> judged, Judge(bench, sequence, *steps));
    const std::map<int, double>& quoted = thesis.at(stops);
    section->tables.push_back(JudgedTable(
        fmt::format("{} stops: {} repeated over positions 0 to {} ({:+.2f} and {:+.2f} stops from "
                    "the middle)",
                    stops, Numbered({steps->brief, steps->medium, steps->extended}),
                    sequence.positions.back(), bench.matrix().StopsFromMiddle(steps->brief),
                    bench.matrix().StopsFromMiddle(steps->extended)),
        judged, quoted));
    const JudgedMean mean = MeanOf(judged);
    section->found += fmt::format(
        "{}{} stops: SSIM {} (thesis's parts {}, own frame {}), RMSE to truth {} (thesis's parts "
        "{}, own frame {}, temporal {})",
        section->found.empty() ? "" : "; ", stops, Words3(mean.ours_ssim),
        Words3(mean.thesis_parts_ssim), Words3(mean.own_ssim), Words4(mean.ours_rmse),
        Words4(mean.thesis_parts_rmse), Words4(mean.own_rmse), Words4(mean.temporal_rmse));
    plot.series.push_back(SsimCurve(fmt::format("{} stops, ours", stops), colour, judged, false));
    if (bench.HasMethod(Method::kThesis)) {
      plot.series.push_back(
          SsimCurve(fmt::format("{} stops, thesis's parts", stops), colour + 2, judged, true));
    }
    plot.series.push_back(
        ThesisDots(fmt::format("{} stops, in the thesis", stops), colour + 4, quoted));
    ++colour;
    const std::string file = fmt::format("step-{:.1f}.png", stops);
    OMNIHDR_TRY(
        WriteJudgedPictures(bench, sequence, *steps, Within({1, 2, 3}, sequence), out / file));
    section->figures.push_back(
        {file, fmt::format("Steps of {} stops (thesis figs. 6.8 to 6.13)", stops)});
  }
  if (section->tables.empty()) return {};
  NoteMissingMethod(bench, section);
  OMNIHDR_TRY(WriteCurves(out / "step.png", {plot}));
  section->figures.push_back({"step.png", "SSIM by position"});
  return {};
}

Status RunOutdoor(const Benches& benches, const std::filesystem::path& out, Section* section) {
  Bench& bench = *benches.outdoor;
  std::string why_not;
  const std::optional<Steps> steps = bench.StepsOf(1.6, &why_not);
  if (!steps) {
    section->notes.push_back(why_not);
    return {};
  }
  const Sequence sequence = DrawSequence(bench, *steps, Order::kTriangle, kOutdoorPositions);
  OMNIHDR_ASSIGN(const std::vector<JudgedView> judged, Judge(bench, sequence, *steps));
  const std::map<int, double> quoted = {{4, 0.87}, {5, 0.91}, {6, 0.89}};
  section->tables.push_back(
      JudgedTable(fmt::format("{} over positions 0 to {}", Numbered(sequence.exposures),
                              sequence.positions.back()),
                  judged, quoted));
  Table others;
  others.title = "Methods without disparity, in the thesis's own runs (6.4); not run here";
  others.columns = {"method", "position 4, #2", "position 5, #7", "position 6, #12", "here"};
  others.rows = {{Words("Zhou 2014"), Number(0.87, 2), Number(0.91, 2), Number(0.89, 2),
                  Words("see the table above")},
                 {Words("Hu et al. 2013 (PatchMatch, exposure fusion)"), Number(0.88, 2),
                  Number(0.99, 2), Number(0.92, 2), Words("not run")},
                 {Words("Sen et al. 2012 (patch-based HDR)"), Number(0.79, 2), Number(0.99, 2),
                  Number(0.87, 2), Words("not run")}};
  section->tables.push_back(std::move(others));
  NoteMissingMethod(bench, section);
  section->notes.emplace_back(
      "The numbers of Hu et al. and Sen et al. are quoted from the thesis, on its front yard: each "
      "is the SSIM to the temporal HDR, with another frame as the method's reference at each "
      "position. This program has neither method.");
  const JudgedMean mean = MeanOf(judged);
  section->found = fmt::format(
      "{}: SSIM {} (thesis's parts {}, own frame {}), RMSE to truth {} (thesis's parts {}, own "
      "frame {}, temporal {})",
      bench.place(), Words3(mean.ours_ssim), Words3(mean.thesis_parts_ssim), Words3(mean.own_ssim),
      Words4(mean.ours_rmse), Words4(mean.thesis_parts_rmse), Words4(mean.own_rmse),
      Words4(mean.temporal_rmse));
  std::vector<int> shown = Within({4, 5, 6}, sequence);
  if (shown.empty()) shown = Within({0, 1, 2}, sequence);
  OMNIHDR_TRY(WriteJudgedPictures(bench, sequence, *steps, shown, out / "outdoor.png"));
  section->figures.push_back({"outdoor.png", "Positions 4 to 6 (thesis figs. 6.16 and 6.17)"});
  Plot plot;
  plot.title = "SSIM to the temporal HDR";
  plot.x_label = "position";
  plot.y_label = "SSIM";
  plot.series = {SsimCurve("ours", 0, judged, false), SsimCurve("thesis's parts", 2, judged, true),
                 ThesisDots("in the thesis", 1, quoted)};
  OMNIHDR_TRY(WriteCurves(out / "outdoor-ssim.png", {plot}));
  section->figures.push_back({"outdoor-ssim.png", "SSIM by position"});
  return {};
}

Status RunRange(const Benches& benches, const std::filesystem::path& out, Section* section) {
  Bench& bench = *benches.indoor;
  Table table;
  table.title = "Relative radiance measured, from 0.1 to 99.9 % of the pixels";
  table.columns = {"step",
                   "position",
                   "exposure",
                   "frame low",
                   "frame high",
                   "frame stops",
                   "spatiotemporal low",
                   "spatiotemporal high",
                   "spatiotemporal stops",
                   "temporal low",
                   "temporal high",
                   "temporal stops"};
  Table extremes;
  extremes.title = "The smallest and largest: single pixels";
  extremes.columns = {"step",        "position",           "exposure",           "frame min",
                      "frame max",   "spatiotemporal min", "spatiotemporal max", "temporal min",
                      "temporal max"};
  std::vector<Plot> plots;
  for (const double stops : {0.8, 1.6}) {
    std::string why_not;
    const std::optional<Steps> steps = bench.StepsOf(stops, &why_not);
    if (!steps) {
      section->notes.push_back(why_not);
      continue;
    }
    const std::array<int, 3> bracket = steps->all();
    const Sequence sequence = DrawSequence(bench, *steps, Order::kSawTooth, kSequencePositions);
    OMNIHDR_ASSIGN(const std::vector<FinishedView>* views, bench.Views(sequence, Method::kOurs));
    std::vector<RangeRow> rows;
    std::array<double, 3> sums = {};
    for (const int position : Within({1, 2, 3}, sequence)) {
      const auto i = static_cast<std::size_t>(position);
      RangeRow row;
      OMNIHDR_ASSIGN(const MergedView* temporal, bench.Temporal(position, bracket));
      OMNIHDR_ASSIGN(const MergedView alone, bench.Alone(position, sequence.exposures[i]));
      row.frame = Bench::MeasuredRange(alone, *temporal);
      row.spatiotemporal = Bench::MeasuredRange((*views)[i].merged, *temporal);
      row.temporal = Bench::MeasuredRange(*temporal, *temporal);
      std::vector<Cell> cells = {Number(stops, 1), Number(position, 0),
                                 Words(Numbered(sequence.exposures[i]))};
      const std::array<const RadianceRange*, 3> ranges = {&row.frame, &row.spatiotemporal,
                                                          &row.temporal};
      for (std::size_t k = 0; k < 3; ++k) {
        cells.push_back(Number(ranges[k]->low, 3));
        cells.push_back(Number(ranges[k]->high, 1));
        cells.push_back(Number(ranges[k]->Stops(), 2));
        sums[k] += ranges[k]->Stops();
      }
      table.rows.push_back(std::move(cells));
      extremes.rows.push_back({Number(stops, 1), Number(position, 0),
                               Words(Numbered(sequence.exposures[i])), Number(row.frame.min, 3),
                               Number(row.frame.max, 1), Number(row.spatiotemporal.min, 3),
                               Number(row.spatiotemporal.max, 1), Number(row.temporal.min, 3),
                               Number(row.temporal.max, 1)});
      rows.push_back(row);
    }
    const auto count = static_cast<double>(rows.size());
    section->found +=
        fmt::format("{}{} stops: frames {:.2f}, spatiotemporal {:.2f}, temporal {:.2f} stops",
                    section->found.empty() ? "" : "; ", stops, sums[0] / count, sums[1] / count,
                    sums[2] / count);
    plots.push_back(RangePlot(fmt::format("steps of {} stops", stops), rows));
  }
  if (plots.empty()) return {};
  section->tables.push_back(std::move(table));
  section->tables.push_back(std::move(extremes));
  OMNIHDR_TRY(WriteCurves(out / "range.png", plots));
  section->figures.push_back({"range.png", "What single frames and both kinds of HDR measure"});
  return {};
}

}  // namespace omnihdr::experiments
