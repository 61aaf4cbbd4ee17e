#include "daemon/config.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <cmath>
#include <system_error>
#include <utility>

#include "core/base/file.h"
#include "core/base/tcp.h"
#include "core/session/toml.h"
#include "daemon/config_keys.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

constexpr std::size_t kMaxDropIns = 256;
constexpr std::string_view kDropInDirectory = "omnihdr.d";

std::size_t EditDistance(std::string_view a, std::string_view b) {
  std::vector<std::size_t> row(b.size() + 1);
  for (std::size_t j = 0; j <= b.size(); ++j) row[j] = j;
  for (std::size_t i = 1; i <= a.size(); ++i) {
    std::size_t diagonal = std::exchange(row[0], i);
    for (std::size_t j = 1; j <= b.size(); ++j) {
      const std::size_t replaced = diagonal + (a[i - 1] == b[j - 1] ? 0 : 1);
      diagonal = row[j];
      row[j] = std::min({row[j] + 1, row[j - 1] + 1, replaced});
    }
  }
  return row.back();
}

std::string_view LastPart(std::string_view key) { return key.substr(key.rfind('.') + 1); }

// The key that was probably meant: one letter off, or the right name in the wrong section.
std::string Suggestion(std::string_view key) {
  if (key.size() > 100) return "";
  const ConfigKey* best = nullptr;
  std::size_t best_distance = 3;
  for (const ConfigKey& candidate : ConfigKeys()) {
    const std::size_t distance = EditDistance(key, candidate.name);
    if (distance < best_distance) {
      best = &candidate;
      best_distance = distance;
    }
  }
  for (const ConfigKey& candidate : ConfigKeys()) {
    if (best == nullptr && LastPart(candidate.name) == LastPart(key)) best = &candidate;
  }
  return best == nullptr ? "" : fmt::format(" (did you mean {}?)", best->name);
}

bool IsSection(std::string_view key) {
  return std::any_of(ConfigKeys().begin(), ConfigKeys().end(), [key](const ConfigKey& candidate) {
    return candidate.name.size() > key.size() && candidate.name.starts_with(key) &&
           candidate.name[key.size()] == '.';
  });
}

class Loader {
 public:
  // Applies one file's text.
  void Apply(std::string_view text, const std::string& name) {
    loaded_.files.push_back(name);
    const TomlDocument document = ParseToml(text);
    if (!document.error.empty()) {
      Problem({name, document.error_line}, "", document.error);
      return;
    }
    const fs::path directory = fs::path(name).parent_path();
    std::string unknown_section;
    for (const TomlEntry& entry : document.entries) {
      const ConfigSource source{name, entry.line};
      if (!unknown_section.empty() && entry.key.starts_with(unknown_section)) continue;
      const ConfigKey* key = FindConfigKey(entry.key);
      const bool section = IsSection(entry.key);
      if (!entry.value) {
        if (section) continue;
        // [[camera]], a list of what there is one of.
        if (const std::string listed = entry.key.substr(0, entry.key.find('['));
            listed != entry.key && IsSection(listed)) {
          unknown_section = listed + "[";
          Problem(source, listed, fmt::format("a list [[{0}]], expected a section [{0}]", listed));
          continue;
        }
        unknown_section = entry.key + ".";
        Problem(source, entry.key,
                key != nullptr ? fmt::format("a section, expected {}", key->expected)
                               : "unknown section");
      } else if (section) {
        Problem(source, entry.key,
                fmt::format("{}, expected a section [{}]", ShownToml(*entry.value), entry.key));
      } else if (key == nullptr) {
        Problem(source, entry.key,
                fmt::format("{}, expected a known key{}", ShownToml(*entry.value),
                            Suggestion(entry.key)));
      } else if (!key->set(loaded_.config, *entry.value, directory)) {
        Problem(source, entry.key,
                fmt::format("{}, expected {}", ShownToml(*entry.value), key->expected));
      } else {
        loaded_.sources[entry.key] = source;
      }
    }
    ChooseBracketForm(name);
  }

