#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "core/photometry/vignetting.h"
#include "core/session/rig_edit.h"
#include "daemon/cli/calibrate_command.h"
#include "daemon/cli/calibration_input.h"
#include "daemon/cli/exposed_image.h"

namespace omnihdr {
namespace {

using Json = nlohmann::ordered_json;

struct VignettingArguments {
  CalibrationArguments input;
  bool overlaps = false;
  bool per_sensor = false;
  double step_deg = 1.0;
  std::string mask;
  bool apply = false;
  bool apply_gains = false;
  bool json = false;
};

struct Pictures {
  CalibrationInput input;
  std::vector<CalibrationPicture> all;
  std::vector<Image<std::uint8_t>> masks;  // of each sensor, may be empty
};

Result<Pictures> ReadAll(const VignettingArguments& arguments) {
  Pictures pictures;
  OMNIHDR_ASSIGN(
      pictures.input,
      ReadCalibrationPictures(arguments.input,
                              [&](const CalibrationInput&, CalibrationPicture picture) -> Status {
                                pictures.all.push_back(std::move(picture));
                                return {};
                              }));
  pictures.masks.resize(pictures.input.sensors.size());
  for (const CalibrationPicture& picture : pictures.all) {
    Image<std::uint8_t>& mask = pictures.masks[static_cast<std::size_t>(picture.sensor)];
    if (!mask.empty()) continue;
    std::string file = arguments.mask;
    if (file.empty() && pictures.input.rig) {
      const std::string& own =
          pictures.input.rig->sensors[static_cast<std::size_t>(picture.sensor)].mask_file;
      if (!own.empty()) {
        file = (std::filesystem::path(pictures.input.rig_file).parent_path() / own).string();
      }
    }
    if (file.empty()) continue;
    OMNIHDR_ASSIGN(mask, LoadPictureMask(file, picture.picture.width(), picture.picture.height()));
    // The fits leave out zeros alone.
    for (std::uint8_t& v : mask.values()) v = v >= 128 ? 255 : 0;
  }
  return pictures;
}

// What is printed and written, of either way.
struct Outcome {
  std::vector<std::string> names;
  std::vector<VignettingFit> fits;
  OverlapFit overlap;  // empty gains for flat fields
};

Result<Outcome> FromFlatFields(const Pictures& pictures) {
  Outcome outcome;
  for (std::size_t s = 0; s < pictures.input.sensors.size(); ++s) {
    std::vector<FlatField> fields;
    for (const CalibrationPicture& picture : pictures.all) {
      if (picture.sensor != static_cast<int>(s)) continue;
      fields.push_back({&picture.picture, pictures.masks[s].view()});
    }
    if (fields.empty()) continue;
    Eigen::Vector2d centre(0.5 * fields[0].picture->width(), 0.5 * fields[0].picture->height());
    double largest_rho = 1.0;
    if (pictures.input.rig) {
      centre = pictures.input.rig->sensors[s].lens.centre();
      largest_rho = LargestRho(pictures.input.rig->sensors[s]);
    }
    Result<VignettingFit> fit =
        FitFlatFields(fields, centre, largest_rho, pictures.input.responses[s], {});
    if (!fit) return Forward(fit.error(), "sensor " + pictures.input.sensors[s]);
    outcome.names.push_back(pictures.input.sensors[s]);
    outcome.fits.push_back(*fit);
  }
  return outcome;
}

Result<Outcome> FromOverlaps(const VignettingArguments& arguments, const Pictures& pictures) {
  if (!pictures.input.rig) {
    return Fail(ErrorKind::kUsage,
                "--overlaps: which directions do the sensors share? Name the rig with --rig");
  }
  // Sensors without a picture take no part.
  Rig rig = *pictures.input.rig;
  std::vector<RigSensor> sensors;
  std::vector<Response> responses;
  std::vector<double> reach;
  std::vector<std::size_t> place(rig.sensors.size(), 0);  // in `sensors`
  Outcome outcome;
  for (std::size_t s = 0; s < rig.sensors.size(); ++s) {
    const bool pictured =
        std::any_of(pictures.all.begin(), pictures.all.end(),
                    [s](const CalibrationPicture& p) { return p.sensor == static_cast<int>(s); });
    if (!pictured) continue;
    place[s] = sensors.size();
    sensors.push_back(rig.sensors[s]);
    responses.push_back(pictures.input.responses[s]);
    reach.push_back(LargestRho(rig.sensors[s]));
    outcome.names.push_back(rig.sensors[s].name);
  }
  rig.sensors = sensors;
  std::map<int, RigPictures> stands;
  for (const CalibrationPicture& picture : pictures.all) {
    RigPictures& stand = stands[picture.stand];
    stand.sensors.resize(sensors.size(), nullptr);
    stand.seconds.resize(sensors.size(), 1.0);
    stand.masks.resize(sensors.size());
    const std::size_t s = place[static_cast<std::size_t>(picture.sensor)];
    stand.sensors[s] = &picture.picture;
    stand.seconds[s] = picture.seconds;
    stand.masks[s] = pictures.masks[static_cast<std::size_t>(picture.sensor)].view();
    stand.world_from_rig = picture.world_from_rig;
  }
  std::vector<RigPictures> all;
  all.reserve(stands.size());
  for (auto& [number, stand] : stands) all.push_back(std::move(stand));
  OverlapOptions options;
  options.shared = !arguments.per_sensor;
  const std::vector<OverlapSample> samples =
      CollectOverlapSamples(rig, all, responses, arguments.step_deg, options.vignetting);
  OMNIHDR_ASSIGN(outcome.overlap, FitOverlaps(samples, outcome.names, reach, options));
  outcome.fits = outcome.overlap.sensors;
  return outcome;
}

void Print(const Outcome& outcome) {
  fmt::print("{:<10} {:>9} {:>9} {:>9}  {:>13} {:>10} {:>7} {:>8} {:>8}\n", "sensor", "a", "b", "c",
             "radii", "at edge", "+- %", "rms %", "samples");
  for (std::size_t i = 0; i < outcome.fits.size(); ++i) {
    const VignettingFit& f = outcome.fits[i];
    fmt::print(
        "{:<10} {:>9.4f} {:>9.4f} {:>9.4f}  {:>5.2f} .. {:<4.2f} {:>10.3f} {:>7.2f} {:>8.2f} "
        "{:>8}\n",
        outcome.names[i], f.vignetting.coefficients[0], f.vignetting.coefficients[1],
        f.vignetting.coefficients[2], f.rho_min, f.rho_max, f.at_edge, 100.0 * f.error,
        100.0 * f.residual, f.samples);
  }
  if (outcome.overlap.gain.empty()) return;
  fmt::print("{} directions seen twice; sensors differ by {:.2f} % before, {:.2f} % after\n",
             outcome.overlap.directions, 100.0 * outcome.overlap.difference_before,
             100.0 * outcome.overlap.difference_after);
  for (std::size_t s = 0; s < outcome.overlap.gain.size(); ++s) {
    const auto& g = outcome.overlap.gain[s];
    const auto& e = outcome.overlap.gain_error[s];
    fmt::print("{:<10} gain {:.4f} {:.4f} {:.4f} +- {:.2f} {:.2f} {:.2f} %\n", outcome.names[s],
               g[0], g[1], g[2], 100.0 * e[0], 100.0 * e[1], 100.0 * e[2]);
  }
}

Json ToJson(const Outcome& outcome) {
  Json sensors = Json::array();
  for (std::size_t i = 0; i < outcome.fits.size(); ++i) {
    const VignettingFit& f = outcome.fits[i];
    Json sensor = {{"name", outcome.names[i]}, {"coefficients", f.vignetting.coefficients},
                   {"rho_min", f.rho_min},     {"rho_max", f.rho_max},
                   {"at_edge", f.at_edge},     {"error", f.error},
                   {"residual", f.residual},   {"samples", f.samples}};
    if (!outcome.overlap.gain.empty()) {
      sensor["gain"] = outcome.overlap.gain[i];
      sensor["gain_relative_error"] = outcome.overlap.gain_error[i];
    }
    sensors.push_back(sensor);
  }
  Json out = {{"sensors", sensors}};
  if (!outcome.overlap.gain.empty()) {
    out["directions"] = outcome.overlap.directions;
    out["difference_before"] = outcome.overlap.difference_before;
    out["difference_after"] = outcome.overlap.difference_after;
  }
  return out;
}

Result<int> CalibrateVignetting(const VignettingArguments& arguments) {
  OMNIHDR_ASSIGN(const Pictures pictures, ReadAll(arguments));
  if ((arguments.apply || arguments.apply_gains) && !pictures.input.rig) {
    return Fail(ErrorKind::kUsage, "{}: into which rig? Name it with --rig",
                arguments.apply ? "--apply" : "--apply-gains");
  }
  if (arguments.apply_gains && !arguments.overlaps) {
    return Fail(ErrorKind::kUsage, "--apply-gains: gains come from --overlaps only");
  }
  OMNIHDR_ASSIGN(const Outcome outcome,
                 arguments.overlaps ? FromOverlaps(arguments, pictures) : FromFlatFields(pictures));
  if (arguments.apply || arguments.apply_gains) {
    std::vector<RigEdit> edits;
    for (std::size_t i = 0; i < outcome.names.size(); ++i) {
      RigEdit edit;
      edit.sensor = outcome.names[i];
      edit.vignetting = outcome.fits[i].vignetting.coefficients;
      if (arguments.apply_gains) edit.gain = outcome.overlap.gain[i];
      edits.push_back(edit);
    }
    OMNIHDR_TRY(EditRigFile(pictures.input.rig_file, edits));
  }
  if (arguments.json) {
    fmt::print("{}\n", ToJson(outcome).dump(2));
    return 0;
  }
  Print(outcome);
  if (arguments.apply || arguments.apply_gains) {
    fmt::print("{}: fall-off{} of {} set\n", pictures.input.rig_file,
               arguments.apply_gains ? " and gains" : "", fmt::join(outcome.names, ", "));
  }
  return 0;
}

}  // namespace

void AddCalibrateVignetting(CLI::App& calibrate, CommandRun& run) {
  CLI::App* command = calibrate.add_subcommand(
      "vignetting",
      "Fall-off of the lenses from evenly lit fields, or from what a rig's sensors see in common");
  auto arguments = std::make_shared<VignettingArguments>();
  AddCalibrationOptions(command, &arguments->input);
  command->add_flag("--overlaps", arguments->overlaps,
                    "pictures of any scene: compare sensors where their fields overlap");
  command->add_flag("--per-sensor", arguments->per_sensor,
                    "with --overlaps: a fall-off of its own for every sensor [one for all]");
  command->add_option("--step", arguments->step_deg, "with --overlaps: degrees between directions")
      ->check(CLI::Range(0.1, 10.0))
      ->capture_default_str();
  command->add_option("--mask", arguments->mask,
                      "picture of the sensors' size, white = use [the rig's masks]");
  command->add_flag("--apply", arguments->apply, "write the fall-off into the rig file");
  command->add_flag("--apply-gains", arguments->apply_gains,
                    "write fall-off and the sensors' gains into the rig file");
  command->add_flag("--json", arguments->json, "print one JSON object instead of tables");
  command->callback(
      [arguments, &run] { run = [arguments] { return CalibrateVignetting(*arguments); }; });
}

}  // namespace omnihdr
