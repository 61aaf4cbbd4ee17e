#pragma once

#include <memory>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/ports/camera_settings.h"
#include "drivers/v4l2/camera_setup.h"
#include "drivers/v4l2/device.h"

namespace omnihdr::v4l2 {

// "exposure_time_absolute" for the control "Exposure Time, Absolute", as v4l2-ctl spells it.
std::string SettingName(const std::string& control);

// The controls of each camera that the options name, under their drivers' names. Menus take an
// entry's number or its name; "default" is what the driver calls so.
Result<std::vector<std::unique_ptr<CameraSettings>>> OpenSettings(V4l2System& system,
                                                                  const V4l2CameraOptions& options);

}  // namespace omnihdr::v4l2