  void ApplyFile(const fs::path& path) {
    Result<std::string> text = ReadTextFile(path, kMaxTomlBytes);
    if (text) {
      Apply(*text, path.string());
    } else {
      loaded_.files.push_back(path.string());
      // ReadTextFile's message begins with the path, as does ours.
      std::string message = text.error().message;
      const std::string prefix = path.string() + ": ";
      if (message.starts_with(prefix)) message.erase(0, prefix.size());
      Problem({path.string(), 0}, "", message);
    }
  }

  // What no single key can tell.
  void CheckTogether() {
    const DaemonConfig& config = loaded_.config;
    const auto line_of = [this](const std::string& key) {
      const auto found = loaded_.sources.find(key);
      return found == loaded_.sources.end() ? ConfigSource{DefaultFile(), 0} : found->second;
    };
    if (config.camera.driver == CameraDriver::kReplay && config.camera.replay.session.empty()) {
      Problem(line_of("camera.driver"), "camera.replay.session",
              "\"\", expected a session directory with camera.driver = \"replay\"");
    }
    if (config.camera.driver == CameraDriver::kIidc && config.camera.iidc.rig.empty()) {
      Problem(line_of("camera.driver"), "camera.iidc.rig",
              "\"\", expected the rig file of the camera's head with camera.driver = \"iidc\"");
    }
    if (config.camera.iidc.exposure_cycle == IidcCycle::kOn &&
        config.camera.iidc.format == IidcFormat::kJpeg) {
      Problem(line_of("camera.iidc.exposure_cycle"), "camera.iidc.exposure_cycle",
              "\"on\", expected \"auto\" or \"off\" with camera.iidc.format = \"jpeg\"");
    }
    if (config.camera.driver == CameraDriver::kV4l2) {
      const v4l2::V4l2CameraOptions& camera = config.camera.v4l2;
      if (camera.layout == Layout::kRig && camera.rig_file.empty()) {
        Problem(
            line_of("camera.driver"), "camera.v4l2.rig",
            "\"\", expected the rig file of the camera's head with camera.v4l2.layout = \"rig\"");
      }
      if (const Status devices = v4l2::CheckDevices(camera); !devices) {
        Problem(line_of("camera.v4l2.devices"), "camera.v4l2.devices", devices.error().message);
      }
      if ((camera.width == 0) != (camera.height == 0)) {
        Problem(line_of("camera.v4l2.width"), "camera.v4l2.width",
                fmt::format("{}, expected it and camera.v4l2.height, now {}, both 0 or neither",
                            camera.width, camera.height));
      }
    }
    if (config.trigger.source == TriggerKind::kReplay &&
        config.camera.driver != CameraDriver::kReplay) {
      Problem(line_of("trigger.source"), "trigger.source",
              "\"replay\", expected another source unless camera.driver = \"replay\"");
    }
    CheckVehicle(line_of);
    CheckStorage(line_of);
    if (const auto tcp = ParseTcpEndpoint(config.api.tcp);
        tcp && !tcp->loopback() && !config.api.tcp_remote) {
      Problem(line_of("api.tcp"), "api.tcp",
              fmt::format("{}, expected a loopback address unless api.tcp_remote = true",
                          TomlText(config.api.tcp)));
    }
    const BracketConfig& bracket = config.bracket;
    if (bracket.max_blur_px > 0.0 && bracket.speed_m_s <= 0.0) {
      Problem(line_of("bracket.max_blur_px"), "bracket.speed_m_s",
              "0, expected the speed that is driven with bracket.max_blur_px");
    }
    CheckMetering(line_of);
    const int steps = static_cast<int>(bracket.Exposures().size());
    if (config.trigger.burst && bracket.frames_per_position != 1 &&
        bracket.frames_per_position != steps) {
      Problem(line_of("bracket.frames_per_position"), "bracket.frames_per_position",
              fmt::format("{}, expected 1 or the {} exposures of the bracket with trigger.burst",
                          bracket.frames_per_position, steps));
    }
    if (config.trigger.burst && bracket.order == BracketOrder::kTriangle) {
      Problem(line_of("trigger.burst"), "bracket.order",
              "\"triangle\", expected \"sawtooth\" or \"list\" with trigger.burst");
    }
    if (bracket.start_s > 0.0) {
      const double longest = bracket.Exposures().back().seconds();
      if (!(longest <= 100.0)) {
        Problem(line_of("bracket.start_s"), "bracket.count",
                fmt::format("{}, expected the longest exposure, now {:g} s, within 100 s",
                            bracket.count, longest));
      }
      if (bracket.order == BracketOrder::kList) {
        Problem(line_of("bracket.order"), "bracket.order",
                "\"list\", expected \"sawtooth\" or \"triangle\" with bracket.start_s");
      }
    } else if (bracket.exposures_s.empty()) {
      Problem(line_of("bracket.exposures_s"), "bracket.exposures_s",
              "[], expected at least one exposure, or bracket.start_s");
    } else if (bracket.order != BracketOrder::kList) {
      std::vector<double> sorted = bracket.exposures_s;
      std::sort(sorted.begin(), sorted.end());
      if (std::adjacent_find(sorted.begin(), sorted.end()) != sorted.end()) {
        Problem(line_of("bracket.exposures_s"), "bracket.exposures_s",
                fmt::format("{}, expected no exposure twice unless bracket.order = \"list\"",
                            FindConfigKey("bracket.exposures_s")->show(config)));
      }
    }
  }

