#include "daemon/config_keys.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <optional>
#include <utility>

#include "daemon/config_key_makers.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

using namespace config_key_makers;  // NOLINT(google-build-using-namespace)

ConfigKey SessionName() {
  return {
      "session.name",
      "a directory name of at most 128 bytes without \"/\", not beginning with \".\", or \"\" for "
      "the time of the start",
      [](DaemonConfig& config, const TomlValue& value, const fs::path&) {
        if (value.type != TomlValue::Type::kString || value.text.size() > 128) return false;
        const bool plain = std::none_of(value.text.begin(), value.text.end(), [](char c) {
          return c == '/' || static_cast<unsigned char>(c) < 0x20 || c == 0x7F;
        });
        if (!plain || value.text.starts_with('.')) return false;
        config.session.name = value.text;
        return true;
      },
      [](const DaemonConfig& config) { return TomlText(config.session.name); }};
}

// A GUID or a serial number.
ConfigKey CameraId() {
  return {"camera.iidc.id",
          "a GUID of 16 hexadecimal digits, a serial number of at most 10 digits, or \"\" for the "
          "only camera there",
          [](DaemonConfig& config, const TomlValue& value, const fs::path&) {
            const std::string& text = value.text;
            if (value.type != TomlValue::Type::kString) return false;
            const auto digit = [](char c) { return c >= '0' && c <= '9'; };
            const auto hexadecimal = [&](char c) {
              return digit(c) || (c >= 'a' && c <= 'f') || (c >= 'A' && c <= 'F');
            };
            const bool guid =
                text.size() == 16 && std::all_of(text.begin(), text.end(), hexadecimal);
            const bool serial = text.size() <= 10 && std::all_of(text.begin(), text.end(), digit);
            if (!guid && !serial) return false;
            config.camera.iidc.id = text;
            return true;
          },
          [](const DaemonConfig& config) { return TomlText(config.camera.iidc.id); }};
}

// A colour temperature.
ConfigKey WhiteBalanceKelvin() {
  return {"camera.v4l2.white_balance", "kelvin in [1000, 20000], or 0 for the camera's own",
          [](DaemonConfig& config, const TomlValue& value, const fs::path&) {
            if (value.type != TomlValue::Type::kInteger ||
                (value.integer != 0 && (value.integer < 1000 || value.integer > 20000))) {
              return false;
            }
            config.camera.v4l2.white_balance = static_cast<int>(value.integer);
            return true;
          },
          [](const DaemonConfig& config) {
            return fmt::format("{}", config.camera.v4l2.white_balance);
          }};
}

ConfigKey Devices() {
  constexpr std::size_t kMostBytes = 256;
  return {
      "camera.v4l2.devices",
      fmt::format("an array of 2 to {} paths, names or serial numbers, or []", v4l2::kMaxDevices),
      [](DaemonConfig& config, const TomlValue& value, const fs::path&) {
        if (value.type != TomlValue::Type::kArray || value.items.size() == 1 ||
            value.items.size() > v4l2::kMaxDevices) {
          return false;
        }
        std::vector<std::string> devices;
        for (const TomlValue& item : value.items) {
          if (item.type != TomlValue::Type::kString || item.text.empty() ||
              item.text.size() > kMostBytes || item.text.find('\0') != std::string::npos) {
            return false;
          }
          devices.push_back(item.text);
        }
        config.camera.v4l2.devices = std::move(devices);
        return true;
      },
      [](const DaemonConfig& config) {
        std::string text = "[";
        for (const std::string& device : config.camera.v4l2.devices) {
          if (text.size() > 1) text += ", ";
          text += TomlText(device);
        }
        return text + "]";
      }};
}

ConfigKey TriggerMode() {
  return {"camera.iidc.trigger_mode", "0, 14 or 15",
          [](DaemonConfig& config, const TomlValue& value, const fs::path&) {
            if (value.type != TomlValue::Type::kInteger ||
                (value.integer != 0 && value.integer != 14 && value.integer != 15)) {
              return false;
            }
            config.camera.iidc.trigger_mode = static_cast<int>(value.integer);
            return true;
          },
          [](const DaemonConfig& config) {
            return fmt::format("{}", config.camera.iidc.trigger_mode);
          }};
}

