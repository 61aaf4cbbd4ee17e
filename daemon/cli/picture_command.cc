#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <system_error>
#include <vector>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/quality/radiance_metrics.h"
#include "core/session/view_writer.h"
#include "core/stereo/view_merge.h"
#include "daemon/cli/command.h"
#include "daemon/evaluation/false_colour.h"
#include "daemon/evaluation/picture_files.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

struct PictureArguments {
  std::string in;
  std::string what = "radiance";
  std::string out;
  std::optional<double> low;
  std::optional<double> high;
};

struct Source {
  fs::path file;
  std::string unit = "b";  // of distance: metre, or the first baseline
};

// The file of a view that has what is asked for, or the file named.
Source SourceOf(const PictureArguments& arguments) {
  Source source{arguments.in};
  std::error_code error;
  if (!fs::is_directory(source.file, error)) return source;
  const Result<std::string> text = ReadTextFile(source.file / "view.json");
  if (text) {
    const Result<ViewRecord> record = ParseViewRecord(*text, arguments.in);
    if (record) source.unit = record->metric_scale ? "m" : "b";
  }
  const bool is_radiance = arguments.what == "radiance" || arguments.what == "mask";
  source.file /= is_radiance ? "radiance.exr" : "disparity.exr";
  return source;
}

Result<const Image<float>*> ChannelOf(const ExrImage& exr, const std::string& name,
                                      const fs::path& file) {
  const auto found = exr.channels.find(name);
  if (found != exr.channels.end()) return &found->second;
  std::string have;
  for (const auto& [channel, pixels] : exr.channels) have += (have.empty() ? "" : ", ") + channel;
  return Fail(ErrorKind::kData, "{}: no channel \"{}\"; has {}", file.string(), name,
              have.empty() ? "none" : have);
}

Result<Image<std::uint8_t>> RadiancePicture(const ExrImage& exr, const Source& source,
                                            const PictureArguments& arguments) {
  OMNIHDR_ASSIGN(const Image<float> radiance, RadianceOf(exr, source.file.string()));
  const Image<float> luminance = LuminanceOf(radiance);
  LuminanceRange range = RangeOf(luminance);
  range.low = arguments.low.value_or(range.low);
  range.high = arguments.high.value_or(range.high);
  if (!(range.low > 0.0 && range.high > range.low)) {
    return Fail(ErrorKind::kUsage, "--min {:g}, --max {:g}: expected 0 < min < max", range.low,
                range.high);
  }
  ScaleBar bar;
  bar.title = "luminance, relative (1 = pixel value 128 at 1 s), logarithmic";
  bar.ticks = RadianceTicks(range.low, range.high);
  return WithScaleBar(LevelColours(RadianceLevels(luminance, range.low, range.high)), bar);
}

Result<Image<std::uint8_t>> DisparityPicture(const ExrImage& exr, const Source& source,
                                             const PictureArguments& arguments) {
  OMNIHDR_ASSIGN(const Image<float>* disparity, ChannelOf(exr, "disparity", source.file));
  const double nearest = arguments.high.value_or(NearDisparity(*disparity));
  if (arguments.low || !(nearest >= 0.0)) {
    return Fail(ErrorKind::kUsage,
                "disparity begins at 0 (infinitely far): expected --max alone, 0 or more");
  }
  ScaleBar bar;
  bar.title = fmt::format("disparity = 1/distance, distance in {}: near warm, far cool",
                          source.unit == "m" ? "m" : "b, the first baseline's length");
  bar.ticks = DisparityTicks(nearest, source.unit);
  return WithScaleBar(DisparityColours(*disparity, nearest), bar);
}

Result<Image<std::uint8_t>> ConfidencePicture(const ExrImage& exr, const Source& source,
                                              const PictureArguments& arguments) {
  OMNIHDR_ASSIGN(const Image<float>* confidence, ChannelOf(exr, "confidence", source.file));
  const double low = arguments.low.value_or(0.0);
  const double high = arguments.high.value_or(1.0);
  if (!(high > low))
    return Fail(ErrorKind::kUsage, "--min {:g}, --max {:g}: expected min < max", low, high);
  Image<float> levels = confidence->Clone();
  for (float& level : levels.values()) {
    level = static_cast<float>((static_cast<double>(level) - low) / (high - low));
  }
  ScaleBar bar;
  bar.title = "confidence of the disparity";
  for (int i = 0; i <= 4; ++i) {
    bar.ticks.push_back({0.25 * i, fmt::format("{:.3g}", low + 0.25 * i * (high - low))});
  }
  return WithScaleBar(LevelColours(levels), bar);
}

Result<Image<std::uint8_t>> MaskPicture(const ExrImage& exr, const Source& source) {
  OMNIHDR_ASSIGN(const Image<float>* origin, ChannelOf(exr, "origin", source.file));
  const auto code = [](PixelOrigin o) { return static_cast<float>(o); };
  const std::vector<Kind> legend = {{code(PixelOrigin::kMeasured), "measured", 80, 160, 90},
                                    {code(PixelOrigin::kClipped), "clipped", 230, 70, 40},
                                    {code(PixelOrigin::kDark), "too dark", 50, 70, 160},
                                    {code(PixelOrigin::kNoData), "no data", 0, 0, 0}};
  return WithLegend(KindColours(*origin, legend), "origin", legend);
}

Result<int> DrawPicture(const PictureArguments& arguments) {
  const Source source = SourceOf(arguments);
  OMNIHDR_ASSIGN(const ExrImage exr, ReadExr(source.file));
  const auto draw = [&]() -> Result<Image<std::uint8_t>> {
    if (arguments.what == "disparity") return DisparityPicture(exr, source, arguments);
    if (arguments.what == "confidence") return ConfidencePicture(exr, source, arguments);
    if (arguments.what == "mask") return MaskPicture(exr, source);
    return RadiancePicture(exr, source, arguments);
  };
  OMNIHDR_ASSIGN(const Image<std::uint8_t> picture, draw());
  OMNIHDR_ASSIGN(const std::vector<std::byte> png, EncodePng(picture.view(), 6));
  OMNIHDR_TRY(WriteFileAtomic(arguments.out, png));
  return 0;
}

}  // namespace

void AddPictureCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand(
      "picture", "Draw a map of a view in colours, with a scale bar: radiance, disparity, ...");
  auto arguments = std::make_shared<PictureArguments>();
  command->add_option("IN", arguments->in, "A view's directory, or an EXR file")->required();
  command
      ->add_option("--what", arguments->what,
                   "radiance (logarithmic), disparity, confidence, or mask: where pixels come from")
      ->check(CLI::IsMember({"radiance", "disparity", "confidence", "mask"}))
      ->capture_default_str();
  command->add_option("--out", arguments->out, "PNG file to write")->required();
  command->add_option("--min", arguments->low, "Value at the cool end [from the picture]");
  command->add_option("--max", arguments->high, "Value at the warm end [from the picture]");
  command->callback([arguments, &run] { run = [arguments] { return DrawPicture(*arguments); }; });
}

}  // namespace omnihdr
