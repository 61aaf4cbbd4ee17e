#pragma once

#include <filesystem>
#include <memory>
#include <string_view>
#include <variant>
#include <vector>

#include "core/base/result.h"
#include "core/ports/camera.h"
#include "core/ports/camera_settings.h"
#include "drivers/iidc/iidc_camera.h"
#include "drivers/replay/replay.h"
#include "drivers/sim/sim_camera.h"
#include "drivers/v4l2/v4l2_camera.h"

namespace omnihdr {

// The options of any camera driver; which alternative it is decides which driver is made.
using CameraOptions = std::variant<sim::SimCameraOptions, ReplayOptions, iidc::IidcCameraOptions,
                                   v4l2::V4l2CameraOptions>;

struct CameraDriverEntry {
  std::string_view name;     // as in configuration files
  std::string_view summary;  // one line for people
};

// Every camera driver of this build, in the order of CameraOptions.
const std::vector<CameraDriverEntry>& CameraDrivers();

// Options of a driver with their defaults; kConfig error listing the known names.
Result<CameraOptions> DefaultCameraOptions(std::string_view driver);

// A camera, not yet open. kConfig when the options are out of range. (A ReplayTrigger shares the
// camera it belongs to: keep it as shared_ptr and use std::dynamic_pointer_cast<const
// ReplayCamera>.)
Result<std::unique_ptr<Camera>> MakeCamera(const CameraOptions& options);

// The settings of the camera, or of each camera of a rig, to be read and set by hand while nobody
// uses it. kUsage for drivers whose cameras have none.
Result<std::vector<std::unique_ptr<CameraSettings>>> OpenCameraSettings(
    const CameraOptions& options);

// Makes the options' camera write all that passes between it and this machine into `file`
// (drivers/usb/recording.h, drivers/firewire/recording.h; drivers/v4l2/recording.h, a file for each
// camera of a rig). kUsage for cameras that cannot.
Status RecordTransport(CameraOptions& options, const std::filesystem::path& file);
// A camera that such a recording plays, not yet open: asked the same, it answers the same. kData
// when the file is none.
Result<std::unique_ptr<Camera>> MakeReplayedCamera(const CameraOptions& options,
                                                   const std::filesystem::path& file);

}  // namespace omnihdr
