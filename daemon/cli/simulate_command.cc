#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "daemon/cli/command.h"
#include "drivers/sim/simulation.h"

namespace omnihdr {
namespace {

struct SimulateArguments {
  std::string directory;
  std::string scene = "hall";
  std::string layout = "panorama";
  std::string projection = "equirectangular";
  std::string order = "sawtooth";
  std::vector<double> exposures_s;
  double start_s = 0.001;
  double step_stops = 2.0;
  int count = 3;
  double gain_db = 0.0;
  double rotation_deg = 0.0;
  double mover_step_m = 0.4;
  bool no_odometer = false;
  bool quiet = false;
  sim::SimulateOptions options;
};

Result<int> Simulate(const SimulateArguments& arguments) {
  sim::SimulateOptions options = arguments.options;
  const auto scene = sim::SceneKindFromString(arguments.scene);
  if (!scene) {
    return Fail(ErrorKind::kUsage, "--scene: {}: expected hall, yard, tunnel or street",
                arguments.scene);
  }
  options.simulation.scene = *scene;
  if (arguments.layout == "rig") {
    options.simulation.layout = Layout::kRig;
  } else if (arguments.layout != "panorama") {
    return Fail(ErrorKind::kUsage, "--layout: {}: expected panorama or rig", arguments.layout);
  }
  const auto projection = ProjectionKindFromString(arguments.projection);
  if (!projection) {
    return Fail(ErrorKind::kUsage, "--projection: {}: expected equirectangular or cylindrical",
                arguments.projection);
  }
  options.simulation.projection = *projection;
  if (arguments.order == "sawtooth") {
    options.bracket.order = BracketOrder::kSawtooth;
  } else if (arguments.order == "triangle") {
    options.bracket.order = BracketOrder::kTriangle;
  } else if (arguments.order == "list") {
    options.bracket.order = BracketOrder::kList;
  } else {
    return Fail(ErrorKind::kUsage, "--order: {}: expected sawtooth, triangle or list",
                arguments.order);
  }
  for (const double seconds : arguments.exposures_s) {
    options.bracket.exposures.push_back(ExposureTime::Seconds(seconds));
  }
  options.bracket.start = ExposureTime::Seconds(arguments.start_s);
  options.bracket.step = Stops{arguments.step_stops};
  options.bracket.count = arguments.count;
  options.bracket.gain = GainDb{arguments.gain_db};
  options.write_odometer = !arguments.no_odometer;
  if (arguments.rotation_deg != 0.0) {
    if (!(options.spacing_m > 0.0)) {
      return Fail(ErrorKind::kUsage, "--rotation-deg: needs a --spacing above 0");
    }
    options.simulation.motion.yaw_deg_per_m = arguments.rotation_deg / options.spacing_m;
  }
  if (options.simulation.movers.count > 0) {
    if (!(options.spacing_m > 0.0)) {
      return Fail(ErrorKind::kUsage, "--movers: needs a --spacing above 0");
    }
    options.simulation.movers.speed = arguments.mover_step_m / options.spacing_m;
  }
  const auto progress = [&](const FrameRecord& record) {
    if (arguments.quiet) return;
    fmt::print("frame {} position {} {:.6g} s {}\n", Value(record.frame), Value(record.position),
               record.exposure.time.seconds(), record.file);
  };
  OMNIHDR_TRY(sim::WriteSimulatedSession(arguments.directory, options, progress));
  return 0;
}

}  // namespace

void AddSimulateCommand(CLI::App& app, CommandRun& run) {
  auto arguments = std::make_shared<SimulateArguments>();
  sim::SimulateOptions& options = arguments->options;
  CLI::App* command = app.add_subcommand(
      "simulate", "Write a session directory from a simulated drive through a rendered HDR world");
  command->add_option("directory", arguments->directory, "session directory to make")->required();
  command->add_option("--scene", arguments->scene, "hall, yard, tunnel or street")
      ->capture_default_str();
  command->add_option("--seed", options.simulation.seed, "layout, textures and light of the scene")
      ->capture_default_str();
  command->add_option("--positions", options.positions, "places at which frames are taken")
      ->capture_default_str();
  command->add_option("--spacing", options.spacing_m, "metres between positions")
      ->capture_default_str();
  command
      ->add_option("--start", options.simulation.start_m, "metres along the path at which to begin")
      ->capture_default_str();
  CLI::Option* list = command
                          ->add_option("--exposures", arguments->exposures_s,
                                       "exposure times in seconds, separated by commas")
                          ->delimiter(',');
  command->add_option("--start-s", arguments->start_s, "shortest exposure in seconds")
      ->capture_default_str()
      ->excludes(list);
  command->add_option("--step-stops", arguments->step_stops, "stops from one exposure to the next")
      ->capture_default_str()
      ->excludes(list);
  command->add_option("--count", arguments->count, "number of exposures")
      ->capture_default_str()
      ->excludes(list);
  command->add_option("--gain-db", arguments->gain_db, "sensor gain")->capture_default_str();
  command->add_option("--order", arguments->order, "sawtooth, triangle or list")
      ->capture_default_str();
  command
      ->add_option("--frames-per-position", options.bracket.frames_per_position,
                   "frames at each position; the number of exposures gives a data matrix")
      ->capture_default_str();
  command
      ->add_option("--layout", arguments->layout,
                   "panorama, or rig: stacked raw frames of a head of several sensors")
      ->capture_default_str();
  command->add_option("--rig", options.simulation.rig_file,
                      "rig file of that head; the nominal Ladybug2 when not given");
  command
      ->add_option("--sensor-width", options.simulation.sensor_width,
                   "columns of each of its sensors; 0 = as the rig says")
      ->capture_default_str();
  command->add_option("--width", options.simulation.width, "width of the panorama in pixels")
      ->capture_default_str();
  command->add_option("--projection", arguments->projection, "equirectangular or cylindrical")
      ->capture_default_str();
  command->add_option("--samples", options.simulation.samples, "rays a pixel: 1, 4, 9 or 16")
      ->capture_default_str();
  command
      ->add_option("--rotation-deg", arguments->rotation_deg,
                   "turn of the camera from one position to the next")
      ->capture_default_str();
  command->add_option("--sway-deg", options.simulation.motion.sway_deg, "pitching and rolling")
      ->capture_default_str();
  command
      ->add_option("--movers", options.simulation.movers.count,
                   "people who walk about near the way; where they are seen goes into movers/")
      ->check(CLI::Range(0, 16))
      ->capture_default_str();
  command
      ->add_option("--mover-step", arguments->mover_step_m,
                   "metres each of them walks from one position to the next")
      ->check(CLI::Range(0.0, 30.0))
      ->capture_default_str();
  command
      ->add_option("--full-well", options.simulation.sensor.full_well_e,
                   "electrons at full scale: photon noise")
      ->capture_default_str();
  command->add_option("--read-noise", options.simulation.sensor.read_noise, "rms code values")
      ->capture_default_str();
  command
      ->add_option("--white-level", options.simulation.sensor.white,
                   "value that the sensor clips at, 64 to 255")
      ->capture_default_str();
  command->add_option("--noise-seed", options.simulation.sensor.seed, "seed of the sensor's noise")
      ->capture_default_str();
  command->add_flag("--no-odometer", arguments->no_odometer,
                    "leave the odometer out of the journal");
  command
      ->add_option("--gnss-sigma", options.gnss_sigma_m,
                   "satellite fixes in the journal, with noise of so many metres; 0 = none")
      ->check(CLI::Range(0.0, 1000.0))
      ->capture_default_str();
  command->add_flag("-q,--quiet", arguments->quiet, "no line per frame");
  command->callback([arguments, &run] { run = [arguments] { return Simulate(*arguments); }; });
}

}  // namespace omnihdr
