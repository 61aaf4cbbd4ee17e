#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cctype>
#include <chrono>
#include <cmath>
#include <filesystem>
#include <map>
#include <memory>
#include <numbers>
#include <optional>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/sphere/sphere_grid.h"
#include "core/sphere/sphere_remap.h"
#include "daemon/cli/command.h"
#include "daemon/cli/grid_option.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

struct ConvertArguments {
  std::string in;
  std::string out;
  std::string to;
  std::string from;
  std::vector<double> z_range;
  std::vector<double> from_z_range;
  int size = 0;
  int quality = 92;
};

enum class FileKind { kExr, kPng, kJpeg, kTiff };

Result<FileKind> KindOfFile(const fs::path& path) {
  static const std::map<std::string, FileKind> kinds = {
      {".exr", FileKind::kExr},   {".png", FileKind::kPng},  {".jpg", FileKind::kJpeg},
      {".jpeg", FileKind::kJpeg}, {".tif", FileKind::kTiff}, {".tiff", FileKind::kTiff}};
  std::string suffix = path.extension().string();
  std::transform(suffix.begin(), suffix.end(), suffix.begin(),
                 [](unsigned char c) { return static_cast<char>(std::tolower(c)); });
  const auto found = kinds.find(suffix);
  if (found != kinds.end()) return found->second;
  return Fail(ErrorKind::kUsage, "{}: suffix \"{}\", expected .exr, .png, .jpg or .tif",
              path.string(), suffix);
}

struct Band {
  double z_min = 0.0;
  double z_max = 0.0;
};

Result<Band> BandOf(const char* option, const std::vector<double>& range, Band otherwise) {
  if (range.empty()) return otherwise;
  if (range[0] < range[1] && std::abs(range[0]) <= 1000.0 && std::abs(range[1]) <= 1000.0) {
    return Band{range[0], range[1]};
  }
  return Fail(ErrorKind::kUsage, "{}: {:g} {:g}, expected two rising numbers in [-1000, 1000]",
              option, range[0], range[1]);
}

// `attributes`: of an EXR file, which may tell; nullptr for other pictures.
Result<SphereGrid> SourceGrid(const ConvertArguments& arguments, int width, int height,
                              const ExrAttributes* attributes) {
  std::string name = arguments.from;
  Band told;
  if (attributes != nullptr) {
    const auto own = attributes->strings.find(kProjectionAttribute);
    if (name.empty() && attributes->envmap == ExrEnvmap::kLatLong) name = "latlong";
    if (name.empty() && attributes->envmap == ExrEnvmap::kCube) name = "cube-strip";
    if (name.empty() && own != attributes->strings.end()) name = own->second;
    const auto z_min = attributes->floats.find(kZMinAttribute);
    const auto z_max = attributes->floats.find(kZMaxAttribute);
    if (z_min != attributes->floats.end() && z_max != attributes->floats.end()) {
      told = {z_min->second, z_max->second};
    }
  }
  if (name.empty() && width == 2 * height) name = "latlong";
  if (name.empty() && height == 6 * width) name = "cube-strip";
  if (name == "cube") name = height == 6 * width ? "cube-strip" : "cube-cross";
  if (name.empty()) {
    return Fail(ErrorKind::kData,
                "{}: {}x{} pixels do not tell the projection, expected --from latlong, cylinder, "
                "cube or rdmap",
                arguments.in, width, height);
  }
  const std::optional<SphereGridKind> kind = SphereGridKindFromString(name);
  if (!kind) {
    return Fail(ErrorKind::kData, "{}: {}: \"{}\", expected latlong, cylinder, cube or rdmap",
                arguments.in, kProjectionAttribute, name);
  }
  if (!arguments.from_z_range.empty() && *kind != SphereGridKind::kCylindrical) {
    return Fail(ErrorKind::kUsage, "--from-z-range: {} is a {}, expected a cylinder", arguments.in,
                name);
  }
  OMNIHDR_ASSIGN(const Band band, BandOf("--from-z-range", arguments.from_z_range, told));
  return SphereGrid::OfPicture(*kind, width, height, band.z_min, band.z_max)
      .Context(fmt::format("{}: as {}", arguments.in, name));
}

