#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <chrono>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/base/profile.h"
#include "core/pipeline/made_with.h"
#include "core/pipeline/session_processor.h"
#include "core/session/session_reader.h"
#include "core/session/view_writer.h"
#include "daemon/cli/command.h"
#include "daemon/cli/profile_table.h"
#include "daemon/cli/white_balance_option.h"
#include "daemon/config.h"

namespace omnihdr {
namespace {

struct ProcessArguments {
  std::string session;
  std::string out;
  std::string mask;
  std::string mode;
  std::string config;
  std::string exr_type;
  std::string weights;
  std::string nan;
  std::string movers;
  std::string mover_masks;
  std::vector<double> white_balance;
  bool no_refine = false;
  int width = 0;
  int workers = 0;
  bool resume = false;
  bool overwrite = false;
  bool upgrade = false;
  bool profile = false;
  bool json = false;
  bool quiet = false;
};

Result<PipelineOptions> OptionsOf(const ProcessArguments& arguments) {
  PipelineOptions options;
  if (!arguments.config.empty()) {
    OMNIHDR_ASSIGN(const DaemonConfig config, ConfigOrError(LoadConfig(arguments.config)));
    options = config.pipeline.options;
  }
  if (!arguments.mask.empty()) options.mask_file = arguments.mask;
  if (arguments.mode == "spatiotemporal") options.mode = ProcessMode::kSpatiotemporal;
  if (arguments.mode == "temporal") options.mode = ProcessMode::kTemporal;
  if (arguments.mode == "auto") options.mode = ProcessMode::kAuto;
  if (arguments.exr_type == "half") options.exr_type = ExrPixelType::kHalf;
  if (arguments.exr_type == "float") options.exr_type = ExrPixelType::kFloat;
  if (arguments.weights == "hat") options.weights = MergeWeights::kHat;
  if (arguments.weights == "inverse-variance") options.weights = MergeWeights::kInverseVariance;
  if (arguments.nan == "never") options.nan = NanPixels::kNever;
  if (arguments.nan == "no-data") options.nan = NanPixels::kNoData;
  if (arguments.nan == "unmeasured") options.nan = NanPixels::kUnmeasured;
  if (arguments.movers == "keep") options.movers = MergeMovers::kKeep;
  if (arguments.movers == "remove") options.movers = MergeMovers::kRemove;
  if (!arguments.mover_masks.empty()) options.mover_masks = arguments.mover_masks;
  if (!arguments.white_balance.empty()) {
    OMNIHDR_ASSIGN(options.white_balance, WhiteBalanceOf(arguments.white_balance));
  }
  if (arguments.no_refine) options.refine_exposure = false;
  if (arguments.width != 0) options.output_width = arguments.width;
  return options;
}

struct Standing {
  int positions = 0;  // with a frame that claims pixels
  int complete = 0;   // of those, with a view
  int reduced = 0;    // of those, with a view of reduced quality
};

Result<Standing> StandingOf(const std::filesystem::path& session,
                            const std::filesystem::path& views) {
  OMNIHDR_ASSIGN(const SessionContents contents, ReadSession(session));
  OMNIHDR_ASSIGN(const auto complete, CompleteViewLevels(views));
  std::set<PositionId> positions;
  for (const FrameRecord& frame : contents.journal.frames) {
    if (frame.status == FrameStatus::kOk) positions.insert(frame.position);
  }
  Standing standing;
  standing.positions = static_cast<int>(positions.size());
  for (const auto& [position, level] : complete) {
    if (!positions.contains(position)) continue;
    ++standing.complete;
    if (level > 0) ++standing.reduced;
  }
  return standing;
}

Status RemoveViews(const std::filesystem::path& views) {
  OMNIHDR_ASSIGN(const std::vector<PositionId> complete, CompleteViews(views));
  for (const PositionId position : complete) {
    std::error_code error;
    std::filesystem::remove_all(views / ViewDirectoryName(position), error);
    if (error) {
      return Fail(ErrorKind::kIo, "{}: {}", (views / ViewDirectoryName(position)).string(),
                  error.message());
    }
  }
  return {};
}

std::string ReducedText(int reduced) {
  return reduced == 0
             ? std::string()
             : fmt::format("{} of reduced quality (--upgrade makes them anew in full)", reduced);
}

// What was done, for scripts. `profile`: null when it was not asked for, or nothing was made.
void PrintJson(const std::filesystem::path& views, const SessionProcessor::Counts& counts,
               double seconds, const nlohmann::json& profile) {
  nlohmann::json json = {{"views", views.string()},
                         {"written", counts.views_written},
                         {"complete", counts.views_complete},
                         {"reduced", counts.views_reduced},
                         {"positions_without_pixels", counts.positions_without_pixels},
                         {"seconds", seconds}};
  if (!profile.is_null()) json["profile"] = profile;
  fmt::print("{}\n", json.dump(1, ' ', false, nlohmann::json::error_handler_t::replace));
}

Result<int> Process(const ProcessArguments& arguments) {
  OMNIHDR_ASSIGN(const PipelineOptions options, OptionsOf(arguments));
  if (arguments.workers > 0) SetWorkerCount(arguments.workers);
  const std::filesystem::path session = arguments.session;
  const std::filesystem::path out =
      arguments.out.empty() ? session : std::filesystem::path(arguments.out);
  const std::filesystem::path views = out / "views";
  if (arguments.overwrite) OMNIHDR_TRY(RemoveViews(views));
  OMNIHDR_ASSIGN(const Standing standing, StandingOf(session, views));
  const bool is_complete = standing.positions > 0 && standing.complete == standing.positions;
  if (arguments.json && (arguments.upgrade ? standing.reduced == 0 : is_complete)) {
    SessionProcessor::Counts counts;
    counts.views_complete = standing.complete;
    counts.views_reduced = standing.reduced;
    PrintJson(views, counts, 0.0, nullptr);
    return 0;
  }
  if (arguments.upgrade && standing.reduced == 0) {
    fmt::print("{}: all {} views there are of full quality, nothing to do\n", views.string(),
               standing.complete);
    return 0;
  }
  if (!arguments.upgrade && is_complete) {
    fmt::print("{}: all {} views are complete, nothing to do (--overwrite makes them anew)\n",
               views.string(), standing.complete);
    if (standing.reduced > 0) fmt::print("of these, {}\n", ReducedText(standing.reduced));
    OMNIHDR_ASSIGN(const std::string made_with, MadeWith(options, session));
    if (const std::string otherwise = OtherwiseMade(views, made_with); !otherwise.empty()) {
      fmt::print(stderr, "warning: {}\n", otherwise);
    }
    return 0;
  }
  if (standing.complete > 0 && !arguments.resume && !arguments.upgrade) {
    return Fail(ErrorKind::kUsage,
                "{}: holds {} of {} views; --resume continues, --overwrite makes all anew",
                views.string(), standing.complete, standing.positions);
  }
  if (arguments.resume && standing.complete > 0 && !arguments.json) {
    fmt::print("continuing: {} of {} views are complete\n", standing.complete, standing.positions);
  }

  ProcessorCallbacks callbacks;
  callbacks.view_done = [&](const ViewDone& done) {
    if (done.already_complete) return;
    if (!arguments.quiet && !arguments.json) {
      const double seconds = done.pose_s + done.stereo_s + done.merge_s + done.write_s;
      fmt::print("{}  {:.2f} s\n", (views / ViewDirectoryName(done.position)).string(), seconds);
      std::fflush(stdout);
    }
    for (const std::string& warning : done.warnings) {
      fmt::print(stderr, "position {}: {}\n", Value(done.position), warning);
    }
  };
  callbacks.warning = [](const std::string& message) {
    fmt::print(stderr, "warning: {}\n", message);
  };
  Profile profile;
  std::optional<ProfileRecording> recording;
  if (arguments.profile) recording.emplace(profile);
  const auto start = std::chrono::steady_clock::now();
  ProcessorOptions how;  // nothing has to be kept up with: in full, whatever pipeline.overload says
  how.upgrade = arguments.upgrade;
  OMNIHDR_ASSIGN(const std::unique_ptr<SessionProcessor> processor,
                 SessionProcessor::Open(session, out, options, callbacks, how));
  OMNIHDR_TRY(processor->Finish());
  recording.reset();
  const SessionProcessor::Counts counts = processor->counts();
  const double elapsed =
      std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
  if (counts.positions_seen == 0 && counts.views_complete == 0) {
    return Fail(ErrorKind::kData, "{}: no position with a usable frame, no view made",
                session.string());
  }
  if (arguments.upgrade && counts.views_reduced > 0) {
    return Fail(ErrorKind::kData,
                "{}: {} views are still of reduced quality: their frames cannot be used",
                views.string(), counts.views_reduced);
  }
  const int written = counts.views_written;
  const bool has_profile = arguments.profile && written > 0;
  if (arguments.json) {
    PrintJson(views, counts, elapsed,
              has_profile ? ProfileJson(profile.report(), written) : nlohmann::json());
    return 0;
  }
  fmt::print("{}: {} views written, {} complete", views.string(), written, counts.views_complete);
  if (counts.views_reduced > 0) fmt::print(", {}", ReducedText(counts.views_reduced));
  if (counts.positions_without_pixels > 0) {
    fmt::print(", {} positions without usable frames", counts.positions_without_pixels);
  }
  fmt::print(", {:.1f} s\n", elapsed);
  if (has_profile) fmt::print("{}", ProfileTable(profile.report(), written));
  return 0;
}

}  // namespace

void AddProcessCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand(
      "process", "Make the views (radiance, disparity, preview, pose) of a recorded session");
  auto arguments = std::make_shared<ProcessArguments>();
  command->add_option("session", arguments->session, "session directory")->required();
  command->add_option("--out", arguments->out, "directory that gets views/ (default: the session)");
  command->add_option("--mask", arguments->mask,
                      "picture of a frame's size, white = use (key input.mask)");
  command->add_option("--mode", arguments->mode, "auto, spatiotemporal or temporal (pipeline.mode)")
      ->check(CLI::IsMember({"auto", "spatiotemporal", "temporal"}));
  command->add_option("--config", arguments->config, "take pipeline options from this file");
  command
      ->add_option("--weights", arguments->weights,
                   "inverse-variance or hat: of exposures of one position (photometry.weights)")
      ->check(CLI::IsMember({"inverse-variance", "hat"}));
  command
      ->add_option("--nan", arguments->nan,
                   "never, no-data or unmeasured: pixels that are NaN instead of an estimate "
                   "(output.nan)")
      ->check(CLI::IsMember({"never", "no-data", "unmeasured"}));
  command
      ->add_option("--movers", arguments->movers,
                   "keep or remove: what moved between the frames (merge.movers)")
      ->check(CLI::IsMember({"keep", "remove"}));
  command->add_option("--mover-masks", arguments->mover_masks,
                      "folder, in the session, of masks of what moves (merge.mover_masks)");
  AddWhiteBalanceOption(command, "gains on R,G,B, as in 1.9,1,1.4 (photometry.white_balance)",
                        &arguments->white_balance);
  command->add_flag("--no-refine", arguments->no_refine,
                    "take exposure times as labelled (photometry.refine_exposure)");
  command->add_option("--width", arguments->width, "width of the output pictures (output.width)")
      ->check(CLI::Range(64, 16384));
  command
      ->add_option("--exr-type", arguments->exr_type,
                   "half or float numbers in radiance.exr (output.exr_type)")
      ->check(CLI::IsMember({"half", "float"}));
  command->add_option("--workers", arguments->workers, "threads (default: one per processor)")
      ->check(CLI::Range(1, 256));
  CLI::Option* resume =
      command->add_flag("--resume", arguments->resume, "continue where the complete views end");
  CLI::Option* overwrite =
      command->add_flag("--overwrite", arguments->overwrite, "make all views anew");
  overwrite->excludes(resume);
  command
      ->add_flag("--upgrade", arguments->upgrade,
                 "make the views anew, in full, that were made at a reduced quality level "
                 "(pipeline.overload), and no others")
      ->excludes(resume)
      ->excludes(overwrite);
  command->add_flag("--profile", arguments->profile,
                    "print where the time of a view goes: wall and CPU time by part");
  command->add_flag("--json", arguments->json, "one JSON object instead of lines for people");
  command->add_flag("-q,--quiet", arguments->quiet, "no line per view");
  command->callback([arguments, &run] { run = [arguments] { return Process(*arguments); }; });
}

}  // namespace omnihdr
