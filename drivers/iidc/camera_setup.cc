#include "drivers/iidc/camera_setup.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <nlohmann/json.hpp>
#include <utility>

#include "core/photometry/mosaic.h"
#include "core/session/rig_file.h"
#include "core/session/session_rig.h"
#include "drivers/iidc/exposure_cycle.h"
#include "drivers/iidc/find_camera.h"
#include "drivers/iidc/frame_info.h"
#include "drivers/iidc/registers.h"
#include "drivers/iidc/trigger_mode.h"
#include "drivers/ladybug/raw_stack.h"

namespace omnihdr::iidc {
namespace {

using Json = nlohmann::json;

constexpr std::uint32_t kTileMapping = 0x1040;

Status Reset(const Registers& registers) {
  OMNIHDR_ASSIGN(const std::uint32_t basic, registers.Read(kBasicInquiry, "BASIC_FUNC_INQ"));
  if ((basic & Bit(15)) != 0) {
    OMNIHDR_TRY(registers.WriteChecked(kCameraPower, Bit(31), Bit(31), "CAMERA_POWER"));
  }
  // Left streaming by whoever was here before.
  OMNIHDR_TRY(registers.WriteChecked(kIsoEnable, 0, Bit(31), "ISO_EN"));
  // What somebody set in registers we do not know is gone after this.
  OMNIHDR_TRY(registers.Write(kInitialize, Bit(31), "INITIALIZE"));
  OMNIHDR_TRY(registers.WaitFor(kInitialize, Bit(31), 0, "INITIALIZE"));
  // Steps exposures by itself; not every camera has it.
  const Result<std::uint32_t> hdr = registers.Read(kHdrControl, "HDR_CONTROL");
  if (hdr && (*hdr & (Bit(31) | Bit(25))) == (Bit(31) | Bit(25))) {
    OMNIHDR_TRY(SwitchExposureCycleOff(registers));
  }
  return {};
}

Status CheckColours(const Registers& registers, const Rig& rig) {
  const BayerOrder expected = rig.sensors.front().bayer;
  const Result<std::uint32_t> quadlet = registers.Read(kTileMapping, "BAYER_TILE_MAPPING");
  if (!quadlet) return {};  // a camera without the register cannot be asked
  const std::optional<BayerOrder> order = ParseTileMapping(*quadlet);
  if (!order || *order == expected) return {};
  return Fail(ErrorKind::kConfig,
              "BAYER_TILE_MAPPING (0x1040): {:#010x}: the camera's colours are {}, the rig file "
              "says {}",
              *quadlet, ToString(*order), ToString(expected));
}

// The quality stays as it is set: one that follows the scene would differ within a bracket.
Status SetUpCompression(const Registers& registers, int quality) {
  OMNIHDR_ASSIGN(const std::uint32_t before, registers.Read(kJpegControl, "JPEG_CTRL"));
  if ((before & Bit(31)) == 0) {
    return Fail(ErrorKind::kConfig, "JPEG_CTRL (0x1e80): {:#010x}: the camera does not compress",
                before);
  }
  const auto wanted = static_cast<std::uint32_t>(quality);
  OMNIHDR_TRY(registers.WriteChecked(kJpegControl, Bit(31) | Bit(25) | wanted, Bit(24) | 0xFF,
                                     "JPEG_CTRL"));
  return {};
}

Status CheckCompressible(const Rig& rig, const std::string& name) {
  bool alike = rig.sensors.size() == ladybug::kSensors;
  for (const RigSensor& sensor : rig.sensors) {
    alike = alike && sensor.bayer == BayerOrder::kBggr &&
            sensor.lens.height() == rig.sensors.front().lens.height();
  }
  if (alike) return {};
  return Fail(ErrorKind::kConfig,
              "{}: {} sensors: expected {} of one size and BGGR with camera.iidc.format = \"jpeg\"",
              name, rig.sensors.size(), ladybug::kSensors);
}

// Whether the camera's own exposure cycle may be used. Where the configuration asks for it, what is
// missing is an error.
Result<bool> MayCycle(const ReadyCamera& camera, const IidcCameraOptions& options) {
  const CycleKnowledge known = camera.model ? camera.model->cycle : CycleKnowledge::kUnmeasured;
  const bool asked = options.exposure_cycle == CycleUse::kOn;
  if (!asked && (options.exposure_cycle == CycleUse::kOff || known != CycleKnowledge::kWorks)) {
    return false;
  }
  const auto refuse = [&](std::string why) -> Result<bool> {
    if (!asked) return false;
    return Fail(ErrorKind::kConfig, "exposure_cycle: \"on\": {}", why);
  };
  if (known == CycleKnowledge::kNone) {
    return refuse(fmt::format("the {} has no exposure cycle", camera.model->name));
  }
  if (options.format != PictureFormat::kRaw) {
    return refuse("expected \"auto\" or \"off\" with format = \"jpeg\"");
  }
  Result<bool> has = HasExposureCycle(*camera.registers);
  if (!has && has.error().kind != ErrorKind::kProtocol) return has;
  if (!has || !*has) return refuse("HDR_CONTROL (0x1800): the camera has no exposure cycle");
  const std::uint32_t needed =
      kEmbeddedShutter | (camera.gain_range ? kEmbeddedGain : std::uint32_t{0});
  if ((camera.picture.embedded & needed) != needed) {
    return refuse(
        fmt::format("FRAME_INFO (0x12f8): {:#05x}: expected a camera that writes shutter and gain "
                    "into its frames: nothing else tells which step of the cycle one had",
                    camera.picture.embedded));
  }
  return true;
}

// Stacked picture of a rig whose sensors are alike in width and colours.
struct Stack {
  int width = 0;
  int height = 0;
};
Result<Stack> StackOf(const Rig& rig, const std::string& name) {
  OMNIHDR_ASSIGN(const std::vector<int> rows, StackedRows(rig).Context(name));
  for (const RigSensor& sensor : rig.sensors) {
    if (sensor.bayer != rig.sensors.front().bayer) {
      return Fail(ErrorKind::kConfig,
                  "{}: sensor \"{}\": bayer: \"{}\", expected \"{}\" as the "
                  "first sensor's",
                  name, sensor.name, ToString(sensor.bayer), ToString(rig.sensors.front().bayer));
    }
  }
  return Stack{rig.sensors.front().lens.width(), rows.back()};
}

std::string ExtraJson(const ReadyCamera& camera, const std::vector<SettledFeature>& settled,
                      const IidcCameraOptions& options) {
  Json features = Json::object();
  for (const SettledFeature& feature : settled) {
    features[feature.name] = fmt::format("{:#010x}", feature.quadlet);
  }
  const Json iidc = {{"guid", FormatGuid(camera.rom.guid)},
                     {"vendor", camera.rom.vendor},
                     {"link", camera.link->name()},
                     {"format", ToString(options.format)},
                     {"mode", options.mode},
                     {"coding", ToString(options.coding)},
                     {"depth", camera.format.depth},
                     {"packet_bytes", camera.format.packet_bytes},
                     {"frame_bytes", camera.format.frame_bytes},
                     {"trigger_mode", options.trigger_mode},
                     {"exposure_cycle", camera.cycle},
                     {"embedded", fmt::format("{:#05x}", camera.picture.embedded)},
                     {"features", features}};
  return Json{{"iidc", iidc}}.dump();
}

Status CheckOption(const char* name, int value, int low, int high) {
  if (value >= low && value <= high) return {};
  return Fail(ErrorKind::kConfig, "{}: {}: expected {} to {}", name, value, low, high);
}

}  // namespace

std::optional<BayerOrder> ParseTileMapping(std::uint32_t quadlet) {
  std::string letters;
  for (int shift = 24; shift >= 0; shift -= 8) {
    letters += static_cast<char>(quadlet >> shift & 0xFF);
  }
  if (letters == "YYYY") return BayerOrder::kNone;
  const std::optional<BayerOrder> order = BayerOrderFromString(letters);
  if (!order || *order == BayerOrder::kNone) return std::nullopt;
  return order;
}

std::string_view ToString(CameraBus bus) { return bus == CameraBus::kUsb ? "usb" : "firewire"; }

Status IidcCameraOptions::Validate() const {
  const bool guid =
      id.size() == 16 && std::all_of(id.begin(), id.end(), [](char c) {
        return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f') || (c >= 'A' && c <= 'F');
      });
  std::uint32_t serial = 0;
  const auto read = std::from_chars(id.data(), id.data() + id.size(), serial);
  const bool number = read.ec == std::errc{} && read.ptr == id.data() + id.size();
  if (!id.empty() && !guid && !number) {
    return Fail(ErrorKind::kConfig,
                "id: \"{}\": expected a GUID of 16 hexadecimal digits, a serial number, or nothing",
                id);
  }
  if (rig_file.empty()) {
    return Fail(ErrorKind::kConfig, "rig: empty: expected the rig file of the camera's head");
  }
  OMNIHDR_TRY(CheckOption("mode", mode, 0, 7));
  OMNIHDR_TRY(CheckOption("jpeg_quality", jpeg_quality, 1, 100));
  OMNIHDR_TRY(CheckOption("left", left, 0, 65534));
  OMNIHDR_TRY(CheckOption("top", top, 0, 65534));
  if (left % 2 != 0 || top % 2 != 0) {
    return Fail(ErrorKind::kConfig, "left, top: {}, {}: expected even numbers", left, top);
  }
  OMNIHDR_TRY(CheckOption("packet_bytes", packet_bytes, 0, 65535));
  if (trigger_mode != 0 && trigger_mode != 14 && trigger_mode != 15) {
    return Fail(ErrorKind::kConfig, "trigger_mode: {}: expected 0, 14 or 15", trigger_mode);
  }
  OMNIHDR_TRY(CheckOption("trigger_input", trigger_input, 0, 3));
  if ((wired || release) && trigger_mode == 15) {
    return Fail(ErrorKind::kConfig, "trigger_mode: 15: expected 0 or 14 for a wired camera");
  }
  if (wired && release) {
    return Fail(ErrorKind::kConfig,
                "wired: expected either a wire that is observed or one that is pulsed");
  }
  OMNIHDR_TRY(CheckOption("settle_frames", settle_frames, -1, 8));
  OMNIHDR_TRY(CheckOption("white_balance_blue", white_balance_blue, -1, 4095));
  OMNIHDR_TRY(CheckOption("white_balance_red", white_balance_red, -1, 4095));
  if (!(frame_timeout_s >= 0.01 && frame_timeout_s <= 600.0)) {
    return Fail(ErrorKind::kConfig, "frame_timeout_s: {}: expected 0.01 to 600", frame_timeout_s);
  }
  return {};
}

Result<ReadyCamera> OpenAndSetUp(LinkFinder& finder, const IidcCameraOptions& options,
                                 const RegisterTimeouts& timeouts) {
  OMNIHDR_TRY(options.Validate());
  ReadyCamera camera;
  OMNIHDR_ASSIGN(camera.info.files, ReadRigFilesOf(options.rig_file));
  OMNIHDR_ASSIGN(camera.rig, ParseRig(camera.info.files.front().content, options.rig_file));
  OMNIHDR_ASSIGN(const Stack stack, StackOf(camera.rig, options.rig_file));

  OMNIHDR_ASSIGN(FoundCamera found, FindCamera(finder, options.id, timeouts));
  camera.link = std::move(found.link);
  camera.rom = std::move(found.rom);
  camera.serial = found.serial;
  camera.model = FindModel(camera.link->product());
  const Registers& registers =
      camera.registers.emplace(*camera.link, camera.rom.command_base, timeouts);

  OMNIHDR_TRY(Reset(registers));
  Format7Request request;
  request.mode = options.mode;
  const bool compressed = options.format == PictureFormat::kJpeg;
  if (compressed) {
    // The picture is a buffer for the compressed data: as large as it can be.
    OMNIHDR_TRY(CheckCompressible(camera.rig, options.rig_file));
    OMNIHDR_TRY(SetUpCompression(registers, options.jpeg_quality));
    request.coding = Coding::kMono8;
  } else {
    request.left = options.left;
    request.top = options.top;
    request.width = stack.width;
    request.height = stack.height;
    request.coding = options.coding;
  }
  const bool deep = IsDeep(request.coding);
  if (deep &&
      (camera.rig.sensors.size() == ladybug::kSensors || (camera.model && !camera.model->deep))) {
    return Fail(ErrorKind::kConfig,
                "coding: \"{}\": expected 8 bits: how a head of six sensors sends 16 is not known",
                ToString(request.coding));
  }
  request.packet_bytes = static_cast<std::uint32_t>(options.packet_bytes);
  request.link_packet_bytes = camera.link->packet_bytes();
  OMNIHDR_ASSIGN(camera.format, SetUpFormat7(registers, request).Context("Format7"));
  OMNIHDR_TRY(CheckColours(registers, camera.rig));

  FixedSettings fixed;
  if (options.white_balance_blue >= 0) fixed.white_balance_blue = options.white_balance_blue;
  if (options.white_balance_red >= 0) fixed.white_balance_red = options.white_balance_red;
  OMNIHDR_ASSIGN(std::vector<SettledFeature> settled, SettleFeatures(registers, fixed));

  OMNIHDR_ASSIGN(camera.shutter, Feature::Open(registers, kShutter, "SHUTTER"));
  OMNIHDR_TRY(camera.shutter->SetManual());
  OMNIHDR_ASSIGN(camera.shutter_range, camera.shutter->ReadRange());
  if (!(camera.shutter_range.minimum > 0.0 &&
        camera.shutter_range.minimum < camera.shutter_range.maximum)) {
    return Fail(ErrorKind::kProtocol, "SHUTTER: range {} to {} s: expected a range above 0",
                camera.shutter_range.minimum, camera.shutter_range.maximum);
  }
  OMNIHDR_ASSIGN(camera.gain, Feature::Open(registers, kGain, "GAIN"));
  if (camera.gain->inquiry().present) {
    OMNIHDR_TRY(camera.gain->SetManual());
    OMNIHDR_ASSIGN(camera.gain_range, camera.gain->ReadRange());
  }
  camera.picture.format = options.format;
  camera.picture.sensors = static_cast<int>(camera.rig.sensors.size());
  camera.picture.width = stack.width;
  camera.picture.height = stack.height;
  camera.picture.deep = deep;
  camera.picture.depth = camera.format.depth;
  if (compressed) {
    OMNIHDR_TRY(DisableEmbeddedInfo(registers));
  } else {
    OMNIHDR_ASSIGN(camera.picture.embedded, EnableEmbeddedInfo(registers));
  }
  OMNIHDR_ASSIGN(camera.cycle, MayCycle(camera, options));
  if (camera.cycle && !options.release) {
    OMNIHDR_ASSIGN(const TriggerInquiry inquiry, InquireTrigger(registers));
    camera.series = (inquiry.modes & Bit(kSeriesMode)) != 0;
  }
  if (options.release) {
    OMNIHDR_TRY(SetUpWiredTrigger(registers, options.trigger_mode, options.trigger_input,
                                  options.trigger_active_low));
    OMNIHDR_ASSIGN(const TriggerInquiry inquiry, InquireTrigger(registers));
    camera.tells_ready = inquiry.software;
  } else {
    OMNIHDR_TRY(SetUpSoftwareTrigger(registers, options.trigger_mode));
  }

  CameraInfo& info = camera.info;
  info.description.model = !camera.rom.model.empty() ? camera.rom.model
                           : camera.model            ? std::string(camera.model->name)
                                                     : std::string("IIDC camera");
  info.description.serial = fmt::format("{}", camera.serial);
  info.description.bits = deep ? 16 : 8;
  info.description.layout = Layout::kRig;
  info.description.width = stack.width;
  info.description.height = stack.height;
  info.description.bayer = ToString(camera.rig.sensors.front().bayer);
  info.shortest = ExposureTime::Seconds(camera.shutter_range.minimum);
  info.longest = ExposureTime::Seconds(camera.shutter_range.maximum);
  info.proof = compressed || (camera.picture.embedded & kEmbeddedShutter) != 0
                   ? ExposureProof::kEmbedded
                   : ExposureProof::kReadback;
  info.wired = options.wired;
  if (options.release) info.min_trigger_interval = options.release->spacing();
  constexpr std::uint32_t kNeeded = kEmbeddedShutter | kEmbeddedCycleTime;
  if (options.wired && !compressed && (camera.picture.embedded & kNeeded) != kNeeded) {
    return Fail(
        ErrorKind::kConfig,
        "trigger.wired: FRAME_INFO (0x12f8): {:#05x}: expected a camera that writes shutter "
        "and cycle time into its frames: nothing else tells what a pulse made of them",
        camera.picture.embedded);
  }
  info.extra_json = ExtraJson(camera, settled, options);
  return camera;
}

}  // namespace omnihdr::iidc
