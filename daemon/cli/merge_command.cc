#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <memory>
#include <string>
#include <vector>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/photometry/measure.h"
#include "core/photometry/tonemap.h"
#include "core/pipeline/view_files.h"
#include "core/session/response_json.h"
#include "core/session/session_reader.h"
#include "daemon/cli/command.h"
#include "daemon/cli/exposed_image.h"

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
};

// The inverse of the sRGB transfer curve, for pictures that were developed for screens.
Result<Response> SrgbResponse() {
  std::array<std::vector<double>, 3> ln;
  for (std::vector<double>& channel : ln) {
    for (int z = 0; z < 256; ++z) {
      const double v = std::max(z, 1) / 255.0 * (z == 0 ? 0.5 : 1.0);
      const double linear = v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
      channel.push_back(std::log(linear));
    }
  }
  return Response::Table(ln);
}

Result<Response> ResponseOf(const std::string& name) {
  if (name == "linear") return Response::Linear();
  if (name == "srgb") return SrgbResponse();
  OMNIHDR_ASSIGN(const std::string text, ReadTextFile(name));
  if (text.find("omnihdr-session") == std::string::npos) return ParseResponse(text, name);
  OMNIHDR_ASSIGN(const SessionInfo info, ParseSessionInfo(text, name));
  return info.response;
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
  OMNIHDR_ASSIGN(
      const Measurement measurement,
      Measure(frames, Projection::Equirectangular(images.front().width(), images.front().height()),
              response, arguments.bits, mask.view(), MeasureOptions{}));
  const MergedView view = ViewOfMeasurement(measurement);
  std::size_t clipped = 0;
  float largest = 0.0F;
  for (const std::uint8_t origin : view.origin.values()) {
    clipped += static_cast<PixelOrigin>(origin) == PixelOrigin::kClipped ? 1 : 0;
  }
  for (const float v : view.radiance.values()) largest = std::max(largest, v);
  const ExrPixelType type =
      arguments.exr_type == "float" ? ExrPixelType::kFloat : SmallestType(view.radiance);
  Image<float> origin(view.origin.width(), view.origin.height());
  std::copy(view.origin.values().begin(), view.origin.values().end(), origin.values().begin());
  ExrAttributes attributes;
  attributes.envmap = ExrEnvmap::kNone;
  attributes.strings["software"] = "omnihdr " OMNIHDR_VERSION;
  attributes.chromaticities = kRec709;
  OMNIHDR_TRY(WriteExrAtomic(arguments.out,
                             {{"R", view.radiance, type, 0},
                              {"G", view.radiance, type, 1},
                              {"B", view.radiance, type, 2},
                              {"origin", origin, ExrPixelType::kHalf, 0}},
                             attributes, ExrCompression::kPiz));
  if (!arguments.preview.empty()) {
    OMNIHDR_ASSIGN(const std::vector<std::byte> jpeg,
                   EncodeJpeg(ToneMapReinhard(view.radiance, ToneMapOptions{}), 92));
    OMNIHDR_TRY(WriteFileAtomic(arguments.preview, jpeg));
  }
  fmt::print("{}: {} exposures of {}x{}, radiance up to {:.4g}, {:.2f} % clipped in every one\n",
             arguments.out, images.size(), images.front().width(), images.front().height(), largest,
             100.0 * static_cast<double>(clipped) / static_cast<double>(view.origin.size()));
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
  command->callback([arguments, &run] { run = [arguments] { return Merge(*arguments); }; });
}

}  // namespace omnihdr
