#pragma once

#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/result.h"
#include "core/base/units.h"
#include "core/capture/storage_guard.h"
#include "core/pipeline/options.h"
#include "core/pipeline/quality.h"
#include "core/session/journal.h"
#include "core/session/session.h"
#include "drivers/gnss/gpsd_client.h"
#include "drivers/gpio/camera_trigger.h"
#include "drivers/gpio/inputs.h"
#include "drivers/gpio/outputs.h"
#include "drivers/modbus/server.h"
#include "drivers/modbus/vehicle.h"
#include "drivers/v4l2/camera_setup.h"

namespace omnihdr {

// The configuration of the daemon and of the command line tool. One member per TOML key, in
// sections of the same name; config/omnihdr.toml documents every key with its default, unit and
// range. Paths are absolute or relative to the working directory once loaded: a relative path in a
// file is taken from that file's directory.

inline constexpr std::string_view kDefaultConfigFile = "/etc/omnihdr/omnihdr.toml";

enum class OnExistingSession { kResume, kRefuse };
enum class CameraDriver { kSim, kReplay, kIidc, kV4l2 };
enum class SimScene { kHall, kYard, kTunnel, kStreet };
enum class SimLayout { kPanorama, kRig };
enum class IidcFormat { kRaw, kJpeg };
enum class IidcBus { kUsb, kFirewire };
enum class IidcCoding { kRaw8, kMono8, kRaw16, kMono16 };
enum class IidcCycle { kAuto, kOff, kOn };
enum class TriggerKind { kSoftware, kTimer, kDistance, kGpio, kReplay };
enum class OdometerKind { kSim, kWheel, kModbus };
enum class Metering { kOff, kReport, kAdopt };
enum class LogLevel { kDebug, kInfo, kWarning, kError };
// What is deleted by itself.
enum class Retention {
  kNothing,
  kViews,     // of sessions that have ended: `omnihdr process` can make them again
  kSessions,  // that have ended, as a whole
};

std::string_view ToString(OnExistingSession value);
std::string_view ToString(CameraDriver value);
std::string_view ToString(SimScene value);
std::string_view ToString(SimLayout value);
std::string_view ToString(IidcFormat value);
std::string_view ToString(IidcBus value);
std::string_view ToString(Metering value);
std::string_view ToString(IidcCoding value);
std::string_view ToString(IidcCycle value);
std::string_view ToString(TriggerKind value);
std::string_view ToString(OdometerKind value);
std::string_view ToString(LogLevel value);
std::string_view ToString(Retention value);

// When a session ends and the next directory goes on. 0 = that limit is off.
struct RotationLimits {
  double gb = 0.0;  // of pixel files, 10^9 bytes
  int positions = 0;
  double hours = 0.0;  // since the session was begun or continued
};

// [session], with rotate_gb, rotate_positions and rotate_hours in `rotation`
struct SessionConfig {
  std::string directory = "/var/lib/omnihdr/sessions";  // session directories are made in here
  std::string name;                                     // empty = UTC time stamp of the start
  OnExistingSession on_existing = OnExistingSession::kResume;
  RotationLimits rotation;
};

// [camera.sim]
struct SimCameraConfig {
  SimScene scene = SimScene::kHall;
  std::uint64_t seed = 1;
  SimLayout layout = SimLayout::kPanorama;
  int width = 1536;  // of the panorama; its height follows from the projection
  ProjectionKind projection = ProjectionKind::kEquirectangular;
  std::string rig;                     // layout rig: a rig file; empty = the nominal Ladybug2
  int sensor_width = 0;                // columns of a sensor; 0 = as the rig says
  double photons_full_well = 20000.0;  // electrons at value 255: shot noise
  double read_noise = 0.5;             // code values rms
  double speed_m_s = 1.0;              // along the scene's path, whose curvature the scene decides
  double yaw_deg_per_m = 5.0;          // turning of the camera against the direction of travel
  double sway_deg = 1.0;               // amplitude of the slow pitching and rolling
  int movers = 0;                      // people who walk about near the start of the drive
  double mover_speed_m_s = 1.4;        // of each
  double latency_s = 0.0;              // trigger to frame
  double lost_frame_probability = 0.0;
  double corrupt_frame_probability = 0.0;
  double exposure_error_probability = 0.0;
  double vanish_probability = 0.0;
  double away_s = 1.0;
  double max_distance_m = 0.0;  // the vehicle stops there; 0 = never
};

// [camera.replay]
struct ReplayCameraConfig {
  std::string session;  // directory; required when camera.driver = "replay"
};

// [camera.iidc]
struct IidcCameraConfig {
  std::string id;  // GUID or serial number; empty = the only camera there
  IidcBus bus = IidcBus::kUsb;
  std::string rig;  // rig file; required when camera.driver = "iidc"
  IidcFormat format = IidcFormat::kRaw;
  int jpeg_quality = 90;
  int mode = 0;  // Format7 mode
  IidcCoding coding = IidcCoding::kRaw8;
  int left = 0;  // of the picture on the sensor
  int top = 0;
  int packet_bytes = 0;   // 0 = as the camera recommends
  int trigger_mode = 0;   // 0, 14 or 15
  int trigger_input = 0;  // of a wired camera, 0 to 3
  bool trigger_active_low = false;
  int settle_frames = -1;  // thrown away after a change of exposure; -1 = as the model needs
  IidcCycle exposure_cycle = IidcCycle::kAuto;
  int white_balance_blue = -1;  // register values; -1 = as the camera has them
  int white_balance_red = -1;
  std::string usb_recording;  // file for the traffic with the camera; empty = none
};

// [camera]
struct CameraConfig {
  CameraDriver driver = CameraDriver::kSim;
  double frame_timeout_s = 2.0;      // command to frame; then the trigger counts as camera-timeout
  double exposure_tolerance = 0.02;  // relative difference of commanded and proved exposure
  double reconnect_s = 2.0;          // between attempts to open a camera that has gone
  bool check_orientation = true;     // of a head of several sensors, by its first frames
  SimCameraConfig sim;
  ReplayCameraConfig replay;
  IidcCameraConfig iidc;
  v4l2::V4l2CameraOptions v4l2;  // frame_timeout_s: as above
};

// [bracket]: exposures either listed (exposures_s) or as start_s · 2^(i·step_stops), i < count. The
// form that a later file gives replaces the other one.
struct BracketConfig {
  BracketOrder order = BracketOrder::kSawtooth;
  std::vector<double> exposures_s = {0.001, 0.004, 0.016};
  double start_s = 0.0;  // 0 = exposures_s is in force
  double step_stops = 1.6;
  int count = 3;
  double gain_db = 0.0;
  int frames_per_position = 1;
  int flicker_hz = 0;        // mains that lamps flicker by: 50, 60, or 0 = none
  double max_blur_px = 0.0;  // of what is near_m away at speed_m_s; 0 = any
  double speed_m_s = 0.0;
  double near_m = 5.0;
  int retake = 1;                   // how often a step that was not proved is taken again
  Metering meter = Metering::kOff;  // a first look at the scene when armed
  double meter_longest_s = 0.25;    // longest exposure of that
  // The exposures in force, in the order configured. Never empty in a loaded configuration.
  std::vector<ExposureTime> Exposures() const;
};

// [trigger]
struct TriggerConfig {
  TriggerKind source = TriggerKind::kSoftware;
  double interval_s = 1.0;                     // timer
  double distance_m = 0.3;                     // distance
  OdometerKind odometer = OdometerKind::kSim;  // whose metres are journaled and whose marks trigger
  std::uint64_t limit = 0;                     // triggers after which the source disarms; 0 = none
  bool armed_at_start = false;
  bool burst = false;  // a whole bracket at each trigger, at one position
  bool wired =
      false;  // the camera hangs on the same wire: edges are observed, nothing is commanded
  double busy_wait_s = 0.05;  // of a trigger for a camera that is busy with the picture before
  int rearm_after = 8;  // triggers without a frame after which the camera is opened anew; 0 = never
};

// [gpio.trigger] and [gpio.wheel] in `inputs`, [gpio.outputs]
struct GpioConfig {
  gpio::InputsOptions inputs;
  gpio::OutputsOptions outputs;
  gpio::CameraTriggerOptions camera_trigger;  // on the chip of the outputs
  // camera_trigger with its chip.
  gpio::CameraTriggerOptions CameraTrigger() const {
    gpio::CameraTriggerOptions options = camera_trigger;
    options.name.chip = outputs.chip;
    return options;
  }
};

// [modbus.client] in `client`, [modbus.server] in `server` and `control`
struct ModbusConfig {
  ModbusConfig() {
    client.endpoint.connection = modbus::Connection::kOff;
    server.endpoint.connection = modbus::Connection::kOff;
    server.endpoint.port = 1502;
  }
  modbus::VehicleOptions client;
  modbus::ServerOptions server;
  bool control = false;  // whether masters may command
};

// [gnss]
struct GnssConfig {
  bool enabled = false;
  gnss::GpsdOptions gpsd;
};

// [recorder]
struct RecorderConfig {
  int queue_frames = 8;
  int png_compression = 1;
  Durability durability = Durability::kFrame;
  double sync_interval_s = 1.0;  // durability "interval"
};

// [storage], with retention, retention_days and retention_gb in `retention`
struct RetentionOptions {
  Retention deletes = Retention::kNothing;
  double days = 0.0;  // what ended longer ago is deleted; 0 = no such limit
  double gb = 0.0;    // what may be deleted takes no more than this, 10^9 bytes; 0 = no such limit
  bool on() const { return deletes != Retention::kNothing && (days > 0.0 || gb > 0.0); }
};
struct StorageConfig {
  bool allow_root = false;
  StorageLimits limits;
  RetentionOptions retention;
};

// [api]
struct ApiConfig {
  std::string socket = "/run/omnihdr/api.sock";
  unsigned socket_mode = 0660;
  std::string socket_group;  // empty = the daemon's own
  std::string tcp;           // "ADDRESS:PORT" or "[ADDRESS]:PORT"; empty = no TCP
  bool tcp_remote = false;   // whether tcp may be another address than a loopback one
  std::string token_file;    // empty = the service manager's credential
};

// A numeric address and a port, from "127.0.0.1:8787" or "[::1]:8787".
struct TcpEndpoint {
  std::string address;
  int port = 0;
  bool loopback() const;
};
std::optional<TcpEndpoint> ParseTcpEndpoint(std::string_view text);

// [log]
struct LogConfig {
  LogLevel level = LogLevel::kInfo;
};

// [pipeline], and in `options`: [input] [output] [photometry] [stereo] [pose] [merge]
struct PipelineConfig {
  bool enabled = true;
  int workers = 0;  // 0 = as many as there are processors
  OverloadOptions overload;
  PipelineOptions options;
};

struct DaemonConfig {
  SessionConfig session;
  CameraConfig camera;
  BracketConfig bracket;
  TriggerConfig trigger;
  GpioConfig gpio;
  ModbusConfig modbus;
  GnssConfig gnss;
  RecorderConfig recorder;
  StorageConfig storage;
  ApiConfig api;
  LogConfig log;
  PipelineConfig pipeline;

