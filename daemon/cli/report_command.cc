#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <map>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/image/exr.h"
#include "core/image/image_io.h"
#include "core/photometry/measure.h"
#include "core/pipeline/frame_measurer.h"
#include "core/pipeline/rig_masks.h"
#include "core/session/session_reader.h"
#include "core/session/view_writer.h"
#include "core/stereo/view_merge.h"
#include "daemon/cli/command.h"
#include "daemon/cli/exposure_table.h"
#include "daemon/config.h"

namespace omnihdr {
namespace {

struct ReportArguments {
  std::string session;
  std::string views;
  std::string mask;
  std::string config;
  std::int64_t position = -1;
  bool json = false;
};

// Range of what a written view measured; nothing measured when there is no such view.
RadianceRange RangeOfView(const std::filesystem::path& views, PositionId position) {
  const std::filesystem::path file = views / ViewDirectoryName(position) / "radiance.exr";
  std::error_code error;
  if (!std::filesystem::exists(file, error)) return {};
  Result<ExrImage> exr = ReadExr(file);
  if (!exr) return {};
  Image<float> rgb(exr->width, exr->height, 3);
  Image<std::uint8_t> counted(exr->width, exr->height, 1, 1);
  for (int c = 0; c < 3; ++c) {
    const auto channel = exr->channels.find(std::string(1, "RGB"[c]));
    if (channel == exr->channels.end()) return {};
    for (int y = 0; y < exr->height; ++y) {
      for (int x = 0; x < exr->width; ++x) rgb.at(x, y, c) = channel->second.at(x, y);
    }
  }
  const auto origin = exr->channels.find("origin");
  if (origin != exr->channels.end()) {
    for (int y = 0; y < exr->height; ++y) {
      for (int x = 0; x < exr->width; ++x) {
        constexpr auto kMeasured = static_cast<float>(PixelOrigin::kMeasured);
        counted.at(x, y) = origin->second.at(x, y) == kMeasured ? 1 : 0;
      }
    }
  }
  return RangeOfRadiance(rgb, counted);
}

class Reporter {
 public:
  Reporter(const ReportArguments& arguments, const PipelineOptions& options, SessionInfo info,
           FrameMeasurer measurer)
      : session_(arguments.session),
        views_(arguments.views.empty() ? session_ / "views"
                                       : std::filesystem::path(arguments.views)),
        options_(options),
        info_(std::move(info)),
        measurer_(std::move(measurer)) {
    measure_.value_low = options.value_low;
    measure_.value_high = options.value_high;
    measure_.noise = options.noise;
    measure_.weights = options.weights;
    measure_.white_balance = options.white_balance;
  }

  // The frames of one position as one bracket.
  Result<ExposureSummary> Bracket(PositionId position, const std::vector<FrameRecord>& records) {
    std::vector<DecodedImage> images;
    std::vector<ExposedFrame> frames;
    std::vector<std::string> names;
    for (const FrameRecord& record : records) {
      OMNIHDR_ASSIGN(DecodedImage image, Load(record));
      images.push_back(std::move(image));
      names.push_back(fmt::format("frame {}", Value(record.frame)));
    }
    for (std::size_t k = 0; k < records.size(); ++k) {
      frames.push_back({&images[k], records[k].exposure});
    }
    OMNIHDR_ASSIGN(MergedBracket merged,
                   MergeBracket(std::move(frames), names, Measurer(), info_.response,
                                info_.camera.bits, measurer_.frame_mask(), measure_,
                                options_.refine_exposure ? options_.refine_limit : 0.0, true));
    merged.summary.title = fmt::format("position {}: {} exposures of {}x{}", Value(position),
                                       records.size(), info_.camera.width, info_.camera.height);
    const RadianceRange view = RangeOfView(views_, position);
    for (ExposureRow& line : merged.summary.lines) line.recovered = view;
    return std::move(merged.summary);
  }

  // One line a position, for a camera that took one exposure at each.
  Result<ExposureSummary> Drive(const std::vector<FrameRecord>& records) {
    ExposureSummary summary;
    summary.title = fmt::format("{} positions, one exposure of {}x{} at each", records.size(),
                                info_.camera.width, info_.camera.height);
    for (const FrameRecord& record : records) {
      OMNIHDR_ASSIGN(const DecodedImage image, Load(record));
      const std::vector<ExposedFrame> frames = {{&image, record.exposure}};
      const std::vector<std::string> names = {fmt::format("position {}", Value(record.position))};
      OMNIHDR_ASSIGN(MergedBracket one,
                     MergeBracket(frames, names, Measurer(), info_.response, info_.camera.bits,
                                  measurer_.frame_mask(), measure_, 0.0, false));
      ExposureRow& line = one.summary.lines.front();
      line.range = one.summary.merged;
      line.refined.verdict = RefineVerdict::kNoOverlap;
      line.recovered = RangeOfView(views_, record.position);
      summary.lines.push_back(std::move(line));
    }
    return summary;
  }

