#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cctype>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/photometry/tonemap.h"
#include "daemon/cli/command.h"
#include "daemon/evaluation/picture_files.h"

namespace omnihdr {
namespace {

struct ToneMapArguments {
  std::string in;
  std::string out;
  std::string tone_operator = "reinhard";
  std::string shape = "auto";
  int quality = 92;
  std::optional<double> heading_deg;
  ToneMapOptions options;
};

std::string LowerCaseExtension(const std::filesystem::path& path) {
  std::string extension = path.extension().string();
  std::transform(extension.begin(), extension.end(), extension.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  return extension;
}

PictureShape ShapeOf(const std::string& name, const Picture& picture) {
  if (name == "cylinder") return PictureShape::kCylinder;
  if (name == "latlong" || (name == "auto" && picture.looks_lat_long())) {
    return PictureShape::kSphere;
  }
  return PictureShape::kPlane;
}

Result<int> ToneMapFile(const ToneMapArguments& arguments) {
  const std::string extension = LowerCaseExtension(arguments.out);
  const bool is_jpeg = extension == ".jpg" || extension == ".jpeg";
  if (!is_jpeg && extension != ".png") {
    return Fail(ErrorKind::kUsage, "{}: expected a file name that ends in .png, .jpg or .jpeg",
                arguments.out);
  }
  ToneMapOptions options = arguments.options;
  options.tone_operator = *ToneOperatorFromString(arguments.tone_operator);
  OMNIHDR_ASSIGN(const Picture picture, LoadPicture(arguments.in));
  if (!picture.is_radiance) {
    return Fail(ErrorKind::kData, "{}: code values, expected radiance (an EXR)", picture.name);
  }
  options.shape = ShapeOf(arguments.shape, picture);
  const bool is_sphere = options.shape == PictureShape::kSphere;
  if (arguments.heading_deg && !(is_sphere && is_jpeg)) {
    return Fail(ErrorKind::kUsage, "--heading: expected a lat-long picture and a JPEG file");
  }
  const Image<std::uint8_t> mapped = ToneMap(picture.pixels, options);
  std::vector<std::byte> bytes;
  if (!is_jpeg) {
    OMNIHDR_ASSIGN(bytes, EncodePng(mapped.view(), 6));
  } else if (is_sphere) {
    PhotoSphere sphere{.full_width = mapped.width(), .full_height = mapped.height()};
    sphere.heading_deg = arguments.heading_deg;
    OMNIHDR_ASSIGN(bytes, EncodeJpeg(mapped.view(), arguments.quality, sphere));
  } else {
    OMNIHDR_ASSIGN(bytes, EncodeJpeg(mapped.view(), arguments.quality));
  }
  OMNIHDR_TRY(WriteFileAtomic(arguments.out, bytes));
  fmt::print("{}: {}x{}, {}{}\n", arguments.out, mapped.width(), mapped.height(),
             ToString(options.tone_operator),
             is_sphere && is_jpeg ? ", opens as a 360 degree photo" : "");
  return 0;
}

}  // namespace

void AddToneMapCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command =
      app.add_subcommand("tonemap", "Show a radiance map on a screen: an EXR as PNG or JPEG");
  auto arguments = std::make_shared<ToneMapArguments>();
  ToneMapOptions& options = arguments->options;
  command->add_option("IN", arguments->in, "EXR file, or a view's directory")->required();
  command->add_option("OUT", arguments->out, "PNG or JPEG file to write, by its ending")
      ->required();
  command
      ->add_option("--operator", arguments->tone_operator,
                   "reinhard (global), reinhard-local, drago or durand")
      ->check(CLI::IsMember({"reinhard", "reinhard-local", "drago", "durand"}))
      ->capture_default_str();
  command->add_option("--exposure", options.exposure_stops, "Stops over the automatic exposure")
      ->check(CLI::Range(-20.0, 20.0))
      ->capture_default_str();
  command
      ->add_option("--key", options.key,
                   "What the average becomes, 0.18 = middle grey (not of durand)")
      ->check(CLI::Range(1e-4, 1.0))
      ->capture_default_str();
  command
      ->add_option("--white", options.white_percentile,
                   "Share of the picture that stays below white")
      ->check(CLI::Range(0.5, 1.0))
      ->capture_default_str();
  command->add_option("--sharpening", options.sharpening, "reinhard-local: strength at edges")
      ->check(CLI::Range(0.0, 20.0))
      ->capture_default_str();
  command
      ->add_option("--threshold", options.threshold,
                   "reinhard-local: contrast at which a neighbourhood ends")
      ->check(CLI::Range(1e-4, 1.0))
      ->capture_default_str();
  command->add_option("--bias", options.bias, "drago: smaller lifts the dark parts more")
      ->check(CLI::Range(0.5, 1.0))
      ->capture_default_str();
  command
      ->add_option("--contrast", options.contrast_decades,
                   "durand: decades the large-scale contrast becomes")
      ->check(CLI::Range(0.3, 10.0))
      ->capture_default_str();
  command
      ->add_option("--shape", arguments->shape,
                   "latlong or cylinder (left and right edge are neighbours), plane, or auto: "
                   "latlong for a picture twice as wide as high")
      ->check(CLI::IsMember({"auto", "latlong", "cylinder", "plane"}))
      ->capture_default_str();
  command
      ->add_option("--heading", arguments->heading_deg,
                   "Compass bearing of the picture's middle in degrees, told to 360 degree viewers")
      ->check(CLI::Range(0.0, 359.999));
  command->add_option("--quality", arguments->quality, "of a JPEG")
      ->check(CLI::Range(1, 100))
      ->capture_default_str();
  command->callback([arguments, &run] { run = [arguments] { return ToneMapFile(*arguments); }; });
}

}  // namespace omnihdr