  // What is simulated or played back is no survey: it may lie anywhere.
  bool MayLieOnRoot() const {
    return storage.allow_root || camera.driver == CameraDriver::kSim ||
           camera.driver == CameraDriver::kReplay;
  }
};

// One thing that is wrong, as "file:line: key: value, expected ...".
struct ConfigProblem {
  std::string file;
  int line = 0;     // 0 = the file as a whole
  std::string key;  // empty when the file is not readable or not TOML
  std::string message;
  std::string ToString() const;
};

// Where a key's value comes from.
struct ConfigSource {
  std::string file;  // empty = built-in default
  int line = 0;
};

struct LoadedConfig {
  DaemonConfig config;
  std::vector<std::string> files;  // those read, in order
  std::map<std::string, ConfigSource>
      sources;                          // by key; a key that is missing here has its default
  std::vector<ConfigProblem> problems;  // all that were found; empty = the config is usable
  bool ok() const { return problems.empty(); }
};

// Reads `file` and then omnihdr.d/*.toml beside it in lexical order, each overriding key by key
// what came before. Reports every problem found, not just the first; what is wrong keeps the value
// from before. With `must_exist` false a missing `file` means defaults.
LoadedConfig LoadConfig(const std::filesystem::path& file, bool must_exist = true);
// One TOML text as if it were the only file. `name` stands in messages; relative paths are taken
// from its directory.
LoadedConfig ParseConfig(std::string_view toml, const std::string& name);
// The configuration, or one kConfig error (exit code 78) with all problems, a line each.
Result<DaemonConfig> ConfigOrError(LoadedConfig loaded);

// The names of all keys ("camera.sim.width"), in the order of config/omnihdr.toml.
std::vector<std::string> ConfigKeyNames();
// The value of one key as TOML text ("1536", "\"hall\"", "[0.001, 0.004]").
Result<std::string> ConfigValueToToml(const DaemonConfig& config, std::string_view key);

// Every effective value and where it came from: TOML with comments, or one JSON object
// {"files": [...], "values": {key: {"value": ..., "source": "default" | "file:line"}}}.
std::string FormatConfig(const LoadedConfig& loaded);
std::string FormatConfigJson(const LoadedConfig& loaded);

}  // namespace omnihdr
