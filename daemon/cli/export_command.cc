#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <filesystem>
#include <memory>
#include <string>

#include "core/base/file.h"
#include "daemon/cli/command.h"
#include "daemon/cli/rig_export.h"
#include "daemon/cli/session_export.h"

namespace omnihdr {
namespace {

struct ExportArguments {
  std::string session;
  std::string views;
  std::string to;
  std::string out;
  int chain = -1;
  int face_size = 1024;
  bool horizon = false;
  bool sensors = false;
};

// Further off than this, features of a picture and the model of its lens disagree visibly.
constexpr double kLensErrorWorthSaying = 0.1;

void SayLensError(const RigExportReport& report) {
  if (report.lens_error_px < kLensErrorWorthSaying) return;
  fmt::print("lenses by a fisheye model of four coefficients: at most {:.2f} pixels off\n",
             report.lens_error_px);
}

Result<int> Export(const ExportArguments& arguments) {
  namespace fs = std::filesystem;
  const fs::path session = arguments.session;
  const fs::path views = arguments.views.empty() ? session / "views" : fs::path(arguments.views);
  if (arguments.sensors && arguments.to != "colmap" && arguments.to != "opensfm") {
    return Fail(ErrorKind::kUsage, "--sensors: with --to {}, expected colmap or opensfm",
                arguments.to);
  }
  if (arguments.to == "ros") {
    OMNIHDR_ASSIGN(const RigExportReport report, ExportRigToRos(session, arguments.out));
    fmt::print("{}: head.urdf and camera_info of its sensors\n", arguments.out);
    SayLensError(report);
    return 0;
  }
  OMNIHDR_ASSIGN(const ExportPlan plan, PlanExport(session, views, arguments.chain));
  if (arguments.sensors) {
    OMNIHDR_ASSIGN(const RigExportReport report,
                   arguments.to == "colmap" ? ExportRigToColmap(session, plan, arguments.out)
                                            : ExportRigToOpenSfm(session, plan, arguments.out));
    fmt::print("{} pictures of sensors{}\n", report.pictures,
               report.has_poses ? "" : "; no poses, for theirs are not in metres as the rig is");
    SayLensError(report);
  } else if (arguments.to == "tum") {
    OMNIHDR_TRY(WriteFileAtomic(arguments.out, FormatTum(plan)));
  } else if (arguments.to == "opensfm") {
    OMNIHDR_TRY(ExportOpenSfm(plan, arguments.out));
  } else {
    OMNIHDR_TRY(ExportColmap(plan, arguments.face_size, !arguments.horizon, arguments.out));
  }
  fmt::print("{}: {} views of chain {}, {}, times {}\n", arguments.out, plan.views.size(),
             plan.chain, plan.is_metric ? "metres" : "units of the first baseline",
             plan.is_utc ? "UTC" : "of the host's clock");
  if (plan.chains.size() > 1) {
    fmt::print("other chains have no common world with it (--chain):");
    for (const auto& [chain, count] : plan.chains) {
      if (chain != plan.chain) fmt::print(" {} ({} views)", chain, count);
    }
    fmt::print("\n");
  }
  return 0;
}

}  // namespace

void AddExportCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand(
      "export", "A session's views, poses and rig for COLMAP, OpenSfM and ROS tools");
  auto arguments = std::make_shared<ExportArguments>();
  command->add_option("session", arguments->session, "session directory")->required();
  command->add_option("--views", arguments->views, "its views (default: SESSION/views)");
  command
      ->add_option("--to", arguments->to,
                   "tum: a file of poses; opensfm: a data set of panoramas with poses and places; "
                   "colmap: a model of pinhole faces of the panoramas; ros: a head's lenses "
                   "(camera_info) and sensors' places (URDF), for which no views are needed")
      ->required()
      ->check(CLI::IsMember({"tum", "opensfm", "colmap", "ros"}));
  command->add_option("--out", arguments->out, "the file (tum) or folder to write")->required();
  command->add_option("--chain", arguments->chain, "which chain of views (default: the longest)")
      ->check(CLI::NonNegativeNumber);
  command->add_option("--face-size", arguments->face_size, "colmap: pixels of a face's side")
      ->check(CLI::Range(64, 8192))
      ->capture_default_str();
  command->add_flag("--horizon", arguments->horizon,
                    "colmap: the four faces around the horizon only");
  command->add_flag("--sensors", arguments->sensors,
                    "colmap, opensfm: not panoramas, but a head's sensors as a rig: each one's "
                    "pictures (own frames, brightened), lens and place");
  command->callback([arguments, &run] { run = [arguments] { return Export(*arguments); }; });
}

}  // namespace omnihdr
