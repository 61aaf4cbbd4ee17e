#pragma once

#include <memory>
#include <string>

#include "core/base/result.h"
#include "core/ports/camera_settings.h"
#include "drivers/iidc/register_bus.h"

namespace omnihdr::iidc {

// The features of the camera called `id` (as IidcCameraOptions::id), under their IIDC names in
// small letters, nothing initialised. A feature takes "off", "auto", a number in its own unit
// (seconds, dB, ...) where the camera has absolute values, and "raw:N", the register's value, which
// is what a plain number means where it has none; white_balance takes "BLUE,RED". A register is
// named by its offset from the command base, "0x1044", and takes a quadlet.
Result<std::unique_ptr<CameraSettings>> OpenSettings(LinkFinder& finder, const std::string& id,
                                                     const RegisterTimeouts& timeouts = {});

}  // namespace omnihdr::iidc