  void Problem(ConfigSource source, std::string key, std::string message) {
    loaded_.problems.push_back(
        {std::move(source.file), source.line, std::move(key), std::move(message)});
  }

  LoadedConfig Take() && { return std::move(loaded_); }

 private:
  template <typename LineOf>
  void CheckStorage(const LineOf& line_of) {
    const StorageLimits& limits = loaded_.config.storage.limits;
    const RetentionOptions& retention = loaded_.config.storage.retention;
    const auto not_above = [&](const char* stop, double stop_value, const char* warn,
                               double warn_value) {
      if (warn_value == 0.0 || stop_value <= warn_value) return;
      Problem(line_of(stop), stop,
              fmt::format("{}, expected at most {}, {}", TomlText(stop_value), warn,
                          TomlText(warn_value)));
    };
    not_above("storage.stop_free_mb", limits.stop_free_mb, "storage.warn_free_mb",
              limits.warn_free_mb);
    not_above("storage.stop_minutes", limits.stop_minutes, "storage.warn_minutes",
              limits.warn_minutes);
    if (retention.deletes == Retention::kNothing) return;
    if (!retention.on()) {
      Problem(line_of("storage.retention"), "storage.retention_days",
              fmt::format("0, expected it or storage.retention_gb with storage.retention = {}",
                          TomlText(ToString(retention.deletes))));
    }
    if (retention.deletes == Retention::kSessions && !loaded_.config.session.name.empty()) {
      Problem(line_of("storage.retention"), "session.name",
              fmt::format("{}, expected \"\" with storage.retention = \"sessions\"",
                          TomlText(loaded_.config.session.name)));
    }
  }

