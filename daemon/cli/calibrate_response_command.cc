#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/photometry/response_calibration.h"
#include "core/photometry/white_level.h"
#include "core/pipeline/read_frame.h"
#include "core/pipeline/response_session.h"
#include "core/session/response_json.h"
#include "core/session/rig_edit.h"
#include "daemon/cli/calibrate_command.h"
#include "daemon/cli/exposed_image.h"
#include "daemon/cli/rig_sensor.h"
#include "daemon/evaluation/plot.h"

namespace omnihdr {
namespace {

using Json = nlohmann::ordered_json;

struct ResponseArguments {
  std::vector<std::string> inputs;
  std::string method = "debevec";
  std::string mask;
  std::string out;
  std::string apply;
  std::string rig;
  std::string sensor;
  std::string plot;
  int bits = 16;
  bool json = false;
};

using MaybeSensor = std::optional<RigSensorChoice>;

bool IsSession(const ResponseArguments& arguments) {
  std::error_code ignored;
  return std::filesystem::is_directory(arguments.inputs.front(), ignored);
}

// The rig's sensor that the pictures are of, if any is named. A rig's session brings its rig.
Result<MaybeSensor> SensorOf(const ResponseArguments& arguments) {
  if (arguments.rig.empty() && arguments.sensor.empty()) return MaybeSensor();
  std::string file = arguments.rig;
  if (file.empty()) {
    file = (std::filesystem::path(arguments.inputs.front()) / "rig.toml").string();
    std::error_code ignored;
    if (!IsSession(arguments) || !std::filesystem::exists(file, ignored)) {
      return Fail(ErrorKind::kUsage, "--sensor {}: of which rig? Name it with --rig",
                  arguments.sensor);
    }
  }
  OMNIHDR_ASSIGN(RigSensorChoice choice, ChooseRigSensor(file, arguments.sensor));
  return MaybeSensor(std::move(choice));
}

// What of a frame to use; empty for all of it.
Result<Image<std::uint8_t>> MaskOf(const ResponseArguments& arguments, const MaybeSensor& sensor,
                                   const std::string& frame, int width, int height) {
  Image<std::uint8_t> mask;
  if (!arguments.mask.empty()) {
    OMNIHDR_ASSIGN(mask, LoadPictureMask(arguments.mask, width, height));
  }
  if (!sensor) return mask;
  return MaskOfSensor(*sensor, frame, width, height, mask.view());
}

// A sensor that clips this near the largest value does so there.
constexpr double kWhiteAsItShouldBe = 250.0;

// Of all values usable for a response, those below a white level.
SampleOptions Below(const std::optional<WhiteLevel>& white) {
  SampleOptions options;
  if (white && white->value < kWhiteAsItShouldBe) options.value_high *= white->value / 255.0;
  return options;
}

std::optional<WhiteLevel> WhiteLevelOfSession(const std::filesystem::path& session,
                                              const SessionContents& contents,
                                              ImageView<const std::uint8_t> mask) {
  constexpr std::size_t kMostFrames = 40;
  WhiteLevelFinder finder;
  const std::vector<FrameRecord>& frames = contents.journal.frames;
  const std::size_t step = std::max<std::size_t>(1, frames.size() / kMostFrames);
  for (std::size_t k = 0; k < frames.size(); k += step) {
    if (frames[k].status != FrameStatus::kOk) continue;
    const Result<DecodedImage> image = ReadFrame(session, contents.info.camera, frames[k]);
    if (!image) continue;  // the samples' warnings tell
    finder.Add(*image, contents.info.camera.bits, frames[k].exposure.EffectiveSeconds(), 0,
               image->height(), mask);
  }
  return finder.Find();
}

struct CalibrationSamples {
  SessionSamples session;
  std::optional<WhiteLevel> white;
};

Result<ResponseSamples> SamplesFromImages(const ResponseArguments& arguments,
                                          const MaybeSensor& sensor,
                                          std::optional<WhiteLevel>* white) {
  std::vector<DecodedImage> images;
  std::vector<std::string> names;
  std::vector<ExposureTime> times;
  for (const std::string& text : arguments.inputs) {
    OMNIHDR_ASSIGN(const ExposedImageName input, ParseExposedImage(text));
    Result<DecodedImage> image = ReadImage(input.file);
    if (!image) return Forward(image.error());
    images.push_back(std::move(*image));
    names.push_back(input.file);
    times.push_back(input.time);
  }
  OMNIHDR_ASSIGN(Image<std::uint8_t> mask, MaskOf(arguments, sensor, names.front(),
                                                  images.front().width(), images.front().height()));
  WhiteLevelFinder finder;
  for (std::size_t k = 0; k < images.size(); ++k) {
    finder.Add(images[k], arguments.bits, times[k].seconds(), 0, images[k].height(),
               images[k].width() == mask.width() && images[k].height() == mask.height()
                   ? mask.view()
                   : ImageView<const std::uint8_t>());
  }
  *white = finder.Find();
  if (sensor && sensor->sensor().bayer != BayerOrder::kNone) {
    bool halved = false;
    for (DecodedImage& image : images) {
      if (image.channels() != 1) continue;  // developed already
      image = HalfSizeColour(image, sensor->sensor().bayer);
      halved = true;
    }
    if (halved) mask = HalfSizeMask(mask.view());
  }
  std::vector<ExposedFrame> frames;
  for (std::size_t k = 0; k < images.size(); ++k) frames.push_back({&images[k], {times[k], {}}});
  return SamplesFromBracket(frames, names, arguments.bits, mask.view(), Below(*white));
}

// From pictures, or from the one session named.
Result<CalibrationSamples> Samples(const ResponseArguments& arguments, const MaybeSensor& sensor) {
  const std::filesystem::path session = arguments.inputs.front();
  CalibrationSamples result;
  if (!IsSession(arguments)) {
    OMNIHDR_ASSIGN(result.session.samples, SamplesFromImages(arguments, sensor, &result.white));
    result.session.frames = static_cast<int>(result.session.samples.seconds.size());
    return result;
  }
  if (arguments.inputs.size() > 1) {
    return Fail(ErrorKind::kUsage, "{}: expected one session, or pictures only", session.string());
  }
  OMNIHDR_ASSIGN(const SessionContents contents, ReadSession(session));
  OMNIHDR_ASSIGN(const Image<std::uint8_t> mask,
                 MaskOf(arguments, sensor, session.string(), contents.info.camera.width,
                        contents.info.camera.height));
  result.white = WhiteLevelOfSession(session, contents, mask.view());
  SessionSampleOptions options;
  options.samples = Below(result.white);
  OMNIHDR_ASSIGN(result.session, SamplesFromSession(session, contents, mask.view(), options));
  return result;
}

std::string ResponseReport(const ResponseCalibration& calibration, const CalibrationSamples& all,
                           ResponseMethod method) {
  const SessionSamples& source = all.session;
  const ResponseSamples& samples = source.samples;
  const auto [shortest, longest] =
      std::minmax_element(samples.seconds.begin(), samples.seconds.end());
  std::string text = fmt::format(
      "{} response from {} frames{}, {} exposures of {:.6g} to {:.6g} s\n", ToString(method),
      source.frames,
      source.moving ? fmt::format(" of a moving camera ({} pairs of positions)", source.links) : "",
      samples.seconds.size(), *shortest, *longest);
  const Response& response = calibration.response;
  if (response.model() == ResponseModel::kLinear) {
    text += fmt::format("Z - {:.3f} proportional to exposure\n", response.black());
  }
  if (all.white) {
    text += fmt::format("clips at value {:.1f}: {:.2g} % of the samples, in {} exposures\n",
                        all.white->value, 100.0 * all.white->share, all.white->exposures);
  }
  for (std::size_t c = 0; c < 3; ++c) {
    const ResponseCurve& curve = calibration.curves[c];
    text += fmt::format(
        "{}: {} spots, {} observations, values {} to {}, {:.1f} % rejected, residual {:.3f} stops, "
        "R2 {:.4f}",
        "RGB"[c], curve.spots, curve.observations, curve.measured_low, curve.measured_high,
        100.0 * static_cast<double>(curve.outliers) / static_cast<double>(curve.observations),
        curve.residual_stops, curve.r_squared);
    if (response.model() == ResponseModel::kLogLinear) {
      text += fmt::format(", ln X = {:.5f} Z {:+.4f}", response.loglinear()[c][0],
                          response.loglinear()[c][1]);
    }
    text += "\n";
  }
  text += fmt::format(
      "residual {:.3f} stops rms, {:.3f} with what was rejected, {:.3f} on spots held out of the "
      "fit\n",
      calibration.residual_stops, calibration.all_stops, calibration.held_out_stops);
  constexpr double kNoticeable = 0.1;
  for (std::size_t j = 0; j < samples.seconds.size(); ++j) {
    const double bias = calibration.exposure_bias_stops[j];
    if (std::abs(bias) < kNoticeable) continue;
    text +=
        fmt::format("{}: {:.3f} stops {} than {:.6g} s explain\n", samples.names[j], std::abs(bias),
                    bias < 0.0 ? "less light" : "more light", samples.seconds[j]);
  }
  return text;
}

std::string ResponseReportJson(const ResponseCalibration& calibration,
                               const CalibrationSamples& all, ResponseMethod method) {
  const SessionSamples& source = all.session;
  const ResponseSamples& samples = source.samples;
  Json json = {{"method", ToString(method)},
               {"frames", source.frames},
               {"moving", source.moving},
               {"response", Json::parse(FormatResponse(calibration.response))},
               {"residual_stops", calibration.residual_stops},
               {"residual_stops_with_rejected", calibration.all_stops},
               {"residual_stops_held_out", calibration.held_out_stops}};
  if (all.white) {
    json["white"] = {{"value", all.white->value},
                     {"share", all.white->share},
                     {"exposures", all.white->exposures}};
  }
  for (std::size_t j = 0; j < samples.seconds.size(); ++j) {
    json["exposures"].push_back({{"picture", samples.names[j]},
                                 {"exposure_s", samples.seconds[j]},
                                 {"bias_stops", calibration.exposure_bias_stops[j]}});
  }
  for (std::size_t c = 0; c < 3; ++c) {
    const ResponseCurve& curve = calibration.curves[c];
    json["channels"].push_back({{"channel", std::string(1, "rgb"[c])},
                                {"spots", curve.spots},
                                {"observations", curve.observations},
                                {"rejected", curve.outliers},
                                {"measured", {curve.measured_low, curve.measured_high}},
                                {"residual_stops", curve.residual_stops},
                                {"r_squared", curve.r_squared},
                                {"ln_exposure", curve.ln_exposure},
                                {"standard_error", curve.standard_error},
                                {"spread", curve.spread}});
  }
  return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n";
}

// ln exposure and exposure against the pixel value, as the thesis draws them. The band is the
// spread of one spot.
std::vector<Plot> ResponsePlots(const ResponseCalibration& calibration, ResponseMethod method) {
  constexpr std::array<const char*, 3> kNames = {"red", "green", "blue"};
  constexpr std::array<std::array<std::uint8_t, 3>, 3> kColours = {
      {{200, 40, 40}, {30, 140, 50}, {40, 70, 200}}};
  Plot logarithmic;
  logarithmic.title = fmt::format("inverse response, {}", ToString(method));
  logarithmic.x_label = "pixel value Z";
  logarithmic.y_label = "ln exposure, 0 at Z = 128";
  Plot linear = logarithmic;
  linear.y_label = "exposure, 1 at Z = 128";
  for (std::size_t c = 0; c < 3; ++c) {
    const ResponseCurve& curve = calibration.curves[c];
    PlotSeries ln;
    ln.name = kNames[c];
    ln.colour = kColours[c];
    PlotSeries plain = ln;
    for (int z = curve.measured_low; z <= curve.measured_high; ++z) {
      const auto k = static_cast<std::size_t>(z);
      const double g = curve.ln_exposure[k];
      ln.x.push_back(z);
      ln.y.push_back(g);
      ln.low.push_back(g - curve.spread[k]);
      ln.high.push_back(g + curve.spread[k]);
      plain.y.push_back(std::exp(g));
      plain.low.push_back(std::exp(g - curve.spread[k]));
      plain.high.push_back(std::exp(g + curve.spread[k]));
    }
    plain.x = ln.x;
    logarithmic.series.push_back(std::move(ln));
    linear.series.push_back(std::move(plain));
  }
  return {logarithmic, linear};
}

// Puts the response into a session; nothing else of it changes.
Status Apply(const std::filesystem::path& session, const Response& response) {
  const std::filesystem::path path = session / "session.json";
  OMNIHDR_ASSIGN(const std::string text, ReadTextFile(path));
  OMNIHDR_ASSIGN(const std::string replaced, ReplaceSessionResponse(text, path.string(), response));
  return WriteFileAtomic(path, replaced);
}

Result<int> Calibrate(const ResponseArguments& arguments) {
  const std::optional<ResponseMethod> method = ResponseMethodFromString(arguments.method);
  if (!method) return Fail(ErrorKind::kUsage, "--method {}: no such method", arguments.method);
  OMNIHDR_ASSIGN(const MaybeSensor sensor, SensorOf(arguments));
  OMNIHDR_ASSIGN(const CalibrationSamples source, Samples(arguments, sensor));
  for (const std::string& warning : source.session.warnings) {
    fmt::print(stderr, "warning: {}\n", warning);
  }
  ResponseCalibrationOptions options;
  options.method = *method;
  OMNIHDR_ASSIGN(ResponseCalibration calibration,
                 CalibrateResponse(source.session.samples, options));
  if (source.white && source.white->value < kWhiteAsItShouldBe) {
    OMNIHDR_ASSIGN(calibration.response, calibration.response.WithWhite(source.white->value));
  }
  if (!arguments.out.empty()) {
    OMNIHDR_TRY(WriteFileAtomic(arguments.out, FormatResponse(calibration.response) + "\n"));
  }
  if (!arguments.plot.empty())
    OMNIHDR_TRY(WritePlots(arguments.plot, ResponsePlots(calibration, *method)));
  if (!arguments.apply.empty()) OMNIHDR_TRY(Apply(arguments.apply, calibration.response));
  if (sensor) {
    RigEdit edit;
    edit.sensor = sensor->sensor().name;
    edit.response = calibration.response;
    OMNIHDR_TRY(EditRigFile(sensor->rig_file, std::span(&edit, 1)));
  }
  if (arguments.json) {
    fmt::print("{}", ResponseReportJson(calibration, source, *method));
    return 0;
  }
  fmt::print("{}", ResponseReport(calibration, source, *method));
  if (sensor) {
    fmt::print("{}: response of sensor {} set\n", sensor->rig_file, sensor->sensor().name);
  }
  return 0;
}

}  // namespace

void AddCalibrateResponse(CLI::App& calibrate, CommandRun& run) {
  CLI::App* command = calibrate.add_subcommand(
      "response",
      "Recover the response curve of a camera, or of one of a rig's sensors, from differently "
      "exposed pictures or a drive");
  auto arguments = std::make_shared<ResponseArguments>();
  command
      ->add_option("inputs", arguments->inputs,
                   "a session directory, or IMAGE@SECONDS, as in a.png@0.5 or a.png@1/60")
      ->required();
  command
      ->add_option("--method", arguments->method,
                   "debevec, robertson, linear (with a black level) or loglinear")
      ->check(CLI::IsMember({"debevec", "robertson", "linear", "loglinear"}))
      ->capture_default_str();
  command->add_option("--mask", arguments->mask, "picture of a frame's size, white = use");
  command->add_option("--bits", arguments->bits, "significant bits of 16-bit pictures")
      ->check(CLI::Range(8, 16))
      ->capture_default_str();
  command->add_option("--out", arguments->out,
                      "file for the response, a JSON object as in session.json");
  command->add_option("--apply", arguments->apply, "session directory that gets the response");
  command->add_option("--rig", arguments->rig,
                      "rig file one of whose sensors the pictures are of (alone, or all of them "
                      "stacked); that sensor gets the response [SESSION/rig.toml with --sensor]");
  command->add_option("--sensor", arguments->sensor,
                      "that sensor: its name, or its number from 0 [the only one]");
  command->add_option("--plot", arguments->plot, "picture of the curves, .png or .svg");
  command->add_flag("--json", arguments->json, "print the report, curves included, as JSON");
  command->callback([arguments, &run] { run = [arguments] { return Calibrate(*arguments); }; });
}

}  // namespace omnihdr
