#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/photometry/color_chart.h"
#include "core/photometry/sensor_consistency.h"
#include "core/photometry/white_balance.h"
#include "core/session/rig_edit.h"
#include "daemon/cli/calibrate_command.h"
#include "daemon/cli/calibration_input.h"
#include "daemon/evaluation/chart_overlay.h"
#include "daemon/evaluation/sensor_plots.h"

namespace omnihdr {
namespace {

using Json = nlohmann::ordered_json;

struct ChartArguments {
  CalibrationArguments input;
  std::string corners;
  std::string overlay;
  std::string sensor;
  std::string plot;
  bool apply = false;
  bool json = false;
};

// A picture's chart.
struct FoundChart {
  std::string name;
  int sensor = 0;
  double seconds = 1.0;
  bool has_seconds = false;
  ChartDetection detection;
  ChartMeasurement measurement;
};

struct Charts {
  CalibrationInput input;
  std::vector<FoundChart> found;
  std::vector<std::string> missing;  // pictures without a chart, with the reason
  bool all_colour = true;
};

// The n-th overlay beside the first: chart.png, chart-2.png, ...
std::filesystem::path OverlayFile(const std::string& file, std::size_t n) {
  std::filesystem::path path = file;
  if (n == 0) return path;
  std::filesystem::path numbered = path.stem();
  numbered += fmt::format("-{}", n + 1);
  numbered += path.extension();
  return path.parent_path() / numbered;
}

// A chart in every picture named; of the frames of a session and of several sensors' pictures only
// some need to show it.
Result<Charts> FindCharts(const ChartArguments& arguments) {
  std::optional<std::array<Eigen::Vector2d, 4>> corners;
  if (!arguments.corners.empty()) {
    OMNIHDR_ASSIGN(corners, ParseCorners(arguments.corners));
  }
  Charts charts;
  const ChartMeasureOptions measure;
  const auto visit = [&](const CalibrationInput& input, CalibrationPicture picture) -> Status {
    if (!arguments.sensor.empty() &&
        input.sensors[static_cast<std::size_t>(picture.sensor)] != arguments.sensor) {
      return {};
    }
    const bool may_miss = !arguments.input.session.empty() || input.sensors.size() > 1;
    Result<ChartDetection> detection = corners ? ColorChartAtCorners(picture.picture, *corners, {})
                                               : DetectColorChart(picture.picture, {});
    if (!detection) {
      if (!may_miss || corners) return Forward(detection.error(), picture.name);
      charts.missing.push_back(fmt::format("{}: {}", picture.name, detection.error().message));
      return {};
    }
    Result<ChartMeasurement> measurement =
        MeasureChart(picture.picture, detection->geometry,
                     input.responses[static_cast<std::size_t>(picture.sensor)], measure);
    if (!measurement) return Forward(measurement.error(), picture.name);
    if (!arguments.overlay.empty()) {
      OMNIHDR_ASSIGN(
          const std::vector<std::byte> png,
          EncodePng(DrawChartOverlay(picture.picture, *detection, *measurement, measure).view(),
                    6));
      OMNIHDR_TRY(WriteFileAtomic(OverlayFile(arguments.overlay, charts.found.size()), png));
    }
    charts.all_colour &= picture.picture.has_colour();
    charts.found.push_back({picture.name, picture.sensor, picture.seconds, picture.has_seconds,
                            *detection, *measurement});
    return {};
  };
  OMNIHDR_ASSIGN(charts.input, ReadCalibrationPictures(arguments.input, visit));
  if (charts.found.empty() && charts.missing.empty()) {
    return Fail(ErrorKind::kUsage, "--sensor: {}, the pictures are of {}", arguments.sensor,
                fmt::join(charts.input.sensors, ", "));
  }
  if (charts.found.empty()) {
    return Fail(ErrorKind::kData, "none of {} pictures shows a ColorChecker; the first: {}",
                charts.input.pictures, charts.missing.front());
  }
  return charts;
}

std::string DescribeChart(const FoundChart& chart) {
  const ChartDetection& d = chart.detection;
  std::string text = fmt::format(
      "{}: ColorChecker turned {:.0f} deg, agreement {:.2f}, {} of {} patches outlined, off the "
      "grid by {:.3f} patch\n",
      chart.name, d.rotation_deg, d.agreement, d.patches_seen, kChartPatches, d.residual);
  if (d.mirrored) {
    text += fmt::format(
        "warning: {}: the chart is mirrored: the picture's columns or rows are stored the wrong "
        "way "
        "round\n",
        chart.name);
  }
  return text;
}

Json NumberOrNull(double value) { return std::isfinite(value) ? Json(value) : Json(nullptr); }

Json ThreeJson(const std::array<double, 3>& values) {
  Json out = Json::array();
  for (const double v : values) out.push_back(NumberOrNull(v));
  return out;
}

Json ChartJson(const FoundChart& chart, const CalibrationInput& input) {
  const ChartDetection& d = chart.detection;
  Json patches = Json::array();
  for (int p = 0; p < kChartPatches; ++p) {
    const auto& channels = chart.measurement[static_cast<std::size_t>(p)];
    const Eigen::Vector2d centre = d.geometry.PatchCentre(p);
    Json mean = Json::array();
    Json median = Json::array();
    Json noise = Json::array();
    Json clipped = Json::array();
    Json linear = Json::array();
    for (const PatchChannel& c : channels) {
      mean.push_back(c.mean);
      median.push_back(c.median);
      noise.push_back(c.noise);
      clipped.push_back(c.clipped);
      linear.push_back(c.exposure);
    }
    patches.push_back({{"patch", p + 1},
                       {"name", ChartReference()[static_cast<std::size_t>(p)].name},
                       {"x", centre.x()},
                       {"y", centre.y()},
                       {"mean", mean},
                       {"median", median},
                       {"noise", noise},
                       {"clipped", clipped},
                       {"linear", linear}});
  }
  Json out = {{"picture", chart.name},
              {"sensor", input.sensors[static_cast<std::size_t>(chart.sensor)]}};
  if (chart.has_seconds) out["exposure_s"] = chart.seconds;
  out["mirrored"] = d.mirrored;
  out["rotation_deg"] = d.rotation_deg;
  out["agreement"] = d.agreement;
  out["patches_outlined"] = d.patches_seen;
  out["grid_residual"] = d.residual;
  out["patches"] = patches;
  return out;
}

Status CheckApply(const ChartArguments& arguments, const CalibrationInput& input) {
  if (arguments.apply && !input.rig) {
    return Fail(ErrorKind::kUsage, "--apply: into which rig? Name it with --rig");
  }
  return {};
}

Result<int> CalibrateWhiteBalance(const ChartArguments& arguments) {
  OMNIHDR_ASSIGN(Charts charts, FindCharts(arguments));
  OMNIHDR_TRY(CheckApply(arguments, charts.input));
  if (!charts.all_colour) {
    return Fail(
        ErrorKind::kUsage,
        "white balance of one-channel pictures: name the order of their colours with --bayer");
  }
  std::vector<ChartMeasurement> measurements;
  for (const FoundChart& chart : charts.found) measurements.push_back(chart.measurement);
  OMNIHDR_ASSIGN(const WhiteBalance balance, SolveWhiteBalance(measurements));
  std::string applied;
  if (arguments.apply) {
    std::vector<RigEdit> edits;
    for (const RigSensor& sensor : charts.input.rig->sensors) {
      if (!arguments.sensor.empty() && sensor.name != arguments.sensor) continue;
      const double green = sensor.gain[1];
      edits.push_back(
          {sensor.name, std::array{green * balance.red, green, green * balance.blue}, {}, {}});
      applied += (applied.empty() ? "" : ", ") + sensor.name;
    }
    OMNIHDR_TRY(EditRigFile(charts.input.rig_file, edits));
  }
  if (arguments.json) {
    Json out = {{"gain", {{"red", balance.red}, {"green", 1.0}, {"blue", balance.blue}}},
                {"relative_error", {{"red", balance.red_error}, {"blue", balance.blue_error}}},
                {"worst_residual", balance.worst_residual}};
    Json greys = Json::array();
    for (const GreyPatchBalance& g : balance.patches) {
      Json grey = {{"picture", charts.found[static_cast<std::size_t>(g.picture)].name},
                   {"patch", g.patch + 1},
                   {"used", g.used}};
      if (g.used) {
        grey["red_residual"] = g.red_residual;
        grey["blue_residual"] = g.blue_residual;
      } else {
        grey["excluded"] = g.excluded;
      }
      greys.push_back(grey);
    }
    out["grey_patches"] = greys;
    Json pictures = Json::array();
    for (const FoundChart& chart : charts.found) pictures.push_back(ChartJson(chart, charts.input));
    out["pictures"] = pictures;
    out["warnings"] = balance.warnings;
    fmt::print("{}\n", out.dump(2));
    return 0;
  }
  for (std::size_t k = 0; k < charts.found.size(); ++k) {
    fmt::print("{}", DescribeChart(charts.found[k]));
    fmt::print("  {:<12} {:>18} {:>9} {:>9} {:>7}\n", "grey patch", "value R/G/B", "R/G left",
               "B/G left", "noise");
    for (const GreyPatchBalance& g : balance.patches) {
      if (g.picture != static_cast<int>(k)) continue;
      const auto& c = charts.found[k].measurement[static_cast<std::size_t>(g.patch)];
      const std::string values =
          fmt::format("{:.1f} {:.1f} {:.1f}", c[0].mean, c[1].mean, c[2].mean);
      fmt::print("  {:<12} {:>18} {:>9} {:>9} {:>7.2f}\n",
                 ChartReference()[static_cast<std::size_t>(g.patch)].name, values,
                 g.used ? fmt::format("{:+.2f} %", 100.0 * g.red_residual) : g.excluded,
                 g.used ? fmt::format("{:+.2f} %", 100.0 * g.blue_residual) : "", c[1].noise);
    }
  }
  for (const std::string& warning : balance.warnings) fmt::print("warning: {}\n", warning);
  fmt::print("gains: red {:.4f} +- {:.4f}, green 1, blue {:.4f} +- {:.4f}\n", balance.red,
             balance.red * balance.red_error, balance.blue, balance.blue * balance.blue_error);
  if (!applied.empty()) {
    fmt::print("{}: red and blue gains of {} set\n", charts.input.rig_file, applied);
  }
  return 0;
}

std::string Percent(double value) {
  return std::isfinite(value) ? fmt::format("{:+.2f}", 100.0 * value) : "-";
}

void PrintSensors(const std::vector<std::string>& names, const SensorConsistency& result) {
  fmt::print("{:<10} {:>8} {:>9}   {:<26} {:<17} {:<26} {}\n", "sensor", "pictures", "exposures",
             "least R2 (R G B)", "off line %", "gain (R G B)", "+- %");
  for (std::size_t s = 0; s < names.size(); ++s) {
    const SensorReport& r = result.sensors[s];
    const auto three = [](const std::array<double, 3>& v, double scale, int digits) {
      std::string text;
      for (const double x : v) {
        text += (text.empty() ? "" : " ") +
                (std::isfinite(x) ? fmt::format("{:.{}f}", scale * x, digits) : std::string("-"));
      }
      return text;
    };
    fmt::print("{:<10} {:>8} {:>9}   {:<26} {:<17} {:<26} {}\n", names[s], r.pictures, r.exposures,
               three(r.least_r_squared, 1.0, 6), three(r.worst_deviation, 100.0, 2),
               three(r.gain, 1.0, 4), three(r.gain_error, 100.0, 2));
  }
  if (names.size() < 2) return;
  fmt::print("\ndifference from the mean of the sensors, %\n{:<10} {:<7}", "sensor", "channel");
  for (int p = kChartFirstGrey; p < kChartPatches; ++p) {
    fmt::print(" {:>11}", ChartReference()[static_cast<std::size_t>(p)].name);
  }
  fmt::print("   worst -> with the gains\n");
  static constexpr std::array<std::string_view, 3> kChannels = {"red", "green", "blue"};
  for (std::size_t s = 0; s < names.size(); ++s) {
    for (std::size_t c = 0; c < 3; ++c) {
      double worst = 0.0;
      double worst_after = 0.0;
      fmt::print("{:<10} {:<7}", names[s], kChannels[c]);
      for (std::size_t p = kChartFirstGrey; p < kChartPatches; ++p) {
        const double before = result.sensors[s].difference[p][c];
        const double after = result.sensors[s].difference_after[p][c];
        if (std::isfinite(before)) worst = std::max(worst, std::abs(before));
        if (std::isfinite(after)) worst_after = std::max(worst_after, std::abs(after));
        fmt::print(" {:>11}", Percent(before));
      }
      fmt::print("   {:.2f} -> {:.2f}\n", 100.0 * worst, 100.0 * worst_after);
    }
  }
  fmt::print("worst of all (R G B): {:.2f} {:.2f} {:.2f} % -> {:.2f} {:.2f} {:.2f} %\n",
             100.0 * result.worst_difference[0], 100.0 * result.worst_difference[1],
             100.0 * result.worst_difference[2], 100.0 * result.worst_difference_after[0],
             100.0 * result.worst_difference_after[1], 100.0 * result.worst_difference_after[2]);
}

Json SensorsJson(const Charts& charts, const std::vector<std::string>& names,
                 const SensorConsistency& result) {
  Json sensors = Json::array();
  for (std::size_t s = 0; s < result.sensors.size(); ++s) {
    const SensorReport& r = result.sensors[s];
    Json patches = Json::array();
    for (std::size_t p = 0; p < kChartPatches; ++p) {
      Json lines = Json::array();
      for (const ExposureLine& line : r.lines[p]) {
        lines.push_back(line.fitted ? Json{{"points", line.points},
                                           {"slope", line.slope},
                                           {"offset", line.offset},
                                           {"r_squared", line.r_squared},
                                           {"deviation", line.deviation}}
                                    : Json{{"points", line.points}});
      }
      Json patch = {{"patch", p + 1}, {"linearity", lines}};
      if (p >= kChartFirstGrey) {
        patch["difference"] = ThreeJson(r.difference[p]);
        patch["difference_after"] = ThreeJson(r.difference_after[p]);
      }
      patches.push_back(patch);
    }
    sensors.push_back({{"name", names[s]},
                       {"pictures", r.pictures},
                       {"exposures", r.exposures},
                       {"gain", ThreeJson(r.gain)},
                       {"gain_relative_error", ThreeJson(r.gain_error)},
                       {"least_r_squared", ThreeJson(r.least_r_squared)},
                       {"mean_r_squared", ThreeJson(r.mean_r_squared)},
                       {"worst_deviation", ThreeJson(r.worst_deviation)},
                       {"patches", patches}});
  }
  Json pictures = Json::array();
  for (const FoundChart& chart : charts.found) pictures.push_back(ChartJson(chart, charts.input));
  return {{"sensors", sensors},
          {"worst_difference", ThreeJson(result.worst_difference)},
          {"worst_difference_after", ThreeJson(result.worst_difference_after)},
          {"pictures", pictures},
          {"without_chart", charts.missing},
          {"warnings", result.warnings}};
}

Result<int> CalibrateSensors(const ChartArguments& arguments) {
  OMNIHDR_ASSIGN(Charts charts, FindCharts(arguments));
  OMNIHDR_TRY(CheckApply(arguments, charts.input));
  // Sensors that saw no chart take no part.
  std::vector<std::size_t> place(charts.input.sensors.size(), 0);
  std::vector<std::string> names;
  std::vector<std::string> unseen;
  for (std::size_t s = 0; s < charts.input.sensors.size(); ++s) {
    const bool seen =
        std::any_of(charts.found.begin(), charts.found.end(),
                    [s](const FoundChart& c) { return c.sensor == static_cast<int>(s); });
    place[s] = names.size();
    (seen ? names : unseen).push_back(charts.input.sensors[s]);
  }
  std::vector<SensorChart> measured;
  bool all_timed = true;
  for (const FoundChart& chart : charts.found) {
    measured.push_back({static_cast<int>(place[static_cast<std::size_t>(chart.sensor)]),
                        chart.seconds, chart.measurement});
    all_timed &= chart.has_seconds;
  }
  if (!all_timed) {
    for (const FoundChart& chart : charts.found) {
      if (!chart.has_seconds) continue;
      return Fail(
          ErrorKind::kUsage,
          "some pictures have an exposure time and others none: give IMAGE@SECONDS for all, "
          "or for none when all are equal");
    }
  }
  OMNIHDR_ASSIGN(SensorConsistency result, CompareSensors(measured, names));
  for (const std::string& name : unseen) {
    result.warnings.push_back(fmt::format("sensor {}: no chart seen: left out", name));
  }
  if (!charts.all_colour) {
    result.warnings.emplace_back(
        "one-channel pictures without --bayer: taken for grey, all colours read the same");
  }
  if (!arguments.plot.empty()) {
    OMNIHDR_TRY(WritePlots(arguments.plot, SensorPlots(measured, names, result)));
  }
  if (arguments.apply) {
    std::vector<RigEdit> edits;
    for (std::size_t s = 0; s < names.size(); ++s) {
      edits.push_back({names[s], result.sensors[s].gain, {}, {}});
    }
    OMNIHDR_TRY(EditRigFile(charts.input.rig_file, edits));
  }
  if (arguments.json) {
    fmt::print("{}\n", SensorsJson(charts, names, result).dump(2));
    return 0;
  }
  for (const FoundChart& chart : charts.found) fmt::print("{}", DescribeChart(chart));
  if (!charts.missing.empty()) {
    fmt::print("no chart in {} more pictures\n", charts.missing.size());
  }
  fmt::print("\n");
  PrintSensors(names, result);
  for (const std::string& warning : result.warnings) fmt::print("warning: {}\n", warning);
  if (arguments.apply) {
    fmt::print("{}: gains of {} set\n", charts.input.rig_file, fmt::join(names, ", "));
  }
  return 0;
}

void AddChartOptions(CLI::App* command, ChartArguments* arguments) {
  AddCalibrationOptions(command, &arguments->input);
  command->add_option("--corners", arguments->corners,
                      "x,y,x,y,x,y,x,y: where the centres of dark skin, bluish green, black and "
                      "white are, when the chart is not found");
  command->add_option("--overlay", arguments->overlay,
                      "PNG to write: the picture with what was measured (for several pictures "
                      "numbered from the second on)");
  command->add_flag("--apply", arguments->apply, "write the gains into the rig file");
  command->add_flag("--json", arguments->json, "print one JSON object instead of tables");
}

}  // namespace

void AddCalibrateWhiteBalance(CLI::App& calibrate, CommandRun& run) {
  CLI::App* command = calibrate.add_subcommand(
      "white-balance", "Red and blue gains from the grey row of a ColorChecker");
  auto arguments = std::make_shared<ChartArguments>();
  AddChartOptions(command, arguments.get());
  command->add_option("--sensor", arguments->sensor,
                      "use this sensor's pictures alone, and apply to it alone [all]");
  command->callback(
      [arguments, &run] { run = [arguments] { return CalibrateWhiteBalance(*arguments); }; });
}

void AddCalibrateSensors(CLI::App& calibrate, CommandRun& run) {
  CLI::App* command = calibrate.add_subcommand(
      "sensors",
      "Linearity of each sensor, with a plot, and agreement between them from pictures of a "
      "ColorChecker under one light, and the gains that make them agree");
  auto arguments = std::make_shared<ChartArguments>();
  AddChartOptions(command, arguments.get());
  command->add_option("--plot", arguments->plot,
                      "picture of how linear each sensor is, patch by patch, .png or .svg");
  command->callback(
      [arguments, &run] { run = [arguments] { return CalibrateSensors(*arguments); }; });
}

}  // namespace omnihdr