  // [trigger], [gpio], [modbus] and [gnss] against each other.
  template <typename LineOf>
  void CheckVehicle(const LineOf& line_of) {
    const DaemonConfig& config = loaded_.config;
    const auto check = [&](const char* key, const char* section, const Status& valid) {
      if (!valid) Problem(line_of(key), section, valid.error().message);
    };
    const gpio::InputsOptions& inputs = config.gpio.inputs;
    const bool client = config.modbus.client.endpoint.connection != modbus::Connection::kOff;
    check("gpio.trigger.line", "gpio", inputs.Validate());
    check("gpio.outputs.chip", "gpio", config.gpio.outputs.Validate());
    if (client) check("modbus.client.connection", "modbus.client", config.modbus.client.Validate());
    if (config.modbus.server.endpoint.connection != modbus::Connection::kOff) {
      check("modbus.server.connection", "modbus.server", config.modbus.server.Validate());
    }
    if (config.trigger.source == TriggerKind::kGpio && !inputs.trigger.name.configured()) {
      Problem(line_of("trigger.source"), "gpio.trigger.line",
              "\"\", expected a line with trigger.source = \"gpio\"");
    }
    if (config.trigger.wired) CheckWired(line_of);
    if (config.gpio.camera_trigger.configured()) CheckCameraTrigger(line_of);
    if (inputs.trigger.name.configured() && inputs.trigger.name.line == inputs.wheel.name.line &&
        inputs.trigger.name.chip == inputs.wheel.name.chip) {
      Problem(line_of("gpio.wheel.line"), "gpio.wheel.line",
              fmt::format("{}, expected another line than gpio.trigger.line",
                          TomlText(inputs.wheel.name.line)));
    }
    if (config.trigger.odometer == OdometerKind::kWheel) {
      if (!inputs.wheel.name.configured()) {
        Problem(line_of("trigger.odometer"), "gpio.wheel.line",
                "\"\", expected a line with trigger.odometer = \"wheel\"");
      } else if (config.trigger.distance_m * inputs.pulses_per_metre < 1.0) {
        Problem(line_of("trigger.distance_m"), "trigger.distance_m",
                fmt::format("{}, expected at least one pulse of the wheel, {:g} m",
                            TomlText(config.trigger.distance_m), 1.0 / inputs.pulses_per_metre));
      }
    }
    if (config.trigger.odometer == OdometerKind::kModbus &&
        (!client || !config.modbus.client.odometer.configured())) {
      Problem(line_of("trigger.odometer"), "modbus.client.odometer.register",
              "-1, expected a register, and a connection, with trigger.odometer = \"modbus\"");
    }
  }

  // A first look at the scene, and the bracket that it proposes.
  template <typename LineOf>
  void CheckMetering(const LineOf& line_of) {
    const DaemonConfig& config = loaded_.config;
    if (config.bracket.meter == Metering::kOff) return;
    const auto problem = [&](const char* key, const char* message) {
      Problem(line_of("bracket.meter"), key, message);
    };
    if (config.camera.driver == CameraDriver::kReplay) {
      problem("bracket.meter", "expected \"off\" with camera.driver = \"replay\"");
    }
    if (config.trigger.wired)
      problem("bracket.meter", "expected \"off\" with trigger.wired = true");
    if (config.bracket.meter != Metering::kAdopt) return;
    if (config.trigger.burst || config.bracket.frames_per_position != 1) {
      problem(
          "bracket.meter",
          "\"adopt\", expected \"report\" or \"off\" with several frames at a position: how many "
          "exposures a scene needs is not known before");
    }
  }

  // A camera that hangs on the trigger's wire.
  template <typename LineOf>
  void CheckWired(const LineOf& line_of) {
    const DaemonConfig& config = loaded_.config;
    const auto problem = [&](const char* key, const char* message) {
      Problem(line_of("trigger.wired"), key, message);
    };
    const CameraDriver driver = config.camera.driver;
    if (driver != CameraDriver::kIidc && driver != CameraDriver::kSim) {
      problem(
          "camera.driver",
          driver == CameraDriver::kV4l2
              ? "\"v4l2\", expected \"iidc\" or \"sim\" with trigger.wired = true: V4L2 cameras "
                "run freely, and nothing of V4L2 says that one exposes at pulses"
              : "expected \"iidc\" or \"sim\" with trigger.wired = true");
    }
    if (driver == CameraDriver::kIidc && config.trigger.source != TriggerKind::kGpio) {
      problem("trigger.source",
              "expected \"gpio\", the line on the wire, with trigger.wired = true");
    }
    if (driver == CameraDriver::kIidc && config.camera.iidc.trigger_mode == 15) {
      problem("camera.iidc.trigger_mode", "15, expected 0 or 14 with trigger.wired = true");
    }
    if (config.trigger.burst) {
      problem("trigger.burst",
              "true, expected false with trigger.wired = true: a pulse is a picture");
    }
  }

