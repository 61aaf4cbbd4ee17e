#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/ports/camera.h"
#include "core/sphere/rig.h"
#include "drivers/v4l2/controls.h"
#include "drivers/v4l2/device.h"
#include "drivers/v4l2/exposure_control.h"
#include "drivers/v4l2/latency.h"
#include "drivers/v4l2/pixel_format.h"
#include "drivers/v4l2/stream.h"

namespace omnihdr::v4l2 {

struct V4l2CameraOptions {
  // Which camera: the path of its node, its name in /dev/v4l/by-id or by-path (with or without the
  // folder), or the serial number of its USB device; empty = the only one there.
  std::string device;
  // Several cameras as one rig: one for each sensor of the rig file, in its order, each named as
  // above (drivers/v4l2/rig_camera.h). Empty = `device` alone.
  std::vector<std::string> devices;
  // Layout rig: which of the rig file's sensors it is; -1 = it is all of them, stacked.
  int sensor = -1;
  std::string controls_device;  // node that has the sensor's controls; empty = the camera's own
  Layout layout = Layout::kRig;
  std::string rig_file;  // layout rig: its sensors' sizes decide the picture's
  Coding coding = Coding::kAuto;
  int width = 0;  // other layouts; 0 = as the device has it
  int height = 0;
  double frame_rate = 0.0;  // 1/s; 0 = as the device has it
  int latency_frames = 0;   // from a write to the first frame it acts on; 0 = measured
  int gain = -1;            // control value held; -1 = the control's default
  int gain_unity = 0;       // control value of 0 dB; 0 = the gain is not used
  int white_balance = 0;    // kelvin; 0 = as the camera has it
  // File for all that passes between driver and kernel (drivers/v4l2/recording.h); empty = none.
  std::string recording;
  double frame_timeout_s = 2.0;  // from when the picture could be there, 0.01 to 600
  Status Validate() const;       // kConfig error naming the option and its range
};

// A camera that has been found and configured: everything automatic off and read back.
struct ReadyCamera {
  std::string node;  // its path
  // In this order: what is below uses what is above.
  std::unique_ptr<V4l2Device> device;
  std::unique_ptr<V4l2Device> controls_device;  // null = the same
  std::unique_ptr<Stream> stream;
  std::optional<ExposureControl> exposure;
  FrameLayout frame;
  // The driver's time stamps of a start are those of the first data, after the first row's
  // exposure.
  bool stamps_at_readout = false;
  Nanoseconds interval{0};  // between frames; 0 = not known
  int latency_frames = kMaxLatency;
  int least_latency = 1;  // a setting acts no sooner than so many frames after it was written
  bool latency_measured = false;
  std::string latency_note;  // why it was not
  CameraInfo info;
};

inline constexpr std::size_t kMaxDevices = 16;
// Whether `devices` goes together with the other options.
Status CheckDevices(const V4l2CameraOptions& options);

// Finds the camera, makes it ready and measures its latency. kUnavailable: no such camera (the
// message names what is there); kConfig: the camera cannot do what is asked of it.
Result<std::unique_ptr<ReadyCamera>> OpenAndSetUp(V4l2System& system,
                                                  const V4l2CameraOptions& options,
                                                  const Clock& clock);

// Measures the latency of a camera whose stream runs, and notes it; kMaxLatency when it cannot be.
Status NoteLatency(ReadyCamera& camera, const V4l2CameraOptions& options, const Clock& clock);

// The longest that the next frame may take.
Nanoseconds LongestWait(const ReadyCamera& camera, const V4l2CameraOptions& options);

}  // namespace omnihdr::v4l2
