#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <system_error>
#include <utility>
#include <variant>
#include <vector>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "daemon/camera_parts.h"
#include "daemon/cli/camera_trial.h"
#include "daemon/cli/command.h"
#include "drivers/iidc/config_rom.h"
#include "drivers/iidc/iidc_camera.h"
#include "drivers/v4l2/find_camera.h"
#include "drivers/v4l2/kernel_device.h"

namespace omnihdr {
namespace {

using Json = nlohmann::ordered_json;

struct CameraArguments {
  std::string config{kDefaultConfigFile};
  std::string device;  // instead of the configuration's
  bool json = false;
  double exposure_s = 0.01;
  double gain_db = 0.0;
  int count = 1;
  std::string out;
  CameraTrialOptions trial;
  bool unplug = false;
  std::string record;
  std::string replay;
  std::vector<std::string> settings;  // KEY=VALUE
};

// --- list

Json IidcCameras(iidc::CameraBus bus) {
  Json cameras = Json::array();
  iidc::IidcCameraOptions options;
  options.bus = bus;
  const auto finder = iidc::MakeFinder(options);
  const auto candidates = finder->Find();
  if (!candidates)
    return Json::array({{{"driver", "iidc"}, {"problem", candidates.error().message}}});
  for (const iidc::LinkFinder::Candidate& candidate : *candidates) {
    Json camera = {{"driver", "iidc"}, {"place", candidate.name}};
    const auto identified = [&]() -> Status {
      OMNIHDR_ASSIGN(const auto link, candidate.open());
      OMNIHDR_ASSIGN(const auto quadlets, iidc::ReadConfigRom(*link, std::chrono::seconds(1)));
      OMNIHDR_ASSIGN(const iidc::ConfigRom rom, iidc::ParseConfigRom(quadlets));
      camera["id"] = iidc::FormatGuid(rom.guid);
      camera["model"] = fmt::format("{} {}", rom.vendor, rom.model);
      return {};
    }();
    if (!identified) camera["problem"] = identified.error().message;
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

Json V4l2Cameras() {
  Json cameras = Json::array();
  const auto system = v4l2::MakeKernelSystem();
  for (const v4l2::ListedCamera& found : v4l2::ListCameras(*system)) {
    // A name by-id or a serial number stays when the numbers change.
    const v4l2::V4l2Node& node = found.node;
    const std::string id = !node.names.empty()    ? node.names.front()
                           : !node.serial.empty() ? node.serial
                                                  : node.path;
    Json camera = {{"driver", "v4l2"}, {"place", node.path}, {"id", id}, {"model", found.card}};
    if (!found.problem.empty()) camera["problem"] = found.problem;
    cameras.push_back(std::move(camera));
  }
  return cameras;
}

Result<int> List(const CameraArguments& arguments) {
  Json cameras = IidcCameras(iidc::CameraBus::kUsb);
  for (Json& camera : IidcCameras(iidc::CameraBus::kFirewire)) {
    // A machine without FireWire is not worth a line; a device that is no camera is.
    if (camera.contains("place")) cameras.push_back(std::move(camera));
  }
  for (Json& camera : V4l2Cameras()) cameras.push_back(std::move(camera));
  if (arguments.json) {
    fmt::print("{}\n", cameras.dump(2));
    return 0;
  }
  if (cameras.empty()) {
    fmt::print(
        "no IIDC camera on USB or FireWire and no V4L2 device (omnihdr doctor looks at cables, "
        "permissions and drivers; \"sim\" and \"replay\" need no device)\n");
  }
  for (const Json& camera : cameras) {
    const auto text = [&camera](const char* key) { return camera.value(key, std::string()); };
    fmt::print("{:<5} {:<28} {}  {}{}\n", text("driver"), text("place"), text("id"), text("model"),
               camera.contains("problem") ? "  " + text("problem") : "");
  }
  return 0;
}

// --- info, grab, test: the configuration's camera

struct OpenCamera {
  std::unique_ptr<Camera> camera;
  CameraInfo info;
  DaemonConfig config;
};

// The configuration, with the camera that --device names.
Result<DaemonConfig> ConfigOf(const CameraArguments& arguments) {
  if (std::error_code error; !std::filesystem::exists(arguments.config, error)) {
    return Fail(ErrorKind::kConfig,
                "{}: there is no such file: expected --config with the file that says which camera "
                "it is (omnihdr camera list names those there are)",
                arguments.config);
  }
  OMNIHDR_ASSIGN(DaemonConfig config, ConfigOrError(LoadConfig(arguments.config)));
  if (arguments.device.empty()) return config;
  CameraConfig& camera = config.camera;
  if (camera.driver == CameraDriver::kIidc) {
    camera.iidc.id = arguments.device;
    return config;
  }
  if (camera.driver == CameraDriver::kV4l2 && camera.v4l2.devices.empty()) {
    camera.v4l2.device = arguments.device;
    return config;
  }
  return Fail(ErrorKind::kUsage,
              "--device {}: expected a configuration with camera.driver \"iidc\" or \"v4l2\" and "
              "no camera.v4l2.devices",
              arguments.device);
}

Result<OpenCamera> Open(const CameraArguments& arguments) {
  OpenCamera open;
  OMNIHDR_ASSIGN(open.config, ConfigOf(arguments));
  if (!arguments.replay.empty()) {
    const CameraOptions options =
        MakeCameraOptions(open.config, false, MakeReplayedCameraTrigger(open.config));
    OMNIHDR_ASSIGN(open.camera, MakeReplayedCamera(options, arguments.replay));
  } else {
    OMNIHDR_ASSIGN(std::shared_ptr<CameraRelease> release, OpenCameraTrigger(open.config));
    CameraOptions options = MakeCameraOptions(open.config, false, std::move(release));
    if (!arguments.record.empty()) OMNIHDR_TRY(RecordTransport(options, arguments.record));
    OMNIHDR_ASSIGN(open.camera, MakeCamera(options));
  }
  OMNIHDR_ASSIGN(open.info, open.camera->Open());
  return open;
}

Json InfoOf(const OpenCamera& open) {
  const CameraInfo& info = open.info;
  const CameraDescription& d = info.description;
  Json json = {
      {"model", d.model},
      {"serial", d.serial},
      {"layout", ToString(d.layout)},
      {"width", d.width},
      {"height", d.height},
      {"bits", d.bits},
      {"bayer", d.bayer},
      {"exposure_s", {info.shortest.seconds(), info.longest.seconds()}},
      {"exposure_step_s", info.exposure_quantum_s},
      {"exposure_latency_frames", info.exposure_latency_frames},
      {"min_trigger_interval_s", static_cast<double>(info.min_trigger_interval.count()) * 1e-9},
      {"proof", ToString(info.proof)}};
  if (open.config.gpio.camera_trigger.configured()) {
    json["released_by"] = open.config.gpio.CameraTrigger().name.Text();
  }
  if (const Json more = Json::parse(info.extra_json, nullptr, false); more.is_object()) {
    json.update(more);
  }
  return json;
}

// A line each: what is within an object has the object's name before it.
void PrintValue(const std::string& key, const Json& value) {
  if (value.is_object()) {
    for (const auto& [name, member] : value.items()) {
      PrintValue(fmt::format("{}.{}", key, name), member);
    }
    return;
  }
  std::string text = value.is_string() ? value.get<std::string>() : value.dump();
  if (text.empty()) text = "none";
  if (key == "exposure_s" && value.is_array() && value.size() == 2) {
    text = fmt::format("{:g} to {:g}", value[0].get<double>(), value[1].get<double>());
  } else if (key == "exposure_step_s" && value == 0.0) {
    text = "0 (any exposure within the limits)";
  } else if (value.is_number_float()) {
    text = fmt::format("{:g}", value.get<double>());
  }
  fmt::print("{:<28} {}\n", key, text);
}

Result<int> Info(const CameraArguments& arguments) {
  OMNIHDR_ASSIGN(const OpenCamera open, Open(arguments));
  const Json info = InfoOf(open);
  if (arguments.json) {
    fmt::print("{}\n", info.dump(2));
    return 0;
  }
  for (const auto& [key, value] : info.items()) PrintValue(key, value);
  return 0;
}

Status WritePicture(const CameraFrame& frame, const std::filesystem::path& file) {
  return std::visit(
      [&](const auto& pixels) -> Status {
        OMNIHDR_ASSIGN(const std::vector<std::byte> png, EncodePng(pixels.view()));
        return WriteFileAtomic(file, png);
      },
      frame.pixels);
}

Result<int> Grab(const CameraArguments& arguments) {
  namespace fs = std::filesystem;
  OMNIHDR_ASSIGN(const OpenCamera open, Open(arguments));
  if (!arguments.out.empty()) {
    std::error_code error;
    fs::create_directories(arguments.out, error);
    if (error) return Fail(ErrorKind::kIo, "{}: {}", arguments.out, error.message());
  }
  OMNIHDR_TRY(open.camera->Start());
  const SystemClock clock;
  const Nanoseconds timeout(
      static_cast<Nanoseconds::rep>(1e9 * open.config.camera.frame_timeout_s));
  Json frames = Json::array();
  int unproved = 0;
  for (int i = 0; i < arguments.count; ++i) {
    ExposureRequest request;
    request.trigger = TriggerId{static_cast<std::uint64_t>(i)};
    request.exposure = {ExposureTime::Seconds(arguments.exposure_s), GainDb{arguments.gain_db}};
    request.trigger_time = clock.Now();
    OMNIHDR_ASSIGN(const CameraFrame frame, TakeOnePicture(*open.camera, request, timeout));
    const bool proved = frame.status == FrameStatus::kOk && frame.measured_exposure.has_value() &&
                        frame.proof != ExposureProof::kNone;
    unproved += proved ? 0 : 1;
    Json json = {{"frame", i}, {"status", ToString(frame.status)}};
    if (frame.measured_exposure) {
      json["exposure_s"] = frame.measured_exposure->time.seconds();
      json["gain_db"] = frame.measured_exposure->gain.value;
    }
    json["proof"] = ToString(frame.proof);
    json["counter"] = frame.camera_counter;
    json["level"] = MeanLevel(frame, open.info.description.bits);
    if (!frame.detail.empty()) json["detail"] = frame.detail;
    if (!arguments.out.empty() && frame.status == FrameStatus::kOk) {
      const fs::path file = fs::path(arguments.out) / fmt::format("{:06}.png", i);
      OMNIHDR_TRY(WritePicture(frame, file));
      json["file"] = file.string();
    }
    if (!arguments.json) {
      fmt::print("{:>6}  {:<18} {:>12} s  proof {:<9} counter {:<8} level {:.3f}  {}{}\n", i,
                 json["status"].get<std::string>(),
                 json.contains("exposure_s")
                     ? fmt::format("{:.6g}", json["exposure_s"].get<double>())
                     : "unknown",
                 json["proof"].get<std::string>(), frame.camera_counter,
                 json["level"].get<double>(), json.value("file", std::string()), frame.detail);
    }
    frames.push_back(std::move(json));
  }
  open.camera->Stop();
  if (arguments.json) fmt::print("{}\n", frames.dump(2));
  return unproved == 0 ? 0 : 1;
}

Result<int> Test(const CameraArguments& arguments) {
  OMNIHDR_ASSIGN(const OpenCamera open, Open(arguments));
  CameraTrialOptions options = arguments.trial;
  options.exposure_tolerance = open.config.camera.exposure_tolerance;
  options.frame_timeout =
      Nanoseconds(static_cast<Nanoseconds::rep>(1e9 * open.config.camera.frame_timeout_s));
  if (arguments.unplug) {
    const CameraDriver driver = open.config.camera.driver;
    if (driver == CameraDriver::kSim || driver == CameraDriver::kReplay) {
      return Fail(ErrorKind::kUsage,
                  "--unplug: expected camera.driver \"iidc\" or \"v4l2\": a {} camera has no cable",
                  ToString(driver));
    }
    options.ask = [](const std::string& what) { fmt::print(stderr, ">>> {} now\n", what); };
  }
  if (!arguments.json) {
    fmt::print("{} {}\n", open.info.description.model, open.info.description.serial);
  }
  Json steps = Json::array();
  int failed = 0;
  RunCameraTrial(*open.camera, open.info, options, [&](const CameraTrialStep& step) {
    failed += step.passed ? 0 : 1;
    steps.push_back({{"step", step.name}, {"passed", step.passed}, {"detail", step.detail}});
    if (arguments.json) return;
    fmt::print("{:<15} {:<7} {}\n", step.name, step.passed ? "passed" : "FAILED", step.detail);
    std::fflush(stdout);
  });
  if (arguments.json) fmt::print("{}\n", steps.dump(2));
  return failed == 0 ? 0 : 1;
}

// --- set

Status ListSettings(const CameraArguments& arguments,
                    const std::vector<std::unique_ptr<CameraSettings>>& cameras) {
  Json all = Json::array();
  for (const auto& camera : cameras) {
    OMNIHDR_ASSIGN(const std::vector<CameraSetting> settings, camera->List());
    if (!arguments.json) fmt::print("{}\n", camera->camera());
    Json listed = Json::array();
    for (const CameraSetting& each : settings) {
      listed.push_back({{"name", each.name}, {"value", each.value}, {"allowed", each.allowed}});
      if (!each.note.empty()) listed.back()["note"] = each.note;
      if (arguments.json) continue;
      fmt::print("  {:<32} {:<16} {}{}\n", each.name, each.value, each.allowed,
                 each.note.empty() ? "" : " (" + each.note + ")");
    }
    all.push_back({{"camera", camera->camera()}, {"settings", std::move(listed)}});
  }
  if (arguments.json) fmt::print("{}\n", all.dump(2));
  return {};
}

Result<int> Set(const CameraArguments& arguments) {
  OMNIHDR_ASSIGN(const DaemonConfig config, ConfigOf(arguments));
  std::vector<std::pair<std::string, std::string>> wanted;
  for (const std::string& word : arguments.settings) {
    const std::size_t equals = word.find('=');
    if (equals == std::string::npos || equals == 0) {
      return Fail(ErrorKind::kUsage, "{}: expected KEY=VALUE", word);
    }
    wanted.emplace_back(word.substr(0, equals), word.substr(equals + 1));
  }
  OMNIHDR_ASSIGN(const auto cameras, OpenCameraSettings(MakeCameraOptions(config)));
  if (wanted.empty()) {
    OMNIHDR_TRY(ListSettings(arguments, cameras));
    return 0;
  }
  Json all = Json::array();
  int different = 0;
  for (const auto& camera : cameras) {
    Json changes = Json::array();
    if (!arguments.json) fmt::print("{}\n", camera->camera());
    for (const auto& [name, value] : wanted) {
      OMNIHDR_ASSIGN(const CameraSettingChange change,
                     camera->Set(name, value).Context(camera->camera()));
      different += change.as_asked ? 0 : 1;
      changes.push_back({{"name", change.name},
                         {"asked", change.asked},
                         {"value", change.value},
                         {"allowed", change.allowed},
                         {"as_asked", change.as_asked}});
      if (arguments.json) continue;
      fmt::print("  {} = {}{}; it takes {}\n", change.name, change.value,
                 change.as_asked ? "" : ", NOT the " + change.asked + " that was asked for",
                 change.allowed);
    }
    if (!arguments.json) fmt::print("  {}\n", camera->lasting());
    all.push_back({{"camera", camera->camera()},
                   {"lasting", camera->lasting()},
                   {"changes", std::move(changes)}});
  }
  if (arguments.json) fmt::print("{}\n", all.dump(2));
  return different == 0 ? 0 : 1;
}

}  // namespace

void AddCameraCommand(CLI::App& app, CommandRun& run) {
  CLI::App* command = app.add_subcommand("camera", "Bring up a camera: find, try and test it");
  command->require_subcommand(1);
  const auto arguments = std::make_shared<CameraArguments>();
  const auto add = [&](const char* name, const char* about,
                       Result<int> (*function)(const CameraArguments&), bool with_config) {
    CLI::App* sub = command->add_subcommand(name, about);
    sub->add_flag("--json", arguments->json, "Print JSON");
    if (with_config) {
      sub->add_option("--config", arguments->config,
                      "Configuration whose camera it is; no daemon may have it open")
          ->capture_default_str();
      sub->add_option("--device", arguments->device,
                      "Another camera than the configuration's, as the list calls it: GUID or "
                      "serial number (IIDC); path, name or serial number (V4L2)");
    }
    sub->callback([&run, arguments, function] { run = [=] { return function(*arguments); }; });
    return sub;
  };
  add("list", "Cameras on this machine, and what to call them in the configuration", List, false);
  const auto add_transport = [&](CLI::App* sub) {
    CLI::Option* record = sub->add_option(
        "--record", arguments->record,
        "File for all that passes between the camera and this machine (IIDC on USB, one V4L2 "
        "camera)");
    sub->add_option("--replay", arguments->replay,
                    "Such a file, which takes the camera's place: the same command answers the "
                    "same")
        ->excludes(record);
  };
  add_transport(add("info", "Open the configured camera and say what it can do", Info, true));
  CLI::App* set = add("set",
                      "Set controls of the configured camera and read them back; without any, list "
                      "them with their limits; 1 when one reads back differently",
                      Set, true);
  set->add_option("settings", arguments->settings,
                  "KEY=VALUE: a V4L2 control; an IIDC feature (a number in its unit, raw:N, off, "
                  "auto) or register (0x818=0x82000000)");
  CLI::App* grab =
      add("grab", "Take pictures with one exposure; 1 unless each is proved", Grab, true);
  add_transport(grab);
  grab->add_option("--exposure", arguments->exposure_s, "Seconds")
      ->check(CLI::Range(1e-7, 3600.0))
      ->capture_default_str();
  grab->add_option("--gain", arguments->gain_db, "Decibels")
      ->check(CLI::Range(-60.0, 60.0))
      ->capture_default_str();
  grab->add_option("--count", arguments->count, "Pictures")
      ->check(CLI::Range(1, 100000))
      ->capture_default_str();
  grab->add_option("--out", arguments->out, "Folder for them as PNG, as the sensor delivers them");
  CLI::App* test =
      add("test",
          "Starts and stops, an exposure ladder with proof, steps of the exposure that "
          "pictures must show, triggers as fast as they are taken; 1 when something "
          "fails",
          Test, true);
  add_transport(test);
  test->add_option("--starts", arguments->trial.starts, "Times it is started and stopped")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  test->add_option("--exposures", arguments->trial.exposures, "Steps of the ladder")
      ->check(CLI::Range(2, 20))
      ->capture_default_str();
  test->add_option("--longest", arguments->trial.longest_s,
                   "Longest exposure of the ladder, seconds")
      ->check(CLI::Range(1e-6, 60.0))
      ->capture_default_str();
  test->add_option("--triggers", arguments->trial.triggers, "Triggers given at once")
      ->check(CLI::Range(1, 1000))
      ->capture_default_str();
  test->add_flag("--unplug", arguments->unplug, "Ask for it to be unplugged and plugged in again");
}

}  // namespace omnihdr
