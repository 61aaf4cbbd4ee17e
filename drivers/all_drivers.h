#pragma once

#include <memory>
#include <string_view>
#include <variant>
#include <vector>

#include "core/base/result.h"
#include "core/ports/camera.h"
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

}  // namespace omnihdr