  // A camera that is made to expose by a line of ours.
  template <typename LineOf>
  void CheckCameraTrigger(const LineOf& line_of) {
    constexpr const char* kKey = "gpio.outputs.camera_trigger";
    const DaemonConfig& config = loaded_.config;
    const gpio::CameraTriggerOptions options = config.gpio.CameraTrigger();
    const auto problem = [&](const char* key, const std::string& message) {
      Problem(line_of(kKey), key, message);
    };
    if (const Status valid = options.Validate(); !valid) {
      problem("gpio", valid.error().message);
    }
    const gpio::OutputsOptions& outputs = config.gpio.outputs;
    const gpio::InputsOptions& inputs = config.gpio.inputs;
    const std::pair<const char*, gpio::LineName> others[] = {
        {"gpio.outputs.ready", {outputs.chip, outputs.ready}},
        {"gpio.outputs.busy", {outputs.chip, outputs.busy}},
        {"gpio.outputs.fault", {outputs.chip, outputs.fault}},
        {"gpio.outputs.strobe", {outputs.chip, outputs.strobe}},
        {"gpio.trigger.line", inputs.trigger.name},
        {"gpio.wheel.line", inputs.wheel.name}};
    for (const auto& [key, other] : others) {
      if (other.line != options.name.line || other.chip != options.name.chip) continue;
      problem(kKey, fmt::format("{}, expected another line than {}", TomlText(other.line), key));
    }
    const CameraDriver driver = config.camera.driver;
    if (driver != CameraDriver::kIidc && driver != CameraDriver::kSim) {
      problem("camera.driver",
              fmt::format("{}, expected \"iidc\" or \"sim\" with {}: others have no input for it",
                          TomlText(ToString(driver)), kKey));
    }
    if (driver == CameraDriver::kIidc && config.camera.iidc.trigger_mode == 15) {
      problem("camera.iidc.trigger_mode", fmt::format("15, expected 0 or 14 with {}", kKey));
    }
    if (config.trigger.wired) {
      problem(
          "trigger.wired",
          fmt::format("true, expected false with {}: the wire is either observed or pulsed", kKey));
    }
    if (config.trigger.source == TriggerKind::kTimer &&
        config.trigger.interval_s < options.spacing_s) {
      problem("trigger.interval_s",
              fmt::format("{}, expected at least gpio.outputs.camera_trigger_spacing_s, {}",
                          TomlText(config.trigger.interval_s), TomlText(options.spacing_s)));
    }
  }

  std::string DefaultFile() const {
    return loaded_.files.empty() ? std::string("built-in default") : loaded_.files.front();
  }

  // The form of the bracket given last replaces the other; both in one file contradict each other.
  void ChooseBracketForm(const std::string& file) {
    const auto given_here = [&](const char* key) {
      const auto found = loaded_.sources.find(key);
      return found != loaded_.sources.end() && found->second.file == file;
    };
    BracketConfig& bracket = loaded_.config.bracket;
    const bool listed = given_here("bracket.exposures_s") && !bracket.exposures_s.empty();
    const bool stepped = given_here("bracket.start_s") && bracket.start_s > 0.0;
    if (listed && stepped) {
      Problem(loaded_.sources["bracket.start_s"], "bracket.start_s",
              fmt::format("{}, expected either bracket.exposures_s or bracket.start_s, not both",
                          TomlText(bracket.start_s)));
    } else if (listed) {
      bracket.start_s = 0.0;
    } else if (stepped) {
      bracket.exposures_s.clear();
    }
  }

  LoadedConfig loaded_;
};

std::string SourceText(const LoadedConfig& loaded, const std::string& key) {
  const auto found = loaded.sources.find(key);
  return found == loaded.sources.end()
             ? std::string("default")
             : fmt::format("{}:{}", found->second.file, found->second.line);
}

}  // namespace

std::string_view ToString(OnExistingSession value) {
  return value == OnExistingSession::kResume ? "resume" : "refuse";
}

bool TcpEndpoint::loopback() const { return address.starts_with("127.") || address == "::1"; }

