#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <utility>
#include <vector>

#include "core/capture/bracket_plan.h"
#include "core/capture/bracket_proposal.h"
#include "core/capture/scene_look.h"
#include "core/image/image_io.h"
#include "core/session/session_reader.h"
#include "daemon/camera_parts.h"
#include "daemon/cli/command.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;
using Json = nlohmann::ordered_json;

constexpr int kMostFramesOfASession = 60;

struct BracketArguments {
  std::string session;
  std::string config{kDefaultConfigFile};
  double longest_s = 1.0;
  bool json = false;
  ProposalOptions proposal;
};

// What was looked at, and what limits a bracket for it.
struct Look {
  std::optional<SceneRange> scene;
  int pictures = 0;
  ExposureLimits limits;
  BracketOptions options;
};

// Frames evenly over the session, some of every exposure.
Result<Look> LookAtSession(const BracketArguments& arguments) {
  const fs::path session = arguments.session;
  OMNIHDR_ASSIGN(const SessionContents contents, ReadSession(session));
  Look look;
  look.scene.emplace(contents.info.response, contents.info.camera.bits);
  std::vector<const FrameRecord*> usable;
  for (const FrameRecord& record : contents.journal.frames) {
    if (record.status == FrameStatus::kOk) usable.push_back(&record);
  }
  if (usable.empty()) {
    return Fail(ErrorKind::kData, "{}: no frame with pixels, expected at least one",
                session.string());
  }
  const std::size_t stride = usable.size() / kMostFramesOfASession + 1;
  // A stride that is a multiple of the bracket would see one of its steps only: runs, not points.
  for (std::size_t i = 0; i < usable.size(); ++i) {
    if ((i / 4) % stride != 0) continue;
    OMNIHDR_ASSIGN(const DecodedImage image, ReadImage(session / usable[i]->file));
    look.scene->Add(image, usable[i]->exposure);
    ++look.pictures;
  }
  return look;
}

Result<Look> LookThroughCamera(const BracketArguments& arguments) {
  OMNIHDR_ASSIGN(const DaemonConfig config, ConfigOrError(LoadConfig(arguments.config)));
  OMNIHDR_ASSIGN(std::shared_ptr<CameraRelease> release, OpenCameraTrigger(config));
  OMNIHDR_ASSIGN(const std::unique_ptr<Camera> camera,
                 MakeCamera(MakeCameraOptions(config, false, std::move(release))));
  OMNIHDR_ASSIGN(const CameraInfo info, camera->Open());
  if (info.proof == ExposureProof::kFile) {
    return Fail(
        ErrorKind::kUsage,
        "{}: camera.driver: \"replay\" takes no exposures: expected its session as argument",
        arguments.config);
  }
  OMNIHDR_TRY(camera->Start());
  Look look;
  look.limits = {info.shortest, info.longest, info.exposure_quantum_s,
                 PixelAngle(info.description, info.files)};
  look.options.flicker_hz = config.bracket.flicker_hz;
  look.options.gain = GainDb{config.bracket.gain_db};
  look.options.max_blur_px = config.bracket.max_blur_px;
  look.options.speed_m_s = config.bracket.speed_m_s;
  look.options.near_m = config.bracket.near_m;
  SceneLookOptions options;
  options.proposal = arguments.proposal;
  options.longest_s = arguments.longest_s;
  options.gain = look.options.gain;
  options.frame_timeout = Nanoseconds(std::llround(1e9 * config.camera.frame_timeout_s));
  OMNIHDR_ASSIGN(SceneLook seen, LookAtScene(*camera, info, options, [] { return true; }));
  camera->Stop();
  look.scene.emplace(std::move(seen.scene));
  look.pictures = seen.pictures;
  return look;
}

Result<int> Propose(const BracketArguments& arguments) {
  OMNIHDR_TRY(arguments.proposal.Validate());
  OMNIHDR_ASSIGN(const Look look, arguments.session.empty() ? LookThroughCamera(arguments)
                                                            : LookAtSession(arguments));
  const BracketProposal proposal = *look.scene->Propose(arguments.proposal);
  OMNIHDR_ASSIGN(const AllowedBracket allowed, AllowBracket(proposal, look.options, look.limits));
  std::vector<double> exposures_s;
  for (const ExposureTime step : allowed.exposures) exposures_s.push_back(step.seconds());
  const double stops = proposal.RangeStops();
  if (arguments.json) {
    const Json json = {{"pictures", look.pictures},
                       {"range_stops", stops},
                       {"bright_reached", proposal.bright_reached},
                       {"dark_reached", proposal.dark_reached},
                       {"exposures_s", exposures_s},
                       {"notes", allowed.notes}};
    fmt::print("{}\n", json.dump(2));
    return 0;
  }
  fmt::print("# from {} picture{}, whose range is {:.1f} stops\n", look.pictures,
             look.pictures == 1 ? "" : "s", stops);
  for (const std::string& note : allowed.notes) fmt::print("# {}\n", note);
  std::string list;
  for (const double seconds : exposures_s) {
    list += fmt::format("{}{:.6g}", list.empty() ? "" : ", ", seconds);
  }
  fmt::print("[bracket]\nexposures_s = [{}]\n", list);
  return 0;
}

}  // namespace

void AddBracketCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand("bracket", "Exposures for a scene");
  command->require_subcommand(1);
  const auto arguments = std::make_shared<BracketArguments>();
  CLI::App* propose = command->add_subcommand(
      "propose", "The bracket that covers the range of a scene, as lines of the configuration");
  propose->add_option("session", arguments->session,
                      "Recorded session to look at; without it, the configured camera takes a few "
                      "pictures (no daemon may have it open)");
  propose
      ->add_option("--config", arguments->config,
                   "Configuration with the camera and the limits of [bracket]")
      ->capture_default_str();
  propose->add_option("--longest", arguments->longest_s, "Longest exposure that is tried, seconds")
      ->check(CLI::Range(1e-6, 60.0))
      ->capture_default_str();
  propose->add_option("--stops", arguments->proposal.most_stops, "Largest step between exposures")
      ->check(CLI::Range(0.1, 10.0))
      ->capture_default_str();
  propose
      ->add_option("--bright-share", arguments->proposal.bright_share,
                   "Share of the pixels that may clip in the shortest exposure")
      ->check(CLI::Range(0.0, 0.2))
      ->capture_default_str();
  propose
      ->add_option("--dark-share", arguments->proposal.dark_share,
                   "Share of the pixels that may stay dark in the longest exposure")
      ->check(CLI::Range(0.0, 0.2))
      ->capture_default_str();
  propose->add_flag("--json", arguments->json, "Print JSON");
  propose->callback([&run, arguments] { run = [=] { return Propose(*arguments); }; });
}

}  // namespace omnihdr
