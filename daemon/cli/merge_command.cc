#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/photometry/measure.h"
#include "core/photometry/tonemap.h"
#include "core/pipeline/view_files.h"
#include "daemon/cli/command.h"
#include "daemon/cli/exposed_image.h"
#include "daemon/cli/exposure_table.h"
#include "daemon/cli/radiance_file.h"
#include "daemon/cli/response_option.h"
#include "daemon/cli/white_balance_option.h"

namespace omnihdr {
namespace {

struct MergeArguments {
  std::vector<std::string> images;
  std::string out;
  std::string mask;
  std::string preview;
  std::string response = "linear";
  std::string exr_type = "half";
  int bits = 16;
  std::string weights = "inverse-variance";
  std::string nan = "never";
  std::vector<double> white_balance;
  double refine_limit = 0.2;
  bool no_refine = false;
  bool report = false;
  bool json = false;
};

Result<MeasureOptions> MeasureOptionsOf(const MergeArguments& arguments) {
  MeasureOptions options;
  options.weights =
      arguments.weights == "hat" ? MergeWeights::kHat : MergeWeights::kInverseVariance;
  if (!arguments.white_balance.empty()) {
    OMNIHDR_ASSIGN(options.white_balance, WhiteBalanceOf(arguments.white_balance));
  }
  return options;
}

NanPixels NanOf(const std::string& word) {
  if (word == "no-data") return NanPixels::kNoData;
  return word == "unmeasured" ? NanPixels::kUnmeasured : NanPixels::kNever;
}

Result<int> Merge(const MergeArguments& arguments) {
  OMNIHDR_ASSIGN(const Response response, ResponseOf(arguments.response));
  std::vector<DecodedImage> images;
  std::vector<ExposureTime> times;
  for (const std::string& text : arguments.images) {
    OMNIHDR_ASSIGN(const ExposedImageName input, ParseExposedImage(text));
    OMNIHDR_ASSIGN(DecodedImage image, ReadImage(input.file));
    if (!images.empty() &&
        (image.width() != images.front().width() || image.height() != images.front().height())) {
      return Fail(ErrorKind::kData, "{}: {}x{}, expected {}x{} as the first image", input.file,
                  image.width(), image.height(), images.front().width(), images.front().height());
    }
    images.push_back(std::move(image));
    times.push_back(input.time);
  }
  std::vector<ExposedFrame> frames;
  for (std::size_t k = 0; k < images.size(); ++k) {
    frames.push_back({&images[k], {times[k], GainDb{}}});
  }
  Image<std::uint8_t> mask;
  if (!arguments.mask.empty()) {
    OMNIHDR_ASSIGN(
        mask, LoadPictureMask(arguments.mask, images.front().width(), images.front().height()));
  }
  OMNIHDR_ASSIGN(const MeasureOptions options, MeasureOptionsOf(arguments));
  std::vector<std::string> names;
  for (const std::string& text : arguments.images) {
    names.push_back(std::filesystem::path(text.substr(0, text.rfind('@'))).filename().string());
  }
  const Projection projection =
      Projection::Equirectangular(images.front().width(), images.front().height());
  const auto measure = [&](std::span<const ExposedFrame> some) {
    return Measure(some, projection, response, arguments.bits, mask.view(), options);
  };
  OMNIHDR_ASSIGN(
      MergedBracket merged,
      MergeBracket(std::move(frames), names, measure, response, arguments.bits, mask.view(),
                   options, arguments.no_refine ? 0.0 : arguments.refine_limit,
                   arguments.report || arguments.json));
  for (const std::string& note : merged.notes) fmt::print(stderr, "{}\n", note);
  MergedView view = ViewOfMeasurement(merged.measurement);
  float largest = 0.0F;
  for (const float v : view.radiance.values()) largest = std::max(largest, v);
  const ExrPixelType type =
      arguments.exr_type == "float" ? ExrPixelType::kFloat : SmallestType(view.radiance);
  ExrAttributes attributes;
  const bool is_latlong = images.front().width() == 2 * images.front().height();
  attributes.envmap = is_latlong ? ExrEnvmap::kLatLong : ExrEnvmap::kNone;
  attributes.floats["expTime"] = merged.measurement.longest_exposure_s;
  if (arguments.exr_type != "float" && type == ExrPixelType::kFloat) {
    fmt::print(stderr, "{}: radiance up to {:.4g} exceeds half precision: stored as float\n",
               arguments.out, largest);
  }
  std::vector<std::byte> jpeg;
  if (!arguments.preview.empty()) {
    OMNIHDR_ASSIGN(jpeg, EncodeJpeg(ToneMapReinhard(view.radiance, ToneMapOptions{}), 92));
  }
  MarkNan(view.origin, NanOf(arguments.nan), &view.radiance);
  OMNIHDR_TRY(WriteRadianceFile(
      arguments.out, {&view.radiance, &view.origin, nullptr, type, std::move(attributes)}));
  if (!jpeg.empty()) OMNIHDR_TRY(WriteFileAtomic(arguments.preview, jpeg));
  merged.summary.title = fmt::format("{}: {} exposures of {}x{}", arguments.out, images.size(),
                                     images.front().width(), images.front().height());
  if (arguments.json) {
    fmt::print("{}\n", JsonOf(merged.summary));
  } else if (arguments.report) {
    fmt::print("{}", TextOf(merged.summary));
  } else {
    fmt::print("{}, radiance up to {:.4g}, {:.2f} % clipped in every one\n", merged.summary.title,
               largest, merged.summary.clipped_percent);
  }
  return 0;
}

}  // namespace

void AddMergeCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand(
      "merge", "Merge pictures taken from one place at several exposures into one radiance map");
  auto arguments = std::make_shared<MergeArguments>();
  command->add_option("images", arguments->images, "IMAGE@SECONDS, as in a.png@0.5 or a.png@1/60")
      ->required();
  command->add_option("--out", arguments->out, "EXR file to write")->required();
  command->add_option("--mask", arguments->mask, "picture of the images' size, white = use");
  command->add_option("--preview", arguments->preview, "tone-mapped JPEG to write as well");
  command
      ->add_option("--response", arguments->response,
                   "linear, srgb, or a file: a session.json, or what calibrate response wrote")
      ->capture_default_str();
  command
      ->add_option("--exr-type", arguments->exr_type,
                   "half or float numbers in the EXR file; half becomes float where it must")
      ->check(CLI::IsMember({"half", "float"}))
      ->capture_default_str();
  command->add_option("--bits", arguments->bits, "significant bits of 16-bit images")
      ->check(CLI::Range(8, 16))
      ->capture_default_str();
  command
      ->add_option("--weights", arguments->weights,
                   "of the exposures: inverse-variance of the noise, or hat over the values")
      ->check(CLI::IsMember({"inverse-variance", "hat"}))
      ->capture_default_str();
  AddWhiteBalanceOption(command, "gains on R,G,B, as in 1.9,1,1.4", &arguments->white_balance);
  command
      ->add_option("--refine-limit", arguments->refine_limit,
                   "largest correction of an exposure time by the overlap of exposures, a fraction")
      ->check(CLI::Range(0.01, 0.5))
      ->capture_default_str();
  command->add_flag("--no-refine", arguments->no_refine, "take the exposure times as given");
  command
      ->add_option("--nan", arguments->nan,
                   "pixels that are NaN instead of an estimate: never, no-data (masked) or "
                   "unmeasured (those, and clipped or dark in every exposure)")
      ->check(CLI::IsMember({"never", "no-data", "unmeasured"}))
      ->capture_default_str();
  command->add_flag("--report", arguments->report,
                    "print under- and over-exposed pixels and the range of every exposure");
  command->add_flag("--json", arguments->json, "that report as JSON");
  command->callback([arguments, &run] { run = [arguments] { return Merge(*arguments); }; });
}

}  // namespace omnihdr