Result<SphereGrid> TargetGrid(const ConvertArguments& arguments, const SphereGrid& source,
                              FileKind file) {
  std::string name = arguments.to;
  if (name == "cube") name = file == FileKind::kExr ? "cube-strip" : "cube-cross";
  const SphereGridKind kind = *SphereGridKindFromString(name);
  if (!arguments.z_range.empty() && kind != SphereGridKind::kCylindrical) {
    return Fail(ErrorKind::kUsage, "--z-range: with --to {}, expected --to cylinder", arguments.to);
  }
  OMNIHDR_ASSIGN(const Band band,
                 BandOf("--z-range", arguments.z_range, {-kCylinderZ, kCylinderZ}));
  return GridToWrite(kind, arguments.size, source, band.z_min, band.z_max);
}

// Calls `apply` with the tables of one stripe of the target after the other, so that the tables of
// a large picture do not have to fit into memory at once.
template <typename Apply>
void InStripes(const SphereGrid& target, const SphereGrid& source, const Apply& apply) {
  constexpr int kPixelsAtOnce = 1 << 22;
  SphereRemapOptions options;
  options.rows = std::max(kPixelsAtOnce / target.width(), 1);
  for (; options.first_row < target.height(); options.first_row += options.rows) {
    apply(SphereRemap(target, source, options));
  }
}

// Whether a channel holds names of things, which have no in-between.
bool IsLabels(const std::string& name, ExrPixelType type) {
  const std::string channel = name.substr(name.rfind('.') + 1);  // a layer's too
  return type == ExrPixelType::kUint || channel == "origin" || channel == "sources";
}

struct Converted {
  SphereGrid source;
  SphereGrid target;
  std::string what;  // "8-bit", "5 channels"
};

Result<Converted> ConvertExr(const ConvertArguments& arguments) {
  OMNIHDR_ASSIGN(ExrImage image, ReadExr(arguments.in));
  OMNIHDR_ASSIGN(const SphereGrid source,
                 SourceGrid(arguments, image.width, image.height, &image.attributes));
  OMNIHDR_ASSIGN(const SphereGrid target, TargetGrid(arguments, source, FileKind::kExr));
  std::map<std::string, Image<float>> out;
  for (const auto& [name, pixels] : image.channels) {
    out.emplace(name, Image<float>::Uninitialized(target.width(), target.height()));
  }
  InStripes(target, source, [&](const SphereRemap& remap) {
    for (const auto& [name, pixels] : image.channels) {
      Image<float>& converted = out.at(name);
      if (IsLabels(name, image.types.at(name))) {
        remap.ApplyNearest(pixels, converted.view());
      } else {
        remap.Apply(pixels, converted.view());
      }
    }
  });
  std::vector<ExrChannel> channels;
  for (const auto& [name, pixels] : out) {
    channels.push_back({name, pixels, image.types.at(name), 0});
  }
  OMNIHDR_TRY(WriteExrAtomic(arguments.out, channels,
                             AttributesFor(target, std::move(image.attributes)),
                             ExrCompression::kPiz));
  return Converted{source, target, fmt::format("{} channels", channels.size())};
}

Result<std::vector<std::byte>> Encode(ImageView<const std::uint8_t> image, FileKind kind,
                                      bool is_latlong, int quality) {
  if (kind == FileKind::kPng) return EncodePng(image);
  if (kind == FileKind::kTiff) return EncodeTiff(image);
  return EncodeJpeg(image, quality, is_latlong);
}

Result<std::vector<std::byte>> Encode(ImageView<const std::uint16_t> image, FileKind kind, bool,
                                      int) {
  if (kind == FileKind::kPng) return EncodePng(image);
  if (kind == FileKind::kTiff) return EncodeTiff(image);
  return Fail(ErrorKind::kUsage, "JPEG holds 8 bits, expected .png or .tif for a 16-bit picture");
}