std::optional<TcpEndpoint> ParseTcpEndpoint(std::string_view text) {
  const std::size_t colon = text.rfind(':');
  if (colon == std::string_view::npos) return std::nullopt;
  const std::string_view port = text.substr(colon + 1);
  std::string_view address = text.substr(0, colon);
  const bool bracketed = address.size() > 2 && address.front() == '[' && address.back() == ']';
  if (bracketed) address = address.substr(1, address.size() - 2);
  // An IPv6 address has colons of its own: without brackets its port is a guess.
  if (bracketed != (address.find(':') != std::string_view::npos)) return std::nullopt;
  TcpEndpoint endpoint;
  endpoint.address = address;
  const char* const end = port.data() + port.size();
  const auto [stop, error] = std::from_chars(port.data(), end, endpoint.port);
  if (error != std::errc() || stop != end || endpoint.port < 1 || endpoint.port > 65535 ||
      !IsNumericAddress(endpoint.address)) {
    return std::nullopt;
  }
  return endpoint;
}

std::string_view ToString(Retention value) {
  switch (value) {
    case Retention::kNothing:
      return "nothing";
    case Retention::kViews:
      return "views";
    case Retention::kSessions:
      return "sessions";
  }
  return "?";
}

std::string_view ToString(CameraDriver value) {
  switch (value) {
    case CameraDriver::kSim:
      return "sim";
    case CameraDriver::kReplay:
      return "replay";
    case CameraDriver::kIidc:
      return "iidc";
    case CameraDriver::kV4l2:
      return "v4l2";
  }
  return "?";
}

std::string_view ToString(IidcCycle value) {
  switch (value) {
    case IidcCycle::kAuto:
      return "auto";
    case IidcCycle::kOff:
      return "off";
    case IidcCycle::kOn:
      return "on";
  }
  return "?";
}

std::string_view ToString(IidcFormat value) { return value == IidcFormat::kRaw ? "raw" : "jpeg"; }

std::string_view ToString(Metering value) {
  switch (value) {
    case Metering::kOff:
      return "off";
    case Metering::kReport:
      return "report";
    case Metering::kAdopt:
      return "adopt";
  }
  return "off";
}

std::string_view ToString(IidcBus value) { return value == IidcBus::kUsb ? "usb" : "firewire"; }

std::string_view ToString(IidcCoding value) {
  switch (value) {
    case IidcCoding::kRaw8:
      return "raw8";
    case IidcCoding::kMono8:
      return "mono8";
    case IidcCoding::kRaw16:
      return "raw16";
    case IidcCoding::kMono16:
      return "mono16";
  }
  return "?";
}

std::string_view ToString(SimScene value) {
  switch (value) {
    case SimScene::kHall:
      return "hall";
    case SimScene::kYard:
      return "yard";
    case SimScene::kTunnel:
      return "tunnel";
    case SimScene::kStreet:
      return "street";
  }
  return "?";
}

std::string_view ToString(SimLayout value) { return value == SimLayout::kRig ? "rig" : "panorama"; }

std::string_view ToString(TriggerKind value) {
  switch (value) {
    case TriggerKind::kSoftware:
      return "software";
    case TriggerKind::kTimer:
      return "timer";
    case TriggerKind::kDistance:
      return "distance";
    case TriggerKind::kGpio:
      return "gpio";
    case TriggerKind::kReplay:
      return "replay";
  }
  return "?";
}

std::string_view ToString(OdometerKind value) {
  switch (value) {
    case OdometerKind::kSim:
      return "sim";
    case OdometerKind::kWheel:
      return "wheel";
    case OdometerKind::kModbus:
      return "modbus";
  }
  return "?";
}

std::string_view ToString(LogLevel value) {
  switch (value) {
    case LogLevel::kDebug:
      return "debug";
    case LogLevel::kInfo:
      return "info";
    case LogLevel::kWarning:
      return "warning";
    case LogLevel::kError:
      return "error";
  }
  return "?";
}

std::vector<ExposureTime> BracketConfig::Exposures() const {
  std::vector<ExposureTime> exposures;
  if (start_s > 0.0) {
    for (int i = 0; i < count; ++i) {
      exposures.push_back(ExposureTime::Seconds(start_s) + Stops{i * step_stops});
    }
  } else {
    for (const double seconds : exposures_s) exposures.push_back(ExposureTime::Seconds(seconds));
  }
  return exposures;
}

