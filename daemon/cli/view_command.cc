#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <limits>
#include <map>
#include <memory>
#include <string>
#include <utility>
#include <vector>

#include "core/base/file.h"
#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/photometry/tonemap.h"
#include "core/pipeline/view_files.h"
#include "core/session/view_writer.h"
#include "core/stereo/view_merge.h"
#include "core/stereo/view_synthesis.h"
#include "daemon/cli/command.h"
#include "daemon/cli/radiance_file.h"
#include "daemon/evaluation/view_files.h"

namespace omnihdr {
namespace {

struct ViewArguments {
  std::string session;
  std::string views;
  std::string out;
  std::string preview;
  std::vector<double> at;
  std::vector<std::int64_t> between;
  std::int64_t place_of = -1;
  double fraction = 0.5;
  int chain = -1;
  int sources = 4;
  int width = 0;
};

using Records = std::map<std::int64_t, ViewRecord>;

Result<Records> ReadRecords(const std::filesystem::path& views) {
  OMNIHDR_ASSIGN(const std::vector<PositionId> complete, CompleteViews(views));
  Records records;
  for (const PositionId position : complete) {
    OMNIHDR_ASSIGN(ViewRecord record, ReadViewRecord(views, position));
    if (record.mode == "spatiotemporal") records.emplace(Value(position), std::move(record));
  }
  if (records.empty()) {
    return Fail(ErrorKind::kData, "{}: no view with a pose and disparity, expected one or more",
                views.string());
  }
  return records;
}

// Where to look from, and the views of that chain by their distance from there.
struct Viewpoint {
  Eigen::Vector3d place = Eigen::Vector3d::Zero();
  int chain = 0;
};

Result<const ViewRecord*> RecordOf(const Records& records, std::int64_t position,
                                   const char* option) {
  const auto found = records.find(position);
  if (found != records.end()) return &found->second;
  return Fail(ErrorKind::kUsage, "{}: {}, expected a position with a view, {} to {}", option,
              position, records.begin()->first, records.rbegin()->first);
}

Result<Viewpoint> ViewpointOf(const ViewArguments& arguments, const Records& records) {
  const int given = (arguments.at.empty() ? 0 : 1) + (arguments.between.empty() ? 0 : 1) +
                    (arguments.place_of < 0 ? 0 : 1);
  if (given != 1) {
    return Fail(ErrorKind::kUsage, "expected one of --at, --between and --place-of");
  }
  Viewpoint viewpoint;
  if (arguments.place_of >= 0) {
    OMNIHDR_ASSIGN(const ViewRecord* there, RecordOf(records, arguments.place_of, "--place-of"));
    return Viewpoint{there->pose.translation, there->chain};
  }
  if (!arguments.between.empty()) {
    OMNIHDR_ASSIGN(const ViewRecord* a, RecordOf(records, arguments.between[0], "--between"));
    OMNIHDR_ASSIGN(const ViewRecord* b, RecordOf(records, arguments.between[1], "--between"));
    if (a->chain != b->chain) {
      return Fail(ErrorKind::kUsage,
                  "--between: {} and {} are of different chains ({} and {}), expected positions "
                  "that are linked",
                  arguments.between[0], arguments.between[1], a->chain, b->chain);
    }
    viewpoint.place =
        (1.0 - arguments.fraction) * a->pose.translation + arguments.fraction * b->pose.translation;
    viewpoint.chain = a->chain;
    return viewpoint;
  }
  viewpoint.place = Eigen::Vector3d(arguments.at[0], arguments.at[1], arguments.at[2]);
  viewpoint.chain = arguments.chain >= 0 ? arguments.chain : records.begin()->second.chain;
  return viewpoint;
}

Result<std::vector<std::int64_t>> NearestOf(const ViewArguments& arguments, const Records& records,
                                            const Viewpoint& viewpoint) {
  std::vector<std::pair<double, std::int64_t>> order;
  for (const auto& [position, record] : records) {
    if (record.chain != viewpoint.chain || position == arguments.place_of) continue;
    order.emplace_back((record.pose.translation - viewpoint.place).norm(), position);
  }
  if (order.empty()) {
    return Fail(ErrorKind::kUsage, "chain {}: no other view, expected one or more",
                viewpoint.chain);
  }
  std::sort(order.begin(), order.end());
  if (order.size() > static_cast<std::size_t>(arguments.sources)) {
    order.resize(static_cast<std::size_t>(arguments.sources));
  }
  std::vector<std::int64_t> nearest;
  for (const auto& [distance, position] : order) nearest.push_back(position);
  return nearest;
}

Result<SynthesisSource> SourceOf(const std::filesystem::path& views, std::int64_t position) {
  OMNIHDR_ASSIGN(ViewFiles view, ReadView(views, PositionId{position}));
  if (view.disparity.empty()) {
    return Fail(ErrorKind::kData, "{}: no disparity.exr",
                (views / ViewDirectoryName(PositionId{position})).string());
  }
  // Where nothing was measured the file holds zeros.
  for (int y = 0; y < view.origin.height(); ++y) {
    for (int x = 0; x < view.origin.width(); ++x) {
      if (view.origin.at(x, y) != static_cast<float>(PixelOrigin::kNoData)) continue;
      std::fill_n(view.radiance.pixel(x, y), 3, std::numeric_limits<float>::quiet_NaN());
    }
  }
  SynthesisSource source;
  source.radiance = std::move(view.radiance);
  source.disparity = std::move(view.disparity);
  source.world_from_output =
      view.record.pose * Pose{view.record.orientation, Eigen::Vector3d::Zero()};
  return source;
}

Status Write(const ViewArguments& arguments, SynthesizedView view) {
  Image<std::uint8_t> origin(view.disparity.width(), view.disparity.height());
  for (int y = 0; y < origin.height(); ++y) {
    for (int x = 0; x < origin.width(); ++x) {
      float* rgb = view.radiance.pixel(x, y);
      const bool known = std::isfinite(rgb[0]);
      origin.at(x, y) =
          static_cast<std::uint8_t>(known ? PixelOrigin::kMeasured : PixelOrigin::kNoData);
      if (!known) std::fill_n(rgb, 3, 0.0F);
    }
  }
  if (!arguments.preview.empty()) {
    ToneMapOptions options;
    options.shape = PictureShape::kSphere;
    OMNIHDR_ASSIGN(const std::vector<std::byte> jpeg,
                   EncodeJpeg(ToneMap(view.radiance, options), 92, true));
    OMNIHDR_TRY(WriteFileAtomic(arguments.preview, jpeg));
  }
  ExrAttributes attributes;
  attributes.envmap = ExrEnvmap::kLatLong;
  return WriteRadianceFile(arguments.out, {&view.radiance, &origin, &view.disparity,
                                           SmallestType(view.radiance), std::move(attributes)});
}

Result<int> View(const ViewArguments& arguments) {
  const std::filesystem::path views = arguments.views.empty()
                                          ? std::filesystem::path(arguments.session) / "views"
                                          : std::filesystem::path(arguments.views);
  OMNIHDR_ASSIGN(const Records records, ReadRecords(views));
  OMNIHDR_ASSIGN(const Viewpoint viewpoint, ViewpointOf(arguments, records));
  OMNIHDR_ASSIGN(const std::vector<std::int64_t> nearest, NearestOf(arguments, records, viewpoint));
  std::vector<SynthesisSource> sources;
  for (const std::int64_t position : nearest) {
    OMNIHDR_ASSIGN(SynthesisSource source, SourceOf(views, position));
    sources.push_back(std::move(source));
  }
  Pose target;
  target.translation = viewpoint.place;
  const int width = arguments.width != 0 ? arguments.width : sources.front().radiance.width();
  OMNIHDR_ASSIGN(SynthesizedView view, SynthesizeView(sources, target, width, SynthesisOptions{}));
  const double holes = view.holes;
  const double occluded = view.occluded;
  OMNIHDR_TRY(Write(arguments, std::move(view)));
  fmt::print(
      "{}: {}x{} from ({:.3f}, {:.3f}, {:.3f}), positions {}: {:.2f} % holes, {:.2f} % "
      "hidden from one of them\n",
      arguments.out, width, width / 2, viewpoint.place.x(), viewpoint.place.y(),
      viewpoint.place.z(), fmt::join(nearest, ", "), 100.0 * holes, 100.0 * occluded);
  return 0;
}

}  // namespace

void AddViewCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand(
      "view",
      "Render the HDR panorama at a new place between those of a session's views, from the nearest "
      "of them");
  auto arguments = std::make_shared<ViewArguments>();
  command->add_option("SESSION", arguments->session, "Session directory")->required();
  command->add_option("--out", arguments->out, "EXR file to write")->required();
  command->add_option("--views", arguments->views, "Folder of the views [SESSION/views]");
  CLI::Option* at =
      command
          ->add_option(
              "--at", arguments->at,
              "Place in the world of the poses, as in 0.45,0,0 (metres, or the chain's unit)")
          ->delimiter(',')
          ->expected(3);
  command->add_option("--chain", arguments->chain, "Chain whose world --at means [the first]")
      ->check(CLI::NonNegativeNumber)
      ->needs(at);
  CLI::Option* between = command
                             ->add_option("--between", arguments->between,
                                          "Two positions to look from between, as in 3,4")
                             ->delimiter(',')
                             ->expected(2);
  command->add_option("--fraction", arguments->fraction, "Of the way from the first to the second")
      ->check(CLI::Range(0.0, 1.0))
      ->needs(between)
      ->capture_default_str();
  command
      ->add_option("--place-of", arguments->place_of,
                   "The place of this position, without its own view: to see how well others show "
                   "it")
      ->check(CLI::NonNegativeNumber);
  command->add_option("--sources", arguments->sources, "Views to take, the nearest")
      ->check(CLI::Range(1, 16))
      ->capture_default_str();
  command->add_option("--width", arguments->width, "Of the picture, in pixels [the views']")
      ->check(CLI::Range(16, 16384));
  command->add_option("--preview", arguments->preview, "Tone-mapped JPEG to write as well");
  command->callback([arguments, &run] { run = [arguments] { return View(*arguments); }; });
}

}  // namespace omnihdr
