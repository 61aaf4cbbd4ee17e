#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/ports/camera.h"
#include "core/ports/camera_release.h"
#include "core/sphere/rig.h"
#include "drivers/iidc/config_rom.h"
#include "drivers/iidc/features.h"
#include "drivers/iidc/format7.h"
#include "drivers/iidc/model_table.h"
#include "drivers/iidc/picture.h"
#include "drivers/iidc/register_bus.h"

namespace omnihdr::iidc {

// What the camera is plugged into.
enum class CameraBus { kUsb, kFirewire };
std::string_view ToString(CameraBus bus);

// Whether the camera's own exposure cycle is used: for models of which the table knows that it
// works, never, or for any camera that has one.
enum class CycleUse { kAuto, kOff, kOn };

struct IidcCameraOptions {
  CameraBus bus = CameraBus::kUsb;
  // Which camera: its GUID (16 hexadecimal digits) or its serial number (decimal); empty = the only
  // one there.
  std::string id;
  std::string rig_file;  // the head's calibration; its sensors' sizes decide the picture's
  PictureFormat format = PictureFormat::kRaw;
  int jpeg_quality = 90;  // 1 to 100, fixed: the noise of a bracket's pictures stays alike
  int mode = 0;           // Format7 mode, 0 to 7 (a Ladybug's JPEGs: 7)
  Coding coding = Coding::kRaw8;
  int left = 0;  // of the picture on the sensor, even
  int top = 0;
  int packet_bytes = 0;  // 0 = as the camera recommends
  int trigger_mode = 0;  // 0, 14 or 15
  // The camera exposes by itself at pulses on its input (trigger mode 0 or 14): see IidcCamera.
  bool wired = false;
  // The wire that this side pulses to make the camera expose, at the same input and in the same
  // modes; null = it is triggered by software. Not with `wired`.
  std::shared_ptr<CameraRelease> release;
  int trigger_input = 0;  // 0 to 3
  bool trigger_active_low = false;
  // Pictures thrown away after every change of exposure; -1 = as the model table says.
  int settle_frames = -1;
  CycleUse exposure_cycle = CycleUse::kAuto;
  int white_balance_blue = -1;  // -1 = as the camera has it
  int white_balance_red = -1;
  // Where the traffic with the camera is recorded (drivers/usb/recording.h, and for FireWire
  // drivers/firewire/recording.h); empty = nowhere.
  std::string usb_recording;
  double frame_timeout_s = 2.0;  // from the end of the exposure, 0.01 to 600
  Status Validate() const;       // kConfig error naming the option and its range
};

// A camera that has been found and configured: everything automatic off and read back.
struct ReadyCamera {
  std::unique_ptr<Link> link;
  std::optional<Registers> registers;
  ConfigRom rom;
  std::uint32_t serial = 0;
  std::optional<CameraModel> model;
  std::optional<Feature> shutter;
  std::optional<Feature> gain;
  AbsoluteRange shutter_range;
  std::optional<AbsoluteRange> gain_range;
  bool cycle = false;   // its own exposure cycle may be used
  bool series = false;  // it has trigger mode 15
  Format7Setup format;
  PictureLayout picture;
  Rig rig;
  // Whether SOFTWARE_TRIGGER tells when the next trigger is taken, of whatever source.
  bool tells_ready = true;
  CameraInfo info;
};

// Finds the camera and makes it ready. kUnavailable: no such camera (the message names what is
// there); kConfig: the camera cannot do what is asked of it.
Result<ReadyCamera> OpenAndSetUp(LinkFinder& finder, const IidcCameraOptions& options,
                                 const RegisterTimeouts& timeouts);

// Order of the colours that BAYER_TILE_MAPPING (0x1040) spells; kNone for a monochrome sensor,
// nothing for anything else.
std::optional<BayerOrder> ParseTileMapping(std::uint32_t quadlet);

}  // namespace omnihdr::iidc