std::string ConfigProblem::ToString() const {
  std::string text = line > 0 ? fmt::format("{}:{}: ", file, line) : fmt::format("{}: ", file);
  if (!key.empty()) text += key + ": ";
  return text + message;
}

LoadedConfig LoadConfig(const fs::path& file, bool must_exist) {
  Loader loader;
  std::error_code error;
  if (must_exist || fs::exists(file, error)) loader.ApplyFile(file);

  const fs::path directory = file.parent_path() / kDropInDirectory;
  std::vector<fs::path> drop_ins;
  if (fs::exists(directory, error)) {
    fs::directory_iterator it(directory, error);
    for (const fs::directory_iterator end; !error && it != end; it.increment(error)) {
      const std::string name = it->path().filename().string();
      if (it->path().extension() == ".toml" && !name.starts_with('.')) {
        drop_ins.push_back(it->path());
      }
      if (drop_ins.size() > kMaxDropIns) break;
    }
    if (error) loader.Problem({directory.string(), 0}, "", error.message());
  }
  if (drop_ins.size() > kMaxDropIns) {
    loader.Problem({directory.string(), 0}, "",
                   fmt::format("over {} files, expected at most so many", kMaxDropIns));
    drop_ins.clear();
  }
  std::sort(drop_ins.begin(), drop_ins.end());
  for (const fs::path& path : drop_ins) loader.ApplyFile(path);
  loader.CheckTogether();
  return std::move(loader).Take();
}

LoadedConfig ParseConfig(std::string_view toml, const std::string& name) {
  Loader loader;
  loader.Apply(toml, name);
  loader.CheckTogether();
  return std::move(loader).Take();
}

Result<DaemonConfig> ConfigOrError(LoadedConfig loaded) {
  if (loaded.ok()) return std::move(loaded.config);
  std::string message;
  for (const ConfigProblem& problem : loaded.problems) {
    if (!message.empty()) message += '\n';
    message += problem.ToString();
  }
  return Fail(ErrorKind::kConfig, "{}", message);
}

std::vector<std::string> ConfigKeyNames() {
  std::vector<std::string> names;
  for (const ConfigKey& key : ConfigKeys()) names.push_back(key.name);
  return names;
}

Result<std::string> ConfigValueToToml(const DaemonConfig& config, std::string_view key) {
  const ConfigKey* found = FindConfigKey(key);
  if (found == nullptr) {
    return Fail(ErrorKind::kUsage, "{}: expected a known key{}", key, Suggestion(key));
  }
  return found->show(config);
}

std::string FormatConfig(const LoadedConfig& loaded) {
  std::string text;
  std::string section;
  for (const ConfigKey& key : ConfigKeys()) {
    const std::string key_section = key.name.substr(0, key.name.rfind('.'));
    if (key_section != section) {
      text += fmt::format("{}[{}]\n", section.empty() ? "" : "\n", key_section);
      section = key_section;
    }
    text += fmt::format("{:<44} # {}\n",
                        fmt::format("{} = {}", LastPart(key.name), key.show(loaded.config)),
                        SourceText(loaded, key.name));
  }
  return text;
}

std::string FormatConfigJson(const LoadedConfig& loaded) {
  std::string text = "{\"files\": [";
  for (std::size_t i = 0; i < loaded.files.size(); ++i) {
    text += fmt::format("{}{}", i > 0 ? ", " : "", TomlText(loaded.files[i]));
  }
  text += "],\n \"values\": {";
  bool first = true;
  for (const ConfigKey& key : ConfigKeys()) {
    text += fmt::format("{}\n  \"{}\": {{\"value\": {}, \"source\": {}}}", first ? "" : ",",
                        key.name, key.show(loaded.config), TomlText(SourceText(loaded, key.name)));
    first = false;
  }
  return text + "\n }}\n";
}

}  // namespace omnihdr
