#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/session/rig_file.h"
#include "core/session/rig_import.h"
#include "core/sphere/rig_report.h"
#include "daemon/cli/command.h"

namespace omnihdr {
namespace {

constexpr std::size_t kMaxCalibrationBytes = std::size_t{1} << 20;

struct ImportArguments {
  std::vector<std::string> files;
  std::string kind = "auto";
  std::string size;
  double fov_deg = 0.0;
  double radius_m = 0.0;
  std::string model;
  std::string serial;
  std::string comment;
  std::string out;
};

// WIDTHxHEIGHT
Status ParseSize(const std::string& text, RigImportOptions& options) {
  if (text.empty()) return {};
  int consumed = 0;
  if (text.size() > 16 ||
      std::sscanf(text.c_str(), "%5dx%5d%n", &options.width, &options.height, &consumed) != 2 ||
      static_cast<std::size_t>(consumed) != text.size() || options.width < 1 ||
      options.height < 1) {
    return Fail(ErrorKind::kUsage, "--size {}: expected WIDTHxHEIGHT in pixels, as 2448x2048",
                text);
  }
  return {};
}

Result<int> Import(const ImportArguments& arguments) {
  RigImportOptions options;
  OMNIHDR_TRY(ParseSize(arguments.size, options));
  options.fov_deg = arguments.fov_deg;
  if (arguments.kind != "auto") options.kind = RigTextKindFromString(arguments.kind);
  std::vector<RigText> texts;
  std::string sources;
  for (const std::string& file : arguments.files) {
    OMNIHDR_ASSIGN(std::string text, ReadTextFile(file, kMaxCalibrationBytes));
    texts.push_back({file, std::move(text)});
    sources += (sources.empty() ? "" : ", ") + std::filesystem::path(file).filename().string();
  }
  OMNIHDR_ASSIGN(Rig rig, ImportRig(texts, options));
  if (!arguments.model.empty()) rig.model = arguments.model;
  if (!arguments.serial.empty()) rig.serial = arguments.serial;
  if (arguments.radius_m > 0.0) rig.sphere_radius_m = arguments.radius_m;
  OMNIHDR_TRY(rig.Validate().Context(arguments.out));
  std::string comment = fmt::format("Imported by omnihdr " OMNIHDR_VERSION " from {}.", sources);
  if (!arguments.comment.empty()) comment += "\n" + arguments.comment;
  OMNIHDR_TRY(WriteFileAtomic(arguments.out, FormatRig(rig, comment)));
  fmt::print("{}: {} sensors\n", arguments.out, rig.sensors.size());
  return 0;
}

// Masks must be there and of their sensors' sizes; what stitching would otherwise find out first.
Status CheckMasks(const Rig& rig, const std::filesystem::path& folder) {
  for (const RigSensor& sensor : rig.sensors) {
    if (sensor.mask_file.empty()) continue;
    const std::filesystem::path path = folder / sensor.mask_file;
    OMNIHDR_ASSIGN(const DecodedImage mask, ReadImage(path));
    if (mask.width() != sensor.lens.width() || mask.height() != sensor.lens.height()) {
      return Fail(ErrorKind::kData, "{}: {}x{}, expected {}x{} as sensor \"{}\"", path.string(),
                  mask.width(), mask.height(), sensor.lens.width(), sensor.lens.height(),
                  sensor.name);
    }
  }
  return {};
}

Result<int> Check(const std::string& file) {
  OMNIHDR_ASSIGN(const Rig rig, ReadRig(file));
  OMNIHDR_TRY(CheckMasks(rig, std::filesystem::path(file).parent_path()));
  const RigReport report = ExamineRig(rig);
  fmt::print("{}: {}{}{}\n{} sensors, sphere radius {:g} m, blend width {:g} degrees\n\n", file,
             rig.model.empty() ? "no model" : rig.model, rig.serial.empty() ? "" : ", serial ",
             rig.serial, rig.sensors.size(), rig.sphere_radius_m, rig.blend_width_deg);
  fmt::print("{:<8} {:<8} {:>11} {:>5}  {:>15} {:>7} {:>15} {:>9} {:>8}\n", "sensor", "lens",
             "size", "bayer", "azimuth, elev.", "roll", "field (degrees)", "sphere", "offset");
  for (std::size_t i = 0; i < rig.sensors.size(); ++i) {
    const RigSensor& sensor = rig.sensors[i];
    const SensorOptics& r = report.sensors[i];
    fmt::print(
        "{:<8} {:<8} {:>11} {:>5}  {:>7.2f} {:>7.2f} {:>7.2f} {:>7.1f} {:>7.1f} {:>7.2f} % "
        "{:>6.1f} mm\n",
        sensor.name, ToString(sensor.lens.kind()),
        fmt::format("{}x{}", sensor.lens.width(), sensor.lens.height()), ToString(sensor.bayer),
        r.azimuth_deg, r.elevation_deg, r.roll_deg, r.field_across_deg, r.field_down_deg,
        100.0 * r.share, 1e3 * r.offset_m);
  }
  fmt::print("\ncovered: {:.2f} % of the sphere, {:.2f} % by two sensors or more\n",
             100.0 * report.covered, 100.0 * report.covered_twice);
  if (report.closed_band_deg) {
    fmt::print("all around: from {:.1f} to {:.1f} degrees of elevation\n",
               (*report.closed_band_deg)[0], (*report.closed_band_deg)[1]);
  } else {
    fmt::print("all around: at no elevation\n");
  }
  fmt::print("overlaps:");
  for (const RigOverlap& overlap : report.overlaps) {
    fmt::print(" {}-{} {:.2f} %", rig.sensors[static_cast<std::size_t>(overlap.first)].name,
               rig.sensors[static_cast<std::size_t>(overlap.second)].name, 100.0 * overlap.share);
  }
  fmt::print("{}\nseen by:", report.overlaps.empty() ? " none" : "");
  for (std::size_t d = 0; d < report.directions.size(); ++d) {
    const int by = report.directions[d];
    fmt::print("{} {} {}", d == 0 ? "" : ",", kDirectionNames[d],
               by < 0 ? std::string("nobody") : rig.sensors[static_cast<std::size_t>(by)].name);
  }
  fmt::print("\n");
  for (const std::string& warning : report.warnings) fmt::print("warning: {}\n", warning);
  return 0;
}

}  // namespace

void AddRigCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand("rig", "Calibration of a head of several sensors");
  command->require_subcommand(1);

