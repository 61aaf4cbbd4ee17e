#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <filesystem>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <utility>
#include <vector>

#include "core/image/image_io.h"
#include "core/photometry/noise_calibration.h"
#include "core/session/session_reader.h"
#include "daemon/cli/calibrate_command.h"
#include "daemon/evaluation/plot.h"

namespace omnihdr {
namespace {

using Json = nlohmann::ordered_json;

struct NoiseArguments {
  std::vector<std::string> inputs;
  std::string plot;
  double black = 0.0;
  int bits = 16;
  bool mosaic = false;
  bool json = false;
};

struct Pairs {
  std::vector<std::pair<std::string, std::string>> files;
  NoiseCalibrationOptions options;
};

// Frames of one position and exposure, two by two.
Result<Pairs> PairsOfSession(const std::filesystem::path& session) {
  OMNIHDR_ASSIGN(const SessionContents contents, ReadSession(session));
  std::map<std::pair<std::int64_t, double>, std::string> waiting;
  Pairs pairs;
  for (const FrameRecord& frame : contents.journal.frames) {
    if (frame.status != FrameStatus::kOk || !frame.exposure.IsValid()) continue;
    const std::pair key{Value(frame.position), frame.exposure.EffectiveSeconds()};
    const std::string file = (session / frame.file).string();
    const auto found = waiting.find(key);
    if (found == waiting.end()) {
      waiting.emplace(key, file);
    } else {
      pairs.files.emplace_back(found->second, file);
      waiting.erase(found);
    }
  }
  if (pairs.files.empty()) {
    return Fail(ErrorKind::kData,
                "{}: no two frames of one position and one exposure: noise needs pairs",
                session.string());
  }
  pairs.options.bits = contents.info.camera.bits;
  pairs.options.mosaic = contents.info.camera.layout == Layout::kRig;
  pairs.options.black = contents.info.response.black();
  return pairs;
}

Result<Pairs> FindPairs(const NoiseArguments& arguments) {
  std::error_code ignored;
  if (std::filesystem::is_directory(arguments.inputs.front(), ignored)) {
    if (arguments.inputs.size() > 1) {
      return Fail(ErrorKind::kUsage, "{}: expected one session, or pictures only",
                  arguments.inputs.front());
    }
    return PairsOfSession(arguments.inputs.front());
  }
  if (arguments.inputs.size() % 2 != 0) {
    return Fail(ErrorKind::kUsage,
                "{} pictures, expected pairs: two after each other of one exposure",
                arguments.inputs.size());
  }
  Pairs pairs;
  for (std::size_t k = 0; k < arguments.inputs.size(); k += 2) {
    pairs.files.emplace_back(arguments.inputs[k], arguments.inputs[k + 1]);
  }
  pairs.options.bits = arguments.bits;
  return pairs;
}

std::vector<Plot> NoisePlots(const NoiseCalibration& noise) {
  Plot plot;
  plot.title = "photon transfer";
  plot.x_label = "signal above black, code values";
  plot.y_label = "noise, code values rms";
  plot.log_x = plot.log_y = true;
  PlotSeries measured{"measured, frame to frame", {40, 70, 200}, {}, {}, {}, {}, true};
  PlotSeries pattern{"measured, pattern", {200, 120, 20}, {}, {}, {}, {}, true};
  PlotSeries line{"read, photon and quantisation noise", {30, 140, 50}, {}, {}, {}, {}, false};
  for (const TransferPoint& p : noise.points) {
    measured.x.push_back(p.mean);
    measured.y.push_back(std::sqrt(p.temporal));
    pattern.x.push_back(p.mean);
    pattern.y.push_back(p.pattern > 0.0 ? std::sqrt(p.pattern) : 0.0);
  }
  const NoiseModel temporal{noise.model.read, noise.model.gain, 0.0};
  PlotSeries fixed{"PRNU", {200, 40, 40}, {}, {}, {}, {}, false};
  for (double z = noise.points.front().mean; z <= 255.0; z *= 1.03) {
    line.x.push_back(z);
    line.y.push_back(std::sqrt(temporal.VarianceOfValue(z)));
    fixed.x.push_back(z);
    fixed.y.push_back(noise.model.prnu * z);
  }
  plot.series = {measured, line, pattern, fixed};
  return {plot};
}

std::string NoiseReport(const NoiseCalibration& noise, std::size_t pairs) {
  const auto of = [](const Estimate& e, const char* format) {
    return fmt::format(fmt::runtime(std::string(format) + " ± " + format), e.value,
                       e.standard_error);
  };
  return fmt::format(
      "# {} pairs, {} tiles ({} left out at an end of the range), R2 {:.5f}\n"
      "# read noise {} code values, {} electrons\n# full well {} electrons at value 255\n"
      "# variance per code value {}, PRNU {}\n"
      "[photometry]\nread_noise = {:.4f}\ngain = {:.6f}\nprnu = {:.5f}\n",
      pairs, noise.tiles, noise.clipped, noise.r_squared, of(noise.read, "{:.3f}"),
      of(noise.read_e, "{:.1f}"), of(noise.full_well_e, "{:.0f}"), of(noise.gain, "{:.5f}"),
      of(noise.prnu, "{:.5f}"), noise.model.read, noise.model.gain, noise.model.prnu);
}

std::string NoiseReportJson(const NoiseCalibration& noise, std::size_t pairs) {
  const auto of = [](const Estimate& e) {
    return Json{{"value", e.value}, {"standard_error", e.standard_error}};
  };
  Json json = {{"pairs", pairs},
               {"tiles", noise.tiles},
               {"tiles_left_out", noise.clipped},
               {"read_noise", of(noise.read)},
               {"read_noise_e", of(noise.read_e)},
               {"gain", of(noise.gain)},
               {"full_well_e", of(noise.full_well_e)},
               {"prnu", of(noise.prnu)},
               {"r_squared", noise.r_squared}};
  for (const TransferPoint& p : noise.points) {
    json["points"].push_back({{"signal", p.mean},
                              {"variance", p.temporal},
                              {"standard_error", p.temporal_error},
                              {"pattern_variance", p.pattern},
                              {"tiles", p.tiles}});
  }
  return json.dump(2) + "\n";
}

Result<int> Calibrate(const NoiseArguments& arguments) {
  OMNIHDR_ASSIGN(Pairs pairs, FindPairs(arguments));
  if (arguments.black > 0.0) pairs.options.black = arguments.black;
  pairs.options.mosaic = pairs.options.mosaic || arguments.mosaic;
  std::vector<DecodedImage> images;
  images.reserve(2 * pairs.files.size());
  std::vector<FlatPair> flats;
  for (const auto& [first, second] : pairs.files) {
    for (const std::string& file : {first, second}) {
      Result<DecodedImage> image = ReadImage(file);
      if (!image) return Forward(image.error());
      images.push_back(std::move(*image));
    }
    flats.push_back(
        {&images[images.size() - 2], &images.back(), fmt::format("{} and {}", first, second)});
  }
  OMNIHDR_ASSIGN(const NoiseCalibration noise, CalibrateNoise(flats, pairs.options));
  if (!arguments.plot.empty()) OMNIHDR_TRY(WritePlots(arguments.plot, NoisePlots(noise)));
  fmt::print("{}", arguments.json ? NoiseReportJson(noise, flats.size())
                                  : NoiseReport(noise, flats.size()));
  return 0;
}

}  // namespace

void AddCalibrateNoise(CLI::App& calibrate, CommandRun& run) {
  CLI::App* command = calibrate.add_subcommand(
      "noise", "Measure gain, read noise, full well and PRNU from pairs of flat pictures");
  auto arguments = std::make_shared<NoiseArguments>();
  command
      ->add_option("inputs", arguments->inputs,
                   "a session with equal frames at a position, or pictures, two by two of one "
                   "exposure")
      ->required();
  command->add_option("--black", arguments->black, "black level, 8-bit code values")
      ->check(CLI::Range(0.0, 127.0));
  command->add_option("--bits", arguments->bits, "significant bits of 16-bit pictures")
      ->check(CLI::Range(8, 16))
      ->capture_default_str();
  command->add_flag("--mosaic", arguments->mosaic, "the pictures are Bayer mosaics");
  command->add_option("--plot", arguments->plot, "photon transfer curve, .png or .svg");
  command->add_flag("--json", arguments->json, "print the report as JSON");
  command->callback([arguments, &run] { run = [arguments] { return Calibrate(*arguments); }; });
}

}  // namespace omnihdr
