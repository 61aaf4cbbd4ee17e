#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <variant>
#include <vector>

#include "core/image/image_io.h"
#include "core/photometry/rig_orientation.h"
#include "core/session/rig_file.h"
#include "core/session/session_reader.h"
#include "daemon/cli/calibrate_command.h"

namespace omnihdr {
namespace {

// Frames of a session that are looked at, evenly over it.
constexpr std::size_t kMostVerifiedFrames = 16;

struct OrientationArguments {
  std::vector<std::string> frames;
  std::string session;
  std::string rig;
  bool json = false;
};

Result<std::vector<std::filesystem::path>> OrientationFrames(
    const OrientationArguments& arguments) {
  std::vector<std::filesystem::path> files(arguments.frames.begin(), arguments.frames.end());
  if (!arguments.session.empty()) {
    OMNIHDR_ASSIGN(const SessionContents contents, ReadSession(arguments.session));
    std::vector<std::filesystem::path> usable;
    for (const FrameRecord& frame : contents.journal.frames) {
      if (frame.status != FrameStatus::kOk || frame.file.empty()) continue;
      usable.push_back(std::filesystem::path(arguments.session) / frame.file);
    }
    const std::size_t taken = std::min(usable.size(), kMostVerifiedFrames);
    for (std::size_t i = 0; i < taken; ++i) files.push_back(usable[i * usable.size() / taken]);
  }
  if (files.empty()) {
    return Fail(
        ErrorKind::kUsage,
        "no frames: expected frames of all sensors stacked, or --session SESSION with some");
  }
  return files;
}

nlohmann::json ToJson(const OrientationReport& report) {
  nlohmann::json best = nlohmann::json::array();
  for (const OrientationAlternative& each : report.best) {
    best.push_back({{"what", each.what}, {"agreement", each.agreement}, {"patches", each.patches}});
  }
  return {{"verdict", ToString(report.verdict)},
          {"agreement", report.configured.agreement},
          {"patches", report.configured.patches},
          {"frames", report.frames},
          {"alternatives", std::move(best)}};
}

Result<int> VerifyOrientation(const OrientationArguments& arguments) {
  std::string rig_file = arguments.rig;
  if (rig_file.empty() && !arguments.session.empty()) {
    rig_file = (std::filesystem::path(arguments.session) / "rig.toml").string();
  }
  if (rig_file.empty()) {
    return Fail(ErrorKind::kUsage, "no rig file: expected --rig FILE, or --session of a rig");
  }
  OMNIHDR_ASSIGN(const Rig rig, ReadRig(rig_file));
  Result<OrientationCheck> check = OrientationCheck::Create(rig);
  if (!check) return Forward(std::move(check).error(), rig_file);
  OMNIHDR_ASSIGN(const std::vector<std::filesystem::path> files, OrientationFrames(arguments));
  for (const std::filesystem::path& file : files) {
    OMNIHDR_ASSIGN(const DecodedImage frame, ReadImage(file));
    const Result<bool> says =
        std::visit([&](const auto& pixels) { return check->Add(pixels.view()); }, frame.pixels);
    if (!says) return Forward(Error(says.error()), file.string());
    if (!*says && !arguments.json) {
      fmt::print("{}: says nothing: what two sensors see is clipped, dark or plain\n",
                 file.string());
    }
  }
  const OrientationReport report = check->Report();
  if (arguments.json) {
    fmt::print("{}\n", ToJson(report).dump(2));
  } else {
    fmt::print("{}: {}\n", ToString(report.verdict), report.Text());
    switch (report.verdict) {
      case OrientationVerdict::kAgrees:
        fmt::print(
            "A world that is mirrored as a whole would agree, too: only a text or a chart "
            "tells (omnihdr calibrate white-balance).\n");
        break;
      case OrientationVerdict::kContradicted:
        fmt::print(
            "Correct order and rotations of the sensors in {}; a picture of a text, made "
            "by omnihdr stitch, tells which of several it is.\n",
            rig_file);
        break;
      case OrientationVerdict::kUndecided:
        fmt::print("Take frames with structure where the sensors' fields meet, well exposed.\n");
        break;
    }
  }
  switch (report.verdict) {
    case OrientationVerdict::kAgrees:
      return 0;
    case OrientationVerdict::kContradicted:
      return ExitCode(ErrorKind::kData);
    case OrientationVerdict::kUndecided:
      break;
  }
  return ExitCode(ErrorKind::kTemporary);
}

}  // namespace

void AddCalibrateVerify(CLI::App& calibrate, CommandRun& run) {
  const auto arguments = std::make_shared<OrientationArguments>();
  CLI::App* command = calibrate.add_subcommand(
      "verify",
      "Whether a rig file's order and rotations of the sensors are those of the pictures: compares "
      "what neighbouring sensors see. Exit code 0 when they agree, 65 when they contradict it, 75 "
      "when the frames do not tell");
  command->add_option("frames", arguments->frames, "frames of all sensors stacked, as recorded");
  command->add_option("--session", arguments->session, "session directory, up to 16 of its frames");
  command->add_option("--rig", arguments->rig, "rig file [SESSION/rig.toml]");
  command->add_flag("--json", arguments->json, "the numbers, for scripts");
  command->callback(
      [arguments, &run] { run = [arguments] { return VerifyOrientation(*arguments); }; });
}

}  // namespace omnihdr