  CLI::App* import =
      command->add_subcommand("import", "Write a rig.toml from a maker's calibration");
  auto arguments = std::make_shared<ImportArguments>();
  import->add_option("files", arguments->files, "the maker's text, or texts that belong together")
      ->required();
  import->add_option("--kind", arguments->kind, "what the files are")
      ->check(CLI::IsMember({"auto", "ladybug-csv", "ladybug-text", "vuze"}))
      ->capture_default_str();
  import->add_option("--size", arguments->size,
                     "WIDTHxHEIGHT of a sensor's picture where the text does not tell it");
  import->add_option("--fov", arguments->fov_deg, "full field of view to use of each lens, degrees")
      ->check(CLI::Range(1.0, 359.0));
  import->add_option("--radius", arguments->radius_m, "distance at which pictures meet, metres")
      ->check(CLI::Range(0.01, 1e6));
  import->add_option("--model", arguments->model, "model to write");
  import->add_option("--serial", arguments->serial, "serial number to write");
  import->add_option("--comment", arguments->comment, "text for the top of the file");
  import->add_option("--out", arguments->out, "rig.toml to write")->required();
  import->callback([arguments, &run] { run = [arguments] { return Import(*arguments);
};
}  // namespace omnihdr
);

CLI::App* check = command->add_subcommand(
    "check", "Check a rig.toml; print its sensors, coverage, overlaps and orientation");
auto file = std::make_shared<std::string>();
check->add_option("file", *file, "rig.toml")->required();
check->callback([file, &run] { run = [file] { return Check(*file); }; });
}

}  // namespace omnihdr
