#include <cmath>
#include <functional>
#include <nlohmann/json.hpp>
#include <optional>

#include "daemon/evaluation/suite.h"

namespace omnihdr {
namespace {

using Json = nlohmann::ordered_json;
using Mean = SessionScore::Mean;

std::string Cell(std::optional<double> value, int decimals) {
  return value && std::isfinite(*value) ? fmt::format("{:.{}f}", *value, decimals) : "-";
}

std::optional<double> Of(const SessionScore& score, double Mean::*member) {
  return score.mean ? std::optional((*score.mean).*member) : std::nullopt;
}

struct Column {
  const char* group;
  const char* heading;
  std::function<std::string(const SuiteScore&)> cell;
};

std::vector<Column> Columns() {
  const auto number = [](int decimals, auto value) {
    return [decimals, value](const SuiteScore& s) { return Cell(value(s), decimals); };
  };
  using S = const SuiteScore&;
  return {
      {"", "case", [](S s) { return s.drive.name; }},
      {"RMSE", "ours", number(4, [](S s) { return Of(s.ours, &Mean::view_rmse); })},
      {"", "oracle", number(4, [](S s) { return Of(s.oracle, &Mean::view_rmse); })},
      {"", "ratio", number(2, [](S s) { return std::optional(s.OracleRatio()); })},
      {"", "thesis", number(4, [](S s) { return Of(s.thesis, &Mean::view_rmse); })},
      {"", "own", number(4, [](S s) { return Of(s.ours, &Mean::own_rmse); })},
      {"", "unreg.", number(4, [](S s) { return Of(s.unregistered, &Mean::view_rmse); })},
      {"p95", "ours", number(3, [](S s) { return Of(s.ours, &Mean::view_p95); })},
      {"", "oracle", number(3, [](S s) { return Of(s.oracle, &Mean::view_p95); })},
      {"SSIM", "ours", number(3, [](S s) { return Of(s.ours, &Mean::view_ssim); })},
      {"", "own", number(3, [](S s) { return Of(s.ours, &Mean::own_ssim); })},
      {"bad1", "ours",
       number(3, [](S s) { return s.ours.mean ? s.ours.mean->disparity_bad1 : std::nullopt; })},
      {"", "thesis",
       number(3, [](S s) { return s.thesis.mean ? s.thesis.mean->disparity_bad1 : std::nullopt; })},
      {"pose", "deg",
       number(3, [](S s) { return s.ours.mean ? s.ours.mean->rotation_deg : std::nullopt; })},
      {"", "%",
       number(2,
              [](S s) { return s.ours.mean ? s.ours.mean->translation_percent : std::nullopt; })},
      {"range", "share", number(3, [](S s) { return Of(s.ours, &Mean::range_share); })},
      {"s/view", "CPU", number(1, [](S s) { return std::optional(s.cpu_s); })},
      {"", "wall", number(1, [](S s) { return std::optional(s.wall_s); })},
  };
}

std::string MissedOf(const SuiteScore& score) {
  std::string missed;
  for (const SuiteCheck& check : score.checks) {
    if (check.met()) continue;
    missed += fmt::format("{}{} {:.3g} (must {} {:.3g})", missed.empty() ? "" : "; ", check.what,
                          check.value, check.at_least ? ">=" : "<=", check.must);
  }
  return missed;
}

Json ScoreJson(const SessionScore& score) {
  return Json::parse(FormatScoreJson(score), nullptr, false);
}

}  // namespace

ReliabilityCurve ReliabilityOf(const std::vector<SuiteScore>& scores) {
  ReliabilityCurve all;
  for (const SuiteScore& score : scores) all.Add(score.ours.reliability);
  return all;
}

std::string FormatSuiteTable(const std::vector<SuiteScore>& scores) {
  const std::vector<Column> columns = Columns();
  std::vector<std::vector<std::string>> lines(scores.size() + 2);
  std::vector<std::size_t> widths;
  for (const Column& column : columns) {
    lines[0].emplace_back(column.group);
    lines[1].emplace_back(column.heading);
    for (std::size_t i = 0; i < scores.size(); ++i) lines[i + 2].push_back(column.cell(scores[i]));
    std::size_t width = 0;
    for (const auto& line : lines) width = std::max(width, line.back().size());
    widths.push_back(width);
  }
  std::string out =
      "Means over the positions. RMSE and p95: of log10 luminance after one factor a picture, "
      "where\nthe bracket can measure. Oracle: our merge with true poses and disparity. Poses: the "
      "largest.\n\n";
  for (const auto& line : lines) {
    std::string text = fmt::format("{:<{}}", line[0], widths[0]);
    for (std::size_t i = 1; i < line.size(); ++i) {
      text += fmt::format("  {:>{}}", line[i], widths[i]);
    }
    out += text.substr(0, text.find_last_not_of(' ') + 1) + "\n";
  }
  if (const ReliabilityCurve all = ReliabilityOf(scores); !all.empty()) {
    out += fmt::format("\nDisparity called right with ... and right in, %: {}\n",
                       FormatReliability(all));
  }
  int missed = 0;
  std::string what;
  for (const SuiteScore& score : scores) {
    const std::string text = MissedOf(score);
    if (text.empty()) continue;
    ++missed;
    what += fmt::format("{}: {}\n", score.drive.name, text);
  }
  out += missed == 0 ? "\nEvery target that must be reached is.\n"
                     : fmt::format("\nMissed in {} of {} cases:\n{}", missed, scores.size(), what);
  return out;
}

std::string FormatSuiteMarkdown(const std::vector<SuiteScore>& scores) {
  const std::vector<Column> columns = Columns();
  std::string head = "|";
  std::string rule = "|";
  std::string group;
  for (const Column& column : columns) {
    if (column.group[0] != '\0') group = column.group;
    head += fmt::format(" {}{}{} |", group, group.empty() ? "" : " ", column.heading);
    rule += group.empty() ? " --- |" : " ---: |";
  }
  std::string out =
      "# Quality on simulated drives\n\nMeans over the positions. RMSE and p95 are of log10 "
      "luminance after one factor a picture, where the bracket can measure. Oracle: our merge with "
      "true poses and disparity; unreg.: the same frames averaged along equal directions; own: "
      "each position's own frame. Poses: the largest error of the chain.\n\n";
  out += head + "\n" + rule + "\n";
  for (const SuiteScore& score : scores) {
    out += "|";
    for (const Column& column : columns) out += fmt::format(" {} |", column.cell(score));
    out += "\n";
  }
  if (const ReliabilityCurve all = ReliabilityOf(scores); !all.empty()) {
    out += fmt::format(
        "\nConfidence of the disparity, all cases: called right with ... and right in, %: {}\n\n"
        "![reliability](reliability.png)\n",
        FormatReliability(all));
  }
  for (const SuiteScore& score : scores) {
    const std::string missed = MissedOf(score);
    out += fmt::format(
        "\n## {}\n\n{}\n\n![frames, views, disparity, error]({}.png)\n", score.drive.name,
        missed.empty() ? "All targets reached." : "Missed: " + missed, score.drive.name);
  }
  return out;
}

std::string FormatSuiteJson(const std::vector<SuiteScore>& scores) {
  Json cases = Json::array();
  for (const SuiteScore& score : scores) {
    Json checks = Json::array();
    for (const SuiteCheck& check : score.checks) {
      checks.push_back({{"what", check.what},
                        {"value", std::isfinite(check.value) ? Json(check.value) : Json(nullptr)},
                        {"must", check.must},
                        {"at_least", check.at_least},
                        {"met", check.met()}});
    }
    cases.push_back({{"name", score.drive.name},
                     {"cpu_s", score.cpu_s},
                     {"wall_s", score.wall_s},
                     {"oracle_ratio", score.OracleRatio()},
                     {"checks", std::move(checks)},
                     {"ours", ScoreJson(score.ours)},
                     {"oracle", ScoreJson(score.oracle)},
                     {"unregistered", ScoreJson(score.unregistered)},
                     {"thesis", ScoreJson(score.thesis)}});
  }
  return cases.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace omnihdr