ConfigKey FlickerHz() {
  return {"bracket.flicker_hz", "0, 50 or 60",
          [](DaemonConfig& config, const TomlValue& value, const fs::path&) {
            if (value.type != TomlValue::Type::kInteger ||
                (value.integer != 0 && value.integer != 50 && value.integer != 60)) {
              return false;
            }
            config.bracket.flicker_hz = static_cast<int>(value.integer);
            return true;
          },
          [](const DaemonConfig& config) { return fmt::format("{}", config.bracket.flicker_hz); }};
}

ConfigKey Exposures() {
  constexpr std::size_t kMaxSteps = 64;
  return {
      "bracket.exposures_s",
      "an array of at most 64 exposure times, each in seconds in [1e-06, 100], no two neighbours "
      "alike",
      [](DaemonConfig& config, const TomlValue& value, const fs::path&) {
        if (value.type != TomlValue::Type::kArray || value.items.size() > kMaxSteps) return false;
        std::vector<double> exposures;
        for (const TomlValue& item : value.items) {
          const std::optional<double> seconds = AsNumber(item);
          if (!seconds || *seconds < 1e-6 || *seconds > 100.0) return false;
          if (!exposures.empty() && exposures.back() == *seconds) return false;
          exposures.push_back(*seconds);
        }
        config.bracket.exposures_s = std::move(exposures);
        return true;
      },
      [](const DaemonConfig& config) {
        std::string text = "[";
        for (const double seconds : config.bracket.exposures_s) {
          if (text.size() > 1) text += ", ";
          text += TomlText(seconds);
        }
        return text + "]";
      }};
}

ConfigKey WhiteBalance() {
  return {"photometry.white_balance", "an array of three gains (R, G, B), each from 0.1 to 10",
          [](DaemonConfig& config, const TomlValue& value, const fs::path&) {
            std::array<double, 3>& gains = config.pipeline.options.white_balance;
            if (value.type != TomlValue::Type::kArray || value.items.size() != gains.size()) {
              return false;
            }
            for (std::size_t c = 0; c < gains.size(); ++c) {
              const std::optional<double> gain = AsNumber(value.items[c]);
              if (!gain || *gain < 0.1 || *gain > 10.0) return false;
              gains[c] = *gain;
            }
            return true;
          },
          [](const DaemonConfig& config) {
            const std::array<double, 3>& gains = config.pipeline.options.white_balance;
            std::string text = "[";
            for (const double gain : gains) {
              if (text.size() > 1) text += ", ";
              text += TomlText(gain);
            }
            return text + "]";
          }};
}

ConfigKey SocketMode() {
  return {
      "api.socket_mode", "three octal digits after a 0, such as \"0660\"",
      [](DaemonConfig& config, const TomlValue& value, const fs::path&) {
        const std::string& text = value.text;
        if (value.type != TomlValue::Type::kString || text.size() != 4 || text[0] != '0' ||
            !std::all_of(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '7'; })) {
          return false;
        }
        unsigned mode = 0;
        for (const char c : text) mode = mode * 8 + static_cast<unsigned>(c - '0');
        config.api.socket_mode = mode;
        return true;
      },
      [](const DaemonConfig& config) {
        return TomlText(fmt::format("{:04o}", config.api.socket_mode));
      }};
}

ConfigKey Tcp() {
  return {"api.tcp",
          "a numeric address and a port of 1 to 65535, such as \"127.0.0.1:8787\" or "
          "\"[::1]:8787\", or \"\" for no TCP",
          [](DaemonConfig& config, const TomlValue& value, const fs::path&) {
            if (value.type != TomlValue::Type::kString ||
                (!value.text.empty() && !ParseTcpEndpoint(value.text))) {
              return false;
            }
            config.api.tcp = value.text;
            return true;
          },
          [](const DaemonConfig& config) { return TomlText(config.api.tcp); }};
}

