#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <memory>
#include <string>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "daemon/cli/command.h"
#include "daemon/evaluation/comparison.h"

namespace omnihdr {
namespace {

struct CompareArguments {
  std::string tested;
  std::string reference;
  std::string mask;
  std::string difference;
  std::string scale = "median";
  bool planar = false;
  bool latlong = false;
  bool json = false;
  double full = 0.0;
};

Result<int> Compare(const CompareArguments& arguments) {
  ComparisonOptions options;
  options.mask = arguments.mask;
  options.scale = arguments.scale == "none" ? ScaleFit::kNone : ScaleFit::kMedian;
  using Area = ComparisonOptions::Area;
  if (arguments.planar) options.area = Area::kPlane;
  if (arguments.latlong) options.area = Area::kSphere;
  OMNIHDR_ASSIGN(const Comparison comparison,
                 ComparePictures(arguments.tested, arguments.reference, options));
  if (!arguments.difference.empty()) {
    // A factor of two, or an eighth of the peak.
    const double full = arguments.full > 0.0     ? arguments.full
                        : comparison.is_radiance ? 0.30103
                                                 : 0.125;
    OMNIHDR_ASSIGN(const std::vector<std::byte> png,
                   EncodePng(DifferencePicture(comparison, full).view(), 6));
    OMNIHDR_TRY(WriteFileAtomic(arguments.difference, png));
  }
  fmt::print("{}",
             arguments.json ? FormatComparisonJson(comparison) : FormatComparisonTable(comparison));
  return 0;
}

}  // namespace

void AddCompareCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand(
      "compare",
      "Say how two pictures differ: radiance maps (EXR, view directories) or code values");
  auto arguments = std::make_shared<CompareArguments>();
  command->add_option("TESTED", arguments->tested, "EXR, PNG, JPEG, TIFF, or a view's directory")
      ->required();
  command->add_option("REFERENCE", arguments->reference, "What it ought to be, of the same kind")
      ->required();
  command->add_option("--mask", arguments->mask, "Picture of the same size: white = compare");
  command
      ->add_option("--scale", arguments->scale,
                   "Radiance: median (relative maps have no absolute scale) or none")
      ->check(CLI::IsMember({"median", "none"}))
      ->capture_default_str();
  auto* planar = command->add_flag("--planar", arguments->planar, "Every pixel counts the same");
  command
      ->add_flag("--latlong", arguments->latlong,
                 "Pixels count by solid angle [a picture twice as wide as high]")
      ->excludes(planar);
  auto* difference =
      command->add_option("--diff", arguments->difference, "PNG of the difference to write");
  command
      ->add_option("--full", arguments->full,
                   "Difference shown as full colour: decades of luminance [0.301], or share of the "
                   "peak [0.125]")
      ->check(CLI::Range(1e-4, 10.0))
      ->needs(difference);
  command->add_flag("--json", arguments->json, "Print one JSON object instead of a table");
  command->callback([arguments, &run] { run = [arguments] { return Compare(*arguments); }; });
}

}  // namespace omnihdr
