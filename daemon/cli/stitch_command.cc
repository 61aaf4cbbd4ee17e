#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/photometry/stitch.h"
#include "core/photometry/tonemap.h"
#include "core/pipeline/view_files.h"
#include "daemon/cli/command.h"
#include "daemon/cli/exposed_image.h"
#include "daemon/cli/grid_option.h"
#include "daemon/cli/radiance_file.h"
#include "daemon/cli/stitch_inputs.h"
#include "daemon/cli/white_balance_option.h"

namespace omnihdr {
namespace {

using Json = nlohmann::ordered_json;

struct StitchArguments {
  StitchInputArguments inputs;
  std::string out;
  std::string to = "latlong";
  int size = 0;
  std::string preview;
  std::string mask;
  int bits = 16;
  std::string demosaic = "bilinear";
  std::vector<double> white_balance;
  bool json = false;
};

// What the command tells about a panorama.
struct StitchSummary {
  std::string out;
  SphereGrid grid;
  std::vector<std::string> sensors;
  std::vector<std::string> left_out;
  std::size_t exposures = 1;
  double covered = 0.0;  // of the sphere
  double clipped = 0.0;  // of what is covered, clipped in every exposure
  float largest = 0.0F;
  std::vector<Seam> seams;
};

void Cover(const Measurement& measurement, StitchSummary* summary) {
  double seen = 0.0;
  double clipped = 0.0;
  for (int y = 0; y < measurement.flags.height(); ++y) {
    for (int x = 0; x < measurement.flags.width(); ++x) {
      const std::uint8_t flags = measurement.flags.at(x, y);
      if ((flags & kMasked) != 0) continue;
      const double angle = summary->grid.PixelSolidAngle(x, y);
      seen += angle;
      if ((flags & kSaturatedAny) != 0) clipped += angle;
      for (int c = 0; c < 3; ++c) {
        summary->largest = std::max(summary->largest, measurement.radiance.at(x, y, c));
      }
    }
  }
  summary->covered = seen / (4.0 * std::numbers::pi);
  summary->clipped = seen > 0.0 ? clipped / seen : 0.0;
}

Json ThreeOrNull(const std::array<double, 3>& values) {
  Json out = Json::array();
  for (const double v : values) out.push_back(std::isfinite(v) ? Json(v) : Json(nullptr));
  return out;
}

std::string JsonOf(const StitchSummary& summary) {
  Json seams = Json::array();
  for (const Seam& seam : summary.seams) {
    seams.push_back({{"first", summary.sensors[static_cast<std::size_t>(seam.first)]},
                     {"second", summary.sensors[static_cast<std::size_t>(seam.second)]},
                     {"samples", seam.samples},
                     {"log10_ratio", ThreeOrNull(seam.log10_ratio)},
                     {"spread", ThreeOrNull(seam.spread)}});
  }
  const Json out = {{"file", summary.out},
                    {"projection", ToString(summary.grid.kind())},
                    {"width", summary.grid.width()},
                    {"height", summary.grid.height()},
                    {"sensors", summary.sensors},
                    {"left_out", summary.left_out},
                    {"exposures", summary.exposures},
                    {"covered", summary.covered},
                    {"clipped", summary.clipped},
                    {"largest_radiance", summary.largest},
                    {"seams", seams}};
  return out.dump(2);
}

std::string TextOf(const StitchSummary& summary) {
  std::string text = fmt::format(
      "{}: {} from {} sensor{}{}, {} exposure{}, radiance up to {:.4g}, {:.2f} % clipped in every "
      "one\n",
      summary.out, Shown(summary.grid), summary.sensors.size(),
      summary.sensors.size() == 1 ? "" : "s",
      summary.left_out.empty() ? ""
                               : fmt::format(" (without {})", fmt::join(summary.left_out, ", ")),
      summary.exposures, summary.exposures == 1 ? "" : "s", summary.largest,
      100.0 * summary.clipped);
  text += fmt::format("covered: {:.2f} % of the sphere\n", 100.0 * summary.covered);
  if (summary.seams.empty()) return text + "seams: no sensors meet\n";
  text += fmt::format("\n{:<18} {:>8}   {:<26} {}\n", "seam", "samples", "log10 of first / second",
                      "spread (median deviation)");
  text += fmt::format("{:<18} {:>8}   {:>8} {:>8} {:>8} {:>8} {:>8} {:>8}\n", "", "", "R", "G", "B",
                      "R", "G", "B");
  for (const Seam& seam : summary.seams) {
    text +=
        fmt::format("{:<18} {:>8}  ",
                    fmt::format("{} - {}", summary.sensors[static_cast<std::size_t>(seam.first)],
                                summary.sensors[static_cast<std::size_t>(seam.second)]),
                    seam.samples);
    for (const double v : seam.log10_ratio) {
      text += std::isfinite(v) ? fmt::format(" {:>+8.4f}", v) : fmt::format(" {:>8}", "-");
    }
    for (const double v : seam.spread) {
      text += std::isfinite(v) ? fmt::format(" {:>8.4f}", v) : fmt::format(" {:>8}", "-");
    }
    text += "\n";
  }
  return text;
}

Status WritePanorama(const StitchArguments& arguments, const SphereGrid& grid,
                     const Measurement& measurement) {
  const MergedView view = ViewOfMeasurement(measurement);
  std::vector<std::byte> jpeg;
  const bool is_latlong = grid.kind() == SphereGridKind::kEquirectangular;
  ExrAttributes attributes;
  attributes.floats["expTime"] = measurement.longest_exposure_s;
  const ExrPixelType type = SmallestType(view.radiance);
  if (type == ExrPixelType::kFloat) {
    fmt::print(stderr, "{}: radiance exceeds half precision: stored as float\n", arguments.out);
  }
  if (!arguments.preview.empty()) {
    ToneMapOptions options;
    if (is_latlong) options.shape = PictureShape::kSphere;
    OMNIHDR_ASSIGN(jpeg, EncodeJpeg(ToneMap(view.radiance, options), 92, is_latlong));
  }
  OMNIHDR_TRY(WriteRadianceFile(arguments.out, {&view.radiance, &view.origin, nullptr, type,
                                                AttributesFor(grid, std::move(attributes))}));
  if (!jpeg.empty()) OMNIHDR_TRY(WriteFileAtomic(arguments.preview, jpeg));
  return {};
}

Result<int> Stitch(const StitchArguments& arguments) {
  std::array<double, 3> balance = {1.0, 1.0, 1.0};
  if (!arguments.white_balance.empty()) {
    OMNIHDR_ASSIGN(balance, WhiteBalanceOf(arguments.white_balance));
  }
  OMNIHDR_ASSIGN(StitchInputs inputs, ReadStitchInputs(arguments.inputs));
  for (RigSensor& sensor : inputs.rig.sensors) {
    for (std::size_t c = 0; c < 3; ++c) sensor.gain[c] *= balance[c];
  }
  const int natural = NaturalPanoramaWidth(inputs.rig);
  OMNIHDR_ASSIGN(
      const SphereGrid grid,
      GridToWrite(*SphereGridKindFromString(arguments.to == "cube" ? "cube-strip" : arguments.to),
                  arguments.size, SphereGrid::Equirectangular(natural, natural / 2)));
  OMNIHDR_ASSIGN(const RigMasks masks, ReadStitchMasks(inputs, arguments.mask, grid));
  Result<Stitcher> stitcher = Stitcher::Create(inputs.rig, grid, masks.views());
  if (!stitcher) return Forward(std::move(stitcher).error(), arguments.inputs.rig);

  MeasureOptions options;
  if (arguments.demosaic == "edge-aware") options.demosaic = Demosaic::kEdgeAware;
  Measurement measurement;
  OMNIHDR_TRY(
      stitcher->Stitch(inputs.Frames(), inputs.responses, arguments.bits, options, &measurement));
  StitchSummary summary;
  summary.out = arguments.out;
  summary.grid = grid;
  summary.exposures = inputs.images.size();
  OMNIHDR_ASSIGN(summary.seams,
                 stitcher->Seams(inputs.Frames(), inputs.responses, arguments.bits, options));
  for (const RigSensor& sensor : inputs.rig.sensors) summary.sensors.push_back(sensor.name);
  for (const RigSensor& sensor : inputs.whole_rig.sensors) {
    if (std::find(summary.sensors.begin(), summary.sensors.end(), sensor.name) ==
        summary.sensors.end()) {
      summary.left_out.push_back(sensor.name);
    }
  }
  Cover(measurement, &summary);
  OMNIHDR_TRY(WritePanorama(arguments, grid, measurement));
  if (arguments.json) {
    fmt::print("{}\n", JsonOf(summary));
  } else {
    fmt::print("{}", TextOf(summary));
  }
  return 0;
}

}  // namespace

void AddStitchCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand(
      "stitch",
      "Stitch the pictures of a rig's sensors, taken at one place, into one radiance map");
  auto arguments = std::make_shared<StitchArguments>();
  command
      ->add_option("pictures", arguments->inputs.pictures,
                   "IMAGE or IMAGE@SECONDS, one for each sensor in the rig's order (- for a sensor "
                   "without one), or a stacked frame; as many again for each further exposure")
      ->required();
  command->add_option("--rig", arguments->inputs.rig, "rig.toml of the head")->required();
  command->add_option("--seconds", arguments->inputs.seconds,
                      "exposure time of the pictures that do not name theirs, as 0.01 or 1/100");
  command->add_option("--out", arguments->out, "EXR file to write")->required();
  command
      ->add_option("--to", arguments->to,
                   "projection: latlong, cylinder, rdmap or cube (OpenEXR's strip of six)")
      ->check(CLI::IsMember({"latlong", "cylinder", "rdmap", "cube", "cube-cross", "cube-strip"}))
      ->capture_default_str();
  command
      ->add_option("--size", arguments->size,
                   "width of a latlong or cylinder, or of a face of a cube or rdmap, in pixels [as "
                   "fine as the sensors]")
      ->check(CLI::Range(16, 65536));
  command->add_option("--preview", arguments->preview, "tone-mapped JPEG to write as well");
  command->add_option("--mask", arguments->mask,
                      "picture of the stacked frame's size, or lat-long (of the panorama), white = "
                      "use");
  command->add_option("--response", arguments->inputs.response,
                      "linear, srgb, or a file: a session.json, or what calibrate response wrote "
                      "[the sensors' own, or else linear]");
  command->add_option("--bits", arguments->bits, "significant bits of 16-bit images")
      ->check(CLI::Range(8, 16))
      ->capture_default_str();
  command
      ->add_option(
          "--demosaic", arguments->demosaic,
          "how Bayer mosaics are interpolated: bilinear, or edge-aware: sharper and slower")
      ->check(CLI::IsMember({"bilinear", "edge-aware"}))
      ->capture_default_str();
  AddWhiteBalanceOption(command, "gains on R,G,B beside the rig's, as in 1.9,1,1.4",
                        &arguments->white_balance);
  command->add_flag("--json", arguments->json, "print one JSON object instead of a table");
  command->callback([arguments, &run] { run = [arguments] { return Stitch(*arguments); }; });
}

}  // namespace omnihdr