ConfigKey ChromaticityKey() {
  return {
      "output.chromaticities",
      "an array of 8 numbers from -1 to 2: x and y of red, green, blue and white, white inside the "
      "triangle of the others",
      [](DaemonConfig& config, const TomlValue& value, const fs::path&) {
        Chromaticities& chromaticities = config.pipeline.options.chromaticities;
        if (value.type != TomlValue::Type::kArray || value.items.size() != chromaticities.size()) {
          return false;
        }
        Chromaticities read{};
        for (std::size_t i = 0; i < read.size(); ++i) {
          const std::optional<double> number = AsNumber(value.items[i]);
          if (!number) return false;
          read[i] = *number;
        }
        if (!WhyNotChromaticities(read).empty()) return false;
        chromaticities = read;
        return true;
      },
      [](const DaemonConfig& config) {
        std::string text;
        for (const double number : config.pipeline.options.chromaticities) {
          text += (text.empty() ? "[" : ", ") + TomlText(number);
        }
        return text + "]";
      }};
}

std::vector<ConfigKey> MakeKeys() {
  constexpr std::int64_t kMaxInteger = std::numeric_limits<std::int64_t>::max();
  constexpr std::size_t kPathBytes = 4096;
  constexpr std::size_t kSocketPathBytes = 107;  // sockaddr_un
  std::vector<ConfigKey> keys;
  const auto add = [&keys](ConfigKey key) { keys.push_back(std::move(key)); };

  add(Path("session.directory", "a directory", Empty::kRefused, kPathBytes,
           OMNIHDR_MEMBER(session.directory)));
  add(SessionName());
  add(Choice("session.on_existing",
             std::vector{OnExistingSession::kResume, OnExistingSession::kRefuse},
             OMNIHDR_MEMBER(session.on_existing)));
  add(NumberOrZero("session.rotate_gb", "gigabytes", "for no such limit", 0.001, 1e6,
                   OMNIHDR_MEMBER(session.rotation.gb)));
  add(Whole("session.rotate_positions", "positions", 0, 1'000'000,
            OMNIHDR_MEMBER(session.rotation.positions)));
  add(NumberOrZero("session.rotate_hours", "hours", "for no such limit", 0.001, 1e4,
                   OMNIHDR_MEMBER(session.rotation.hours)));

  add(Choice("camera.driver",
             std::vector{CameraDriver::kSim, CameraDriver::kReplay, CameraDriver::kIidc,
                         CameraDriver::kV4l2},
             OMNIHDR_MEMBER(camera.driver)));
  add(Number("camera.frame_timeout_s", "seconds", 0.01, 600,
             OMNIHDR_MEMBER(camera.frame_timeout_s)));
  add(Number("camera.exposure_tolerance", "a fraction", 0, 1,
             OMNIHDR_MEMBER(camera.exposure_tolerance)));
  add(Number("camera.reconnect_s", "seconds", 0.1, 3600, OMNIHDR_MEMBER(camera.reconnect_s)));
  add(Switch("camera.check_orientation", OMNIHDR_MEMBER(camera.check_orientation)));

  add(Choice("camera.sim.scene",
             std::vector{SimScene::kHall, SimScene::kYard, SimScene::kTunnel, SimScene::kStreet},
             OMNIHDR_MEMBER(camera.sim.scene)));
  add(Whole("camera.sim.seed", "a whole number", 0, kMaxInteger, OMNIHDR_MEMBER(camera.sim.seed)));
  add(Choice("camera.sim.layout", std::vector{SimLayout::kPanorama, SimLayout::kRig},
             OMNIHDR_MEMBER(camera.sim.layout)));
  add(EvenPixels("camera.sim.width", "", 128, 8192, OMNIHDR_MEMBER(camera.sim.width)));
  add(Choice("camera.sim.projection",
             std::vector{ProjectionKind::kEquirectangular, ProjectionKind::kCylindrical},
             OMNIHDR_MEMBER(camera.sim.projection)));
  add(Path("camera.sim.rig", "a rig file or \"\"", Empty::kAllowed, kPathBytes,
           OMNIHDR_MEMBER(camera.sim.rig)));
  add(EvenPixels("camera.sim.sensor_width", "as the rig says", 64, 8192,
                 OMNIHDR_MEMBER(camera.sim.sensor_width)));
  add(Number("camera.sim.photons_full_well", "electrons", 100, 1e7,
             OMNIHDR_MEMBER(camera.sim.photons_full_well)));
  add(Number("camera.sim.read_noise", "code values", 0, 20, OMNIHDR_MEMBER(camera.sim.read_noise)));
  add(Number("camera.sim.speed_m_s", "metres per second", 0.001, 100,
             OMNIHDR_MEMBER(camera.sim.speed_m_s)));
  add(Number("camera.sim.yaw_deg_per_m", "degrees per metre", -360, 360,
             OMNIHDR_MEMBER(camera.sim.yaw_deg_per_m)));
  add(Number("camera.sim.sway_deg", "degrees", 0, 10, OMNIHDR_MEMBER(camera.sim.sway_deg)));
  add(Whole("camera.sim.movers", "a whole number", 0, 16, OMNIHDR_MEMBER(camera.sim.movers)));
  add(Number("camera.sim.mover_speed_m_s", "metres per second", 0, 20,
             OMNIHDR_MEMBER(camera.sim.mover_speed_m_s)));
  add(Number("camera.sim.latency_s", "seconds", 0, 60, OMNIHDR_MEMBER(camera.sim.latency_s)));
  add(Number("camera.sim.lost_frame_probability", "a probability", 0, 1,
             OMNIHDR_MEMBER(camera.sim.lost_frame_probability)));
  add(Number("camera.sim.corrupt_frame_probability", "a probability", 0, 1,
             OMNIHDR_MEMBER(camera.sim.corrupt_frame_probability)));
  add(Number("camera.sim.exposure_error_probability", "a probability", 0, 1,
             OMNIHDR_MEMBER(camera.sim.exposure_error_probability)));
  add(Number("camera.sim.vanish_probability", "a probability", 0, 1,
             OMNIHDR_MEMBER(camera.sim.vanish_probability)));
  add(Number("camera.sim.away_s", "seconds", 0, 3600, OMNIHDR_MEMBER(camera.sim.away_s)));
  add(NumberOrZero("camera.sim.max_distance_m", "metres", "for no end", 0.001, 1e6,
                   OMNIHDR_MEMBER(camera.sim.max_distance_m)));
  add(Path("camera.replay.session", "a session directory or \"\"", Empty::kAllowed, kPathBytes,
           OMNIHDR_MEMBER(camera.replay.session)));

  add(Choice("camera.iidc.bus", std::vector{IidcBus::kUsb, IidcBus::kFirewire},
             OMNIHDR_MEMBER(camera.iidc.bus)));
  add(CameraId());
  add(Path("camera.iidc.rig", "a rig file or \"\"", Empty::kAllowed, kPathBytes,
           OMNIHDR_MEMBER(camera.iidc.rig)));
  add(Choice("camera.iidc.format", std::vector{IidcFormat::kRaw, IidcFormat::kJpeg},
             OMNIHDR_MEMBER(camera.iidc.format)));
  add(Whole("camera.iidc.jpeg_quality", "a whole number", 1, 100,
            OMNIHDR_MEMBER(camera.iidc.jpeg_quality)));
  add(Whole("camera.iidc.mode", "a whole number", 0, 7, OMNIHDR_MEMBER(camera.iidc.mode)));
  add(Choice(
      "camera.iidc.coding",
      std::vector{IidcCoding::kRaw8, IidcCoding::kMono8, IidcCoding::kRaw16, IidcCoding::kMono16},
      OMNIHDR_MEMBER(camera.iidc.coding)));
  add(EvenPixels("camera.iidc.left", "", 0, 65534, OMNIHDR_MEMBER(camera.iidc.left)));
  add(EvenPixels("camera.iidc.top", "", 0, 65534, OMNIHDR_MEMBER(camera.iidc.top)));
  add(Whole("camera.iidc.packet_bytes", "bytes", 0, 65535,
            OMNIHDR_MEMBER(camera.iidc.packet_bytes)));
  add(TriggerMode());
  add(Whole("camera.iidc.trigger_input", "a whole number", 0, 3,
            OMNIHDR_MEMBER(camera.iidc.trigger_input)));
  add(Switch("camera.iidc.trigger_active_low", OMNIHDR_MEMBER(camera.iidc.trigger_active_low)));
  add(Whole("camera.iidc.settle_frames", "a whole number", -1, 8,
            OMNIHDR_MEMBER(camera.iidc.settle_frames)));
  add(Choice("camera.iidc.exposure_cycle",
             std::vector{IidcCycle::kAuto, IidcCycle::kOff, IidcCycle::kOn},
             OMNIHDR_MEMBER(camera.iidc.exposure_cycle)));
  add(Whole("camera.iidc.white_balance_blue", "a register value", -1, 4095,
            OMNIHDR_MEMBER(camera.iidc.white_balance_blue)));
  add(Whole("camera.iidc.white_balance_red", "a register value", -1, 4095,
            OMNIHDR_MEMBER(camera.iidc.white_balance_red)));
  add(Path("camera.iidc.usb_recording", "a file or \"\"", Empty::kAllowed, kPathBytes,
           OMNIHDR_MEMBER(camera.iidc.usb_recording)));

  add(Text("camera.v4l2.device", "a path, a name or a serial number", 256,
           OMNIHDR_MEMBER(camera.v4l2.device)));
  add(Devices());
  add(Text("camera.v4l2.controls", "a path", 256, OMNIHDR_MEMBER(camera.v4l2.controls_device)));
  add(Choice("camera.v4l2.layout",
             std::vector{Layout::kRig, Layout::kPanorama, Layout::kPerspective},
             OMNIHDR_MEMBER(camera.v4l2.layout)));
  add(Path("camera.v4l2.rig", "a rig file or \"\"", Empty::kAllowed, kPathBytes,
           OMNIHDR_MEMBER(camera.v4l2.rig_file)));
  add(Choice("camera.v4l2.format",
             std::vector{v4l2::Coding::kAuto, v4l2::Coding::kGrey, v4l2::Coding::kY10,
                         v4l2::Coding::kY12, v4l2::Coding::kY16, v4l2::Coding::kBayer8,
                         v4l2::Coding::kBayer10, v4l2::Coding::kBayer12, v4l2::Coding::kBayer16,
                         v4l2::Coding::kYuyv, v4l2::Coding::kMjpeg},
             OMNIHDR_MEMBER(camera.v4l2.coding)));
  add(Whole("camera.v4l2.width", "pixels", 0, 65536, OMNIHDR_MEMBER(camera.v4l2.width)));
  add(Whole("camera.v4l2.height", "pixels", 0, 65536, OMNIHDR_MEMBER(camera.v4l2.height)));
  add(NumberOrZero("camera.v4l2.frame_rate", "frames per second", "for the camera's own", 0.1, 1000,
                   OMNIHDR_MEMBER(camera.v4l2.frame_rate)));
  add(Whole("camera.v4l2.latency_frames", "a whole number", 0, 16,
            OMNIHDR_MEMBER(camera.v4l2.latency_frames)));
  add(Whole("camera.v4l2.gain", "a control value", -1, 1'000'000,
            OMNIHDR_MEMBER(camera.v4l2.gain)));
  add(Whole("camera.v4l2.gain_unity", "a control value", 0, 1'000'000,
            OMNIHDR_MEMBER(camera.v4l2.gain_unity)));
  add(WhiteBalanceKelvin());
  add(Path("camera.v4l2.recording", "a file or \"\"", Empty::kAllowed, kPathBytes,
           OMNIHDR_MEMBER(camera.v4l2.recording)));

  add(Choice("bracket.order",
             std::vector{BracketOrder::kSawtooth, BracketOrder::kTriangle, BracketOrder::kList},
             OMNIHDR_MEMBER(bracket.order)));
  add(Exposures());
  add(NumberOrZero("bracket.start_s", "seconds", "to use exposures_s", 1e-6, 100,
                   OMNIHDR_MEMBER(bracket.start_s)));
  add(Number("bracket.step_stops", "stops", 0.01, 10, OMNIHDR_MEMBER(bracket.step_stops)));
  add(Whole("bracket.count", "a whole number", 1, 64, OMNIHDR_MEMBER(bracket.count)));
  add(Number("bracket.gain_db", "decibels", -20, 60, OMNIHDR_MEMBER(bracket.gain_db)));
  add(Whole("bracket.frames_per_position", "a whole number", 1, 1000,
            OMNIHDR_MEMBER(bracket.frames_per_position)));
  add(FlickerHz());
  add(NumberOrZero("bracket.max_blur_px", "pixels", "for any blur", 0.01, 1000,
                   OMNIHDR_MEMBER(bracket.max_blur_px)));
  add(Number("bracket.speed_m_s", "metres per second", 0, 100, OMNIHDR_MEMBER(bracket.speed_m_s)));
  add(Number("bracket.near_m", "metres", 0.1, 1000, OMNIHDR_MEMBER(bracket.near_m)));
  add(Whole("bracket.retake", "a whole number", 0, 8, OMNIHDR_MEMBER(bracket.retake)));
  add(Choice("bracket.meter", std::vector{Metering::kOff, Metering::kReport, Metering::kAdopt},
             OMNIHDR_MEMBER(bracket.meter)));
  add(Number("bracket.meter_longest_s", "seconds", 1e-5, 10,
             OMNIHDR_MEMBER(bracket.meter_longest_s)));

  add(Choice("trigger.source",
             std::vector{TriggerKind::kSoftware, TriggerKind::kTimer, TriggerKind::kDistance,
                         TriggerKind::kGpio, TriggerKind::kReplay},
             OMNIHDR_MEMBER(trigger.source)));
  add(Number("trigger.interval_s", "seconds", 0.001, 86400, OMNIHDR_MEMBER(trigger.interval_s)));
  add(Number("trigger.distance_m", "metres", 0.001, 10000, OMNIHDR_MEMBER(trigger.distance_m)));
  add(Choice("trigger.odometer",
             std::vector{OdometerKind::kSim, OdometerKind::kWheel, OdometerKind::kModbus},
             OMNIHDR_MEMBER(trigger.odometer)));
  add(Whole("trigger.limit", "a whole number", 0, 1'000'000'000, OMNIHDR_MEMBER(trigger.limit)));
  add(Switch("trigger.armed_at_start", OMNIHDR_MEMBER(trigger.armed_at_start)));
  add(Switch("trigger.burst", OMNIHDR_MEMBER(trigger.burst)));
  add(Switch("trigger.wired", OMNIHDR_MEMBER(trigger.wired)));
  add(Number("trigger.busy_wait_s", "seconds", 0, 10, OMNIHDR_MEMBER(trigger.busy_wait_s)));
  add(Whole("trigger.rearm_after", "triggers", 0, 1000, OMNIHDR_MEMBER(trigger.rearm_after)));

  AddVehicleKeys(keys);

  add(Whole("recorder.queue_frames", "frames", 1, 256, OMNIHDR_MEMBER(recorder.queue_frames)));
  add(Whole("recorder.png_compression", "a whole number", 0, 9,
            OMNIHDR_MEMBER(recorder.png_compression)));
  add(Choice("recorder.durability", std::vector{Durability::kFrame, Durability::kInterval},
             OMNIHDR_MEMBER(recorder.durability)));
  add(Number("recorder.sync_interval_s", "seconds", 0.1, 60,
             OMNIHDR_MEMBER(recorder.sync_interval_s)));

  add(Switch("storage.allow_root", OMNIHDR_MEMBER(storage.allow_root)));
  add(Number("storage.warn_free_mb", "megabytes", 0, 1e9,
             OMNIHDR_MEMBER(storage.limits.warn_free_mb)));
  add(Number("storage.warn_minutes", "minutes", 0, 1e6,
             OMNIHDR_MEMBER(storage.limits.warn_minutes)));
  add(Number("storage.stop_free_mb", "megabytes", 0, 1e9,
             OMNIHDR_MEMBER(storage.limits.stop_free_mb)));
  add(Number("storage.stop_minutes", "minutes", 0, 1e6,
             OMNIHDR_MEMBER(storage.limits.stop_minutes)));
  add(Choice("storage.retention",
             std::vector{Retention::kNothing, Retention::kViews, Retention::kSessions},
             OMNIHDR_MEMBER(storage.retention.deletes)));
  add(Number("storage.retention_days", "days", 0, 1e5, OMNIHDR_MEMBER(storage.retention.days)));
  add(Number("storage.retention_gb", "gigabytes", 0, 1e6, OMNIHDR_MEMBER(storage.retention.gb)));

  add(Path("api.socket", "a socket path of at most 107 bytes", Empty::kRefused, kSocketPathBytes,
           OMNIHDR_MEMBER(api.socket)));
  add(SocketMode());
  add(Text("api.socket_group", "a group's name", 64, OMNIHDR_MEMBER(api.socket_group)));
  add(Tcp());
  add(Switch("api.tcp_remote", OMNIHDR_MEMBER(api.tcp_remote)));
  add(Path("api.token_file", "a file or \"\"", Empty::kAllowed, kPathBytes,
           OMNIHDR_MEMBER(api.token_file)));

  add(Choice("log.level",
             std::vector{LogLevel::kDebug, LogLevel::kInfo, LogLevel::kWarning, LogLevel::kError},
             OMNIHDR_MEMBER(log.level)));

  add(Switch("pipeline.enabled", OMNIHDR_MEMBER(pipeline.enabled)));
  add(Choice("pipeline.mode",
             std::vector{ProcessMode::kAuto, ProcessMode::kSpatiotemporal, ProcessMode::kTemporal},
             OMNIHDR_MEMBER(pipeline.options.mode)));
  add(Whole("pipeline.workers", "a whole number", 0, 256, OMNIHDR_MEMBER(pipeline.workers)));
  add(Choice("pipeline.overload", std::vector{Overload::kBacklog, Overload::kDegrade},
             OMNIHDR_MEMBER(pipeline.overload.overload)));
  add(Whole("pipeline.backlog_limit", "positions", 2, 10000,
            OMNIHDR_MEMBER(pipeline.overload.backlog_limit)));

  add(Path("input.mask", "an image file or \"\"", Empty::kAllowed, kPathBytes,
           OMNIHDR_MEMBER(pipeline.options.mask_file)));

  add(EvenPixels("output.width", "for the width of the input", 128, 8192,
                 OMNIHDR_MEMBER(pipeline.options.output_width)));
  add(Choice("output.orientation",
             std::vector{OutputOrientation::kAligned, OutputOrientation::kCamera},
             OMNIHDR_MEMBER(pipeline.options.orientation)));
  add(Whole("output.preview_quality", "a whole number", 1, 100,
            OMNIHDR_MEMBER(pipeline.options.preview_quality)));
  add(Choice("output.preview_tonemap",
             std::vector{ToneOperator::kReinhard, ToneOperator::kReinhardLocal,
                         ToneOperator::kDrago, ToneOperator::kDurand},
             OMNIHDR_MEMBER(pipeline.options.preview.tone_operator)));
  add(Number("output.preview_exposure_stops", "stops", -20, 20,
             OMNIHDR_MEMBER(pipeline.options.preview.exposure_stops)));
  add(Choice("output.exr_type", std::vector{ExrPixelType::kHalf, ExrPixelType::kFloat},
             OMNIHDR_MEMBER(pipeline.options.exr_type)));
  add(ChromaticityKey());
  add(Choice("output.nan",
             std::vector{NanPixels::kNever, NanPixels::kNoData, NanPixels::kUnmeasured},
             OMNIHDR_MEMBER(pipeline.options.nan)));

  add(Number("photometry.value_low", "8-bit code values", 0, 127,
             OMNIHDR_MEMBER(pipeline.options.value_low)));
  add(Number("photometry.value_high", "8-bit code values", 128, 255,
             OMNIHDR_MEMBER(pipeline.options.value_high)));
  add(Number("photometry.read_noise", "8-bit code values", 0, 50,
             OMNIHDR_MEMBER(pipeline.options.noise.read)));
  add(Number("photometry.gain", "code values of variance per code value", 0, 10,
             OMNIHDR_MEMBER(pipeline.options.noise.gain)));
  add(Number("photometry.prnu", "a fraction", 0, 0.2, OMNIHDR_MEMBER(pipeline.options.noise.prnu)));
  add(NumberOrZero("photometry.white_luminance", "cd/m²", "when it is not known", 1e-6, 1e9,
                   OMNIHDR_MEMBER(pipeline.options.white_luminance)));
  add(Choice("photometry.weights", std::vector{MergeWeights::kInverseVariance, MergeWeights::kHat},
             OMNIHDR_MEMBER(pipeline.options.weights)));
  add(WhiteBalance());
  add(Switch("photometry.refine_exposure", OMNIHDR_MEMBER(pipeline.options.refine_exposure)));
  add(Number("photometry.refine_limit", "a fraction", 0.01, 0.5,
             OMNIHDR_MEMBER(pipeline.options.refine_limit)));

  add(Choice("stitch.demosaic", std::vector{Demosaic::kBilinear, Demosaic::kEdgeAware},
             OMNIHDR_MEMBER(pipeline.options.demosaic)));

  add(EvenPixels("stereo.width", "", 128, 4096, OMNIHDR_MEMBER(pipeline.options.stereo_width)));
  add(Whole("stereo.labels", "a whole number", 16, 256, OMNIHDR_MEMBER(pipeline.options.labels)));
  add(Number("stereo.max_parallax_deg", "degrees", 1, 90,
             OMNIHDR_MEMBER(pipeline.options.max_parallax_deg)));
  add(Whole("stereo.neighbours", "a whole number", 1, 2,
            OMNIHDR_MEMBER(pipeline.options.neighbours)));
  add(Choice("stereo.cost",
             std::vector{StereoCost::kInterval, StereoCost::kRadiometric, StereoCost::kCensus,
                         StereoCost::kMutualInformation},
             OMNIHDR_MEMBER(pipeline.options.cost)));
  add(Choice("stereo.search", std::vector{StereoSearch::kRanges, StereoSearch::kFull},
             OMNIHDR_MEMBER(pipeline.options.search)));
  add(Choice("stereo.fusion",
             std::vector{StereoFusion::kVotes, StereoFusion::kCrossCheck, StereoFusion::kStability},
             OMNIHDR_MEMBER(pipeline.options.fusion)));
  add(Choice("stereo.filter", std::vector{StereoFilter::kNone, StereoFilter::kWavelet},
             OMNIHDR_MEMBER(pipeline.options.filter)));
  add(Choice("stereo.fill", std::vector{StereoFill::kRims, StereoFill::kSuperpixels},
             OMNIHDR_MEMBER(pipeline.options.fill)));
  add(Switch("stereo.sky", OMNIHDR_MEMBER(pipeline.options.sky)));

  add(Number("pose.min_baseline_ratio", "a ratio", 0, 0.5,
             OMNIHDR_MEMBER(pipeline.options.min_baseline_ratio)));
  add(Whole("pose.keyframes", "a whole number", 0, 1000,
            OMNIHDR_MEMBER(pipeline.options.keyframes)));
  add(Number("pose.heading_sigma_deg", "degrees", 0, 90,
             OMNIHDR_MEMBER(pipeline.options.heading_sigma_deg)));

  add(Number("merge.consistency_sigma", "decades", 0.001, 10,
             OMNIHDR_MEMBER(pipeline.options.consistency_sigma)));
  add(Whole("merge.neighbours", "a whole number", 1, 2,
            OMNIHDR_MEMBER(pipeline.options.merge_neighbours)));
  add(Choice("merge.weights", std::vector{MergeWeights::kInverseVariance, MergeWeights::kHat},
             OMNIHDR_MEMBER(pipeline.options.merge_weights)));
  add(Switch("merge.consistency", OMNIHDR_MEMBER(pipeline.options.consistency)));
  add(Switch("merge.occlusion", OMNIHDR_MEMBER(pipeline.options.occlusion)));
  add(Choice("merge.movers", std::vector{MergeMovers::kKeep, MergeMovers::kRemove},
             OMNIHDR_MEMBER(pipeline.options.movers)));
  add(Path("merge.mover_masks", "a folder or \"\"", Empty::kAllowed, kPathBytes,
           OMNIHDR_MEMBER(pipeline.options.mover_masks)));
  return keys;
}

}  // namespace

const std::vector<ConfigKey>& ConfigKeys() {
  static const std::vector<ConfigKey> keys = MakeKeys();
  return keys;
}

const ConfigKey* FindConfigKey(std::string_view name) {
  const std::vector<ConfigKey>& keys = ConfigKeys();
  const auto found = std::find_if(keys.begin(), keys.end(),
                                  [name](const ConfigKey& key) { return key.name == name; });
  return found == keys.end() ? nullptr : &*found;
}

}  // namespace omnihdr