Result<Converted> ConvertPicture(const ConvertArguments& arguments, FileKind kind) {
  OMNIHDR_ASSIGN(const DecodedImage image, ReadImage(arguments.in));
  OMNIHDR_ASSIGN(const SphereGrid source,
                 SourceGrid(arguments, image.width(), image.height(), nullptr));
  OMNIHDR_ASSIGN(const SphereGrid target, TargetGrid(arguments, source, kind));
  const bool is_latlong = target.kind() == SphereGridKind::kEquirectangular;
  const Result<std::vector<std::byte>> bytes = std::visit(
      [&]<typename T>(const Image<T>& pixels) {
        auto out = Image<T>::Uninitialized(target.width(), target.height(), pixels.channels());
        InStripes(target, source,
                  [&](const SphereRemap& remap) { remap.Apply(pixels, out.view()); });
        return Encode(ImageView<const T>(out), kind, is_latlong, arguments.quality);
      },
      image.pixels);
  if (!bytes) return Forward(bytes.error(), arguments.out);
  OMNIHDR_TRY(WriteFileAtomic(arguments.out, *bytes));
  return Converted{source, target, image.is_16_bit() ? "16-bit" : "8-bit"};
}

Result<int> Convert(const ConvertArguments& arguments) {
  OMNIHDR_ASSIGN(const FileKind from, KindOfFile(arguments.in));
  OMNIHDR_ASSIGN(const FileKind to, KindOfFile(arguments.out));
  if ((from == FileKind::kExr) != (to == FileKind::kExr)) {
    return Fail(ErrorKind::kUsage,
                "{}: expected {}: converting changes the projection and keeps the values",
                arguments.out, from == FileKind::kExr ? ".exr" : ".png, .jpg or .tif");
  }
  const auto start = std::chrono::steady_clock::now();
  OMNIHDR_ASSIGN(const Converted converted,
                 to == FileKind::kExr ? ConvertExr(arguments) : ConvertPicture(arguments, to));
  const double seconds =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  fmt::print("{}: {} from {}, {}, {:.2f} s\n", arguments.out, Shown(converted.target),
             Shown(converted.source), converted.what, seconds);
  const double covered = converted.source.CoveredSolidAngle() / (4.0 * std::numbers::pi);
  if (covered < 1.0 && converted.target.kind() != SphereGridKind::kCylindrical) {
    fmt::print("{:.1f} % of the sphere is not in {}: {} there\n", 100.0 * (1.0 - covered),
               arguments.in, to == FileKind::kExr ? "NaN" : "black");
  }
  return 0;
}

}  // namespace

void AddConvertCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand(
      "convert",
      "Convert a picture of all directions into another projection (EXR to EXR with all "
      "channels, PNG, JPEG or TIFF to any of these)");
  auto arguments = std::make_shared<ConvertArguments>();
  const CLI::IsMember kinds({"latlong", "cylinder", "cube", "cube-cross", "cube-strip", "rdmap"});
  command->add_option("IN", arguments->in, "Picture to read")->required();
  command->add_option("OUT", arguments->out, "Picture to write")->required();
  command
      ->add_option("--to", arguments->to,
                   "latlong, cylinder, rdmap or cube: a cross of faces, in EXR OpenEXR's strip of "
                   "six (cube-cross, cube-strip for either)")
      ->required()
      ->check(kinds);
  command
      ->add_option("--from", arguments->from,
                   "The same of the picture read [what an EXR file says, or a shape of 2:1 or 1:6]")
      ->check(kinds);
  command
      ->add_option("--size", arguments->size,
                   "Width of a latlong or cylinder, or of a face of a cube or rdmap, in pixels [as "
                   "fine as the picture read]")
      ->check(CLI::Range(1, 65536));
  command
      ->add_option("--z-range", arguments->z_range,
                   "Lowest and highest tangent of the elevation on a cylinder [-2.356 2.356]")
      ->expected(2);
  command
      ->add_option("--from-z-range", arguments->from_z_range,
                   "The same of the cylinder read [square pixels, as far up as down]")
      ->expected(2);
  command->add_option("--quality", arguments->quality, "JPEG quality")
      ->check(CLI::Range(1, 100))
      ->capture_default_str();
  command->callback([arguments, &run] { run = [arguments] { return Convert(*arguments); }; });
}

}  // namespace omnihdr