 private:
  MeasureFrames Measurer() {
    return [this](std::span<const ExposedFrame> frames) {
      return measurer_.Measure(frames, measure_);
    };
  }
  Result<DecodedImage> Load(const FrameRecord& record) const {
    const std::filesystem::path path = session_ / record.file;
    OMNIHDR_ASSIGN(DecodedImage image, ReadImage(path));
    if (image.width() != info_.camera.width || image.height() != info_.camera.height) {
      return Fail(ErrorKind::kData, "{}: {}x{}, expected {}x{} as session.json says", path.string(),
                  image.width(), image.height(), info_.camera.width, info_.camera.height);
    }
    return image;
  }

  const std::filesystem::path session_;
  const std::filesystem::path views_;
  const PipelineOptions options_;
  const SessionInfo info_;
  FrameMeasurer measurer_;
  MeasureOptions measure_;
};

Result<int> Report(const ReportArguments& arguments) {
  PipelineOptions options;
  if (!arguments.config.empty()) {
    OMNIHDR_ASSIGN(const DaemonConfig config, ConfigOrError(LoadConfig(arguments.config)));
    options = config.pipeline.options;
  }
  if (!arguments.mask.empty()) options.mask_file = arguments.mask;
  OMNIHDR_ASSIGN(SessionContents contents, ReadSession(arguments.session));
  Image<std::uint8_t> mask;
  if (!options.mask_file.empty()) {
    OMNIHDR_ASSIGN(mask, ReadMask(options.mask_file));
  }
  OMNIHDR_ASSIGN(FrameMeasurer measurer,
                 FrameMeasurer::Open(arguments.session, contents.info, mask.view(),
                                     options.mask_file, options.white_balance));
  std::map<PositionId, std::vector<FrameRecord>> positions;
  std::size_t most = 0;
  for (const FrameRecord& frame : contents.journal.frames) {
    if (frame.status != FrameStatus::kOk) continue;
    if (arguments.position >= 0 && Value(frame.position) != arguments.position) continue;
    positions[frame.position].push_back(frame);
    most = std::max(most, positions[frame.position].size());
  }
  if (positions.empty()) {
    return arguments.position >= 0
               ? Fail(ErrorKind::kData, "{}: no usable frame at position {}", arguments.session,
                      arguments.position)
               : Fail(ErrorKind::kData, "{}: no usable frame", arguments.session);
  }
  Reporter reporter(arguments, options, contents.info, std::move(measurer));
  std::vector<ExposureSummary> summaries;
  if (most == 1) {
    std::vector<FrameRecord> frames;
    for (auto& [position, records] : positions) frames.push_back(records.front());
    OMNIHDR_ASSIGN(ExposureSummary summary, reporter.Drive(frames));
    summaries.push_back(std::move(summary));
  } else {
    for (const auto& [position, records] : positions) {
      OMNIHDR_ASSIGN(ExposureSummary summary, reporter.Bracket(position, records));
      summaries.push_back(std::move(summary));
    }
  }
  if (arguments.json) {
    fmt::print("[\n");
    for (std::size_t k = 0; k < summaries.size(); ++k) {
      fmt::print("{}{}\n", JsonOf(summaries[k]), k + 1 < summaries.size() ? "," : "");
    }
    fmt::print("]\n");
  } else {
    for (const ExposureSummary& summary : summaries) fmt::print("{}", TextOf(summary));
  }
  return 0;
}

}  // namespace

void AddReportCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand(
      "report",
      "How a session is exposed: under- and over-exposed pixels and radiance range of "
      "every exposure, what the merge recovers, and whether exposure times are right");
  auto arguments = std::make_shared<ReportArguments>();
  command->add_option("session", arguments->session, "session directory")->required();
  command->add_option("--views", arguments->views, "its views (default: SESSION/views)");
  command->add_option("--mask", arguments->mask,
                      "picture of a frame's size (of a rig also lat-long), white = use");
  command->add_option("--config", arguments->config, "take photometry options from this file");
  command->add_option("--position", arguments->position, "this position alone")
      ->check(CLI::NonNegativeNumber);
  command->add_flag("--json", arguments->json, "an array of objects instead of tables");
  command->callback([arguments, &run] { run = [arguments] { return Report(*arguments); }; });
}

}  // namespace omnihdr
