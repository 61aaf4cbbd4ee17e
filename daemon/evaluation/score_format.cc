#include <algorithm>
#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>
#include <utility>

#include "daemon/evaluation/evaluation.h"

namespace omnihdr {
namespace {

using Json = nlohmann::ordered_json;

Json Number(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }
Json Number(const std::optional<double>& value) { return value ? Number(*value) : Json(nullptr); }

// A column of the table: two lines of heading, a number a position and one for the last line.
struct Column {
  const char* group;
  const char* heading;
  int decimals;
  std::function<std::optional<double>(const PositionScore&)> value;
  std::optional<double> mean;
};

std::string Cell(const std::optional<double>& value, int decimals) {
  return value && !std::isnan(*value) ? fmt::format("{:.{}f}", *value, decimals) : "-";
}

template <typename Score>
std::function<std::optional<double>(const PositionScore&)> Of(
    std::optional<Score> PositionScore::*score, double (*number)(const Score&)) {
  return [score, number](const PositionScore& p) {
    return p.*score ? std::optional(number(*(p.*score))) : std::nullopt;
  };
}

std::optional<double> Percent(std::optional<double> share) {
  if (share) *share *= 100.0;
  return share;
}

std::vector<Column> Columns(const SessionScore& score) {
  using R = const RadianceScore&;
  using D = const DisparityErrors&;
  using P = const PoseErrors&;
  const auto mean = [&](double SessionScore::Mean::*member) {
    return score.mean ? std::optional((*score.mean).*member) : std::nullopt;
  };
  const auto mean_or_none = [&](std::optional<double> SessionScore::Mean::*member) {
    return score.mean ? (*score.mean).*member : std::nullopt;
  };
  using Mean = SessionScore::Mean;
  const auto view = &PositionScore::view;
  const auto own = &PositionScore::own_frame;
  std::optional<double> seconds;
  for (const PositionScore& p : score.positions) {
    if (p.seconds) seconds = seconds.value_or(0.0) + *p.seconds;
  }
  if (seconds) *seconds /= static_cast<double>(score.complete);
  return {
      {"exposure", "s", 5, [](const PositionScore& p) { return p.exposure.time.seconds(); }, {}},
      {"frames",
       "used",
       0,
       [](const PositionScore& p) { return static_cast<double>(p.frames); },
       {}},
      {"valid", "%", 1, [](const PositionScore& p) { return 100.0 * p.valid_fraction; }, {}},
      {"RMSE", "view", 4,
       Of(
           view, +[](R r) { return r.errors.log10_rmse; }),
       mean(&Mean::view_rmse)},
      {"RMSE", "own", 4,
       Of(
           own, +[](R r) { return r.errors.log10_rmse; }),
       mean(&Mean::own_rmse)},
      {"change", "%", 1,
       [](const PositionScore& p) {
         return p.view ? std::optional(
                             100.0 *
                             (p.view->errors.log10_rmse / p.own_frame->errors.log10_rmse - 1.0))
                       : std::nullopt;
       },
       score.mean ? std::optional(-100.0 * score.improvement()) : std::nullopt},
      {"p95", "view", 3,
       Of(
           view, +[](R r) { return r.errors.log10_p95; }),
       mean(&Mean::view_p95)},
      {"p95", "own", 3,
       Of(
           own, +[](R r) { return r.errors.log10_p95; }),
       mean(&Mean::own_p95)},
      {"SSIM", "view", 3,
       Of(
           view, +[](R r) { return r.ssim; }),
       mean(&Mean::view_ssim)},
      {"SSIM", "own", 3,
       Of(
           own, +[](R r) { return r.ssim; }),
       mean(&Mean::own_ssim)},
      {"covered", "%", 1,
       [](const PositionScore& p) {
         return p.view ? std::optional(100.0 * p.covered) : std::nullopt;
       },
       Percent(mean(&Mean::covered))},
      {"range", "%", 1,
       [](const PositionScore& p) {
         return p.view ? std::optional(100.0 * p.range_share) : std::nullopt;
       },
       Percent(mean(&Mean::range_share))},
      {"movers", "off %", 2,
       Of(
           &PositionScore::movers, +[](const MoverScore& m) { return 100.0 * m.view.share_off; }),
       Percent(mean_or_none(&Mean::movers_off))},
      {"movers", "own %", 2,
       Of(
           &PositionScore::movers,
           +[](const MoverScore& m) { return 100.0 * m.own_frame.share_off; }),
       Percent(mean_or_none(&Mean::movers_own_off))},
      {"seams", "noise", 3,
       Of(
           &PositionScore::seams, +[](const SeamErrors& s) { return s.excess_noise; }),
       mean_or_none(&Mean::seam_noise)},
      {"disparity", "bad1 %", 1,
       Of(
           &PositionScore::disparity, +[](D d) { return 100.0 * d.bad1; }),
       Percent(mean_or_none(&Mean::disparity_bad1))},
      {"disparity", "median %", 2,
       Of(
           &PositionScore::disparity, +[](D d) { return 100.0 * d.median_relative; }),
       Percent(mean_or_none(&Mean::disparity_relative))},
      {"pose", "deg", 3,
       Of(
           &PositionScore::pose, +[](P e) { return e.rotation_deg; }),
       mean_or_none(&Mean::rotation_deg)},
      {"pose", "trans %", 2,
       Of(
           &PositionScore::pose, +[](P e) { return e.translation_percent; }),
       mean_or_none(&Mean::translation_percent)},
      {"time", "s", 2, [](const PositionScore& p) { return p.seconds; }, seconds},
  };
}

Json RadianceJson(const RadianceScore& score) {
  return {{"log10_rmse", Number(score.errors.log10_rmse)},
          {"log10_p95", Number(score.errors.log10_p95)},
          {"log10_rmse_unscaled", Number(score.errors.log10_rmse_unscaled)},
          {"scale", Number(score.errors.scale)},
          {"ssim", Number(score.ssim)},
          {"psnr_mu", Number(score.psnr_mu)}};
}

}  // namespace

std::string FormatScoreTable(const SessionScore& score) {
  std::string out;
  if (score.mean) {
    out += fmt::format(
        "Against: {}. RMSE and p95 are of log10 luminance, after one factor a picture; \"own\" is "
        "the\n"
        "position's own frame alone. Only what the bracket can measure is compared.\n",
        score.reference);
    if (score.mean->movers_off) {
      out +=
          "Movers: share of the area they touch that is off by more than 0.3 in log10 from what "
          "it may show.\n";
    }
    if (score.mean->seam_noise) {
      out += "Seams: step where the views merged change, beyond that beside it, in pixel noise.\n";
    }
    out += "\n";
  }
  // Columns in which nothing is known are left out.
  std::vector<std::vector<std::string>> lines(score.positions.size() + 3);
  lines[0] = {"position"};
  lines[1] = {""};
  for (std::size_t i = 0; i < score.positions.size(); ++i) {
    lines[i + 2] = {fmt::format("{}", Value(score.positions[i].position))};
  }
  lines.back() = {"mean"};
  for (const Column& column : Columns(score)) {
    bool known = false;
    std::vector<std::string> cells;
    for (const PositionScore& p : score.positions) {
      cells.push_back(Cell(p.complete ? column.value(p) : std::nullopt, column.decimals));
      known |= cells.back() != "-";
    }
    if (!known) continue;
    lines[0].emplace_back(column.group);
    lines[1].emplace_back(column.heading);
    for (std::size_t i = 0; i < cells.size(); ++i) lines[i + 2].push_back(std::move(cells[i]));
    lines.back().push_back(column.mean ? Cell(column.mean, column.decimals) : "");
  }
  if (!score.mean) lines.pop_back();
  std::vector<std::size_t> widths(lines[0].size(), 0);
  for (const auto& line : lines) {
    for (std::size_t i = 0; i < line.size(); ++i) widths[i] = std::max(widths[i], line[i].size());
  }
  for (std::size_t row = 0; row < lines.size(); ++row) {
    const PositionScore* p =
        row >= 2 && row < score.positions.size() + 2 ? &score.positions[row - 2] : nullptr;
    std::string line;
    for (std::size_t i = 0; i < lines[row].size(); ++i) {
      line += fmt::format("{:>{}}", lines[row][i], widths[i] + (i == 0 ? 0 : 2));
    }
    if (p != nullptr && !p->complete) {
      line += p->status == FrameStatus::kOk
                  ? "  no view"
                  : fmt::format("  no view: frame is {}", ToString(p->status));
    }
    out += line + "\n";
  }
  if (score.mean && score.mean->rotation_deg) out += "(of the poses not the mean: the largest)\n";
  if (!score.reliability.empty()) {
    out += fmt::format("disparity called right with ... and right in, %: {}\n",
                       FormatReliability(score.reliability));
  }
  for (const PositionScore& p : score.positions) {
    for (const std::string& warning : p.warnings) {
      out += fmt::format("position {}: {}\n", Value(p.position), warning);
    }
  }
  out +=
      fmt::format("{} of {} positions have their view\n", score.complete, score.positions.size());
  return out;
}

std::string FormatReliability(const ReliabilityCurve& reliability) {
  std::string out;
  double total = 0.0;
  for (const ReliabilityCurve::Bin& bin : reliability.Bins()) total += bin.weight;
  for (const ReliabilityCurve::Bin& bin : reliability.Bins()) {
    if (bin.weight < 1e-3 * total) continue;
    out += fmt::format("{}{:.0f} -> {:.0f}", out.empty() ? "" : ", ", 100.0 * bin.confidence,
                       100.0 * bin.right);
  }
  return fmt::format("{} (mean gap {:.1f})", out, 100.0 * reliability.CalibrationError());
}

Plot ReliabilityPlot(const ReliabilityCurve& reliability) {
  Plot plot;
  plot.title = "Confidence of the disparity";
  plot.x_label = "called right";
  plot.y_label = "share that is right";
  PlotSeries diagonal;
  diagonal.name = "perfect";
  diagonal.colour = {170, 170, 170};
  diagonal.x = diagonal.y = {0.0, 1.0};
  PlotSeries ours;
  ours.name = "ours";
  ours.colour = {200, 60, 30};
  PlotSeries dots;
  dots.colour = ours.colour;
  dots.dots = true;
  for (const ReliabilityCurve::Bin& bin : reliability.Bins()) {
    if (bin.weight <= 0.0) continue;
    for (PlotSeries* series : {&ours, &dots}) {
      series->x.push_back(bin.confidence);
      series->y.push_back(bin.right);
    }
  }
  plot.series = {std::move(diagonal), std::move(ours), std::move(dots)};
  return plot;
}

std::string FormatScoreJson(const SessionScore& score) {
  Json positions = Json::array();
  for (const PositionScore& p : score.positions) {
    Json item = {{"position", Value(p.position)},
                 {"exposure_s", p.exposure.time.seconds()},
                 {"status", ToString(p.status)},
                 {"complete", p.complete},
                 {"frames", p.frames},
                 {"chain", p.chain},
                 {"valid_fraction", Number(p.valid_fraction)},
                 {"seconds", Number(p.seconds)},
                 {"warnings", p.warnings}};
    if (p.view) {
      item["view"] = RadianceJson(*p.view);
      item["own_frame"] = RadianceJson(*p.own_frame);
      item["covered"] = Number(p.covered);
      item["range_share"] = Number(p.range_share);
    }
    if (p.movers) {
      item["movers"] = {{"mode", p.movers->removes ? "remove" : "keep"},
                        {"share_off", Number(p.movers->view.share_off)},
                        {"own_share_off", Number(p.movers->own_frame.share_off)},
                        {"area_sr", Number(p.movers->view.weight)},
                        {"pixels", p.movers->view.pixels}};
    }
    if (p.seams) {
      item["seams"] = {{"borders", p.seams->borders},
                       {"excess_noise", Number(p.seams->excess_noise)},
                       {"excess_log10", Number(p.seams->excess_log10)},
                       {"visible", Number(p.seams->visible)}};
    }
    if (p.disparity) {
      item["disparity"] = {{"bad1", Number(p.disparity->bad1)},
                           {"bad1_of_known", Number(p.disparity->bad1_of_known)},
                           {"unknown", Number(p.disparity->unknown)},
                           {"median_relative", Number(p.disparity->median_relative)}};
    }
    if (p.pose) {
      item["pose"] = {{"rotation_deg", Number(p.pose->rotation_deg)},
                      {"translation_percent", Number(p.pose->translation_percent)}};
    }
    positions.push_back(std::move(item));
  }
  Json json = {{"reference", score.reference.empty() ? Json(nullptr) : Json(score.reference)},
               {"complete", score.complete},
               {"positions", std::move(positions)}};
  if (!score.reliability.empty()) {
    Json bins = Json::array();
    for (const ReliabilityCurve::Bin& bin : score.reliability.Bins()) {
      bins.push_back({{"weight", Number(bin.weight)},
                      {"confidence", Number(bin.confidence)},
                      {"right", Number(bin.right)}});
    }
    json["reliability"] = {{"calibration_error", Number(score.reliability.CalibrationError())},
                           {"bins", std::move(bins)}};
  }
  if (score.mean) {
    const SessionScore::Mean& m = *score.mean;
    json["mean"] = {{"positions", m.positions},
                    {"view_log10_rmse", Number(m.view_rmse)},
                    {"own_log10_rmse", Number(m.own_rmse)},
                    {"improvement", Number(score.improvement())},
                    {"view_log10_p95", Number(m.view_p95)},
                    {"own_log10_p95", Number(m.own_p95)},
                    {"view_ssim", Number(m.view_ssim)},
                    {"own_ssim", Number(m.own_ssim)},
                    {"view_psnr_mu", Number(m.view_psnr_mu)},
                    {"own_psnr_mu", Number(m.own_psnr_mu)},
                    {"covered", Number(m.covered)},
                    {"range_share", Number(m.range_share)},
                    {"movers_share_off", Number(m.movers_off)},
                    {"movers_own_share_off", Number(m.movers_own_off)},
                    {"seam_excess_noise", Number(m.seam_noise)},
                    {"seam_excess_log10", Number(m.seam_log10)},
                    {"disparity_bad1", Number(m.disparity_bad1)},
                    {"disparity_median_relative", Number(m.disparity_relative)},
                    {"largest_rotation_deg", Number(m.rotation_deg)},
                    {"largest_translation_percent", Number(m.translation_percent)}};
  }
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace omnihdr
