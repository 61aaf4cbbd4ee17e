#pragma once

#include "daemon/config.h"
#include "drivers/all_drivers.h"

namespace omnihdr {

// What a configuration asks of its camera's driver. Nothing is checked or opened.
CameraOptions MakeCameraOptions(const DaemonConfig& config);

}  // namespace omnihdr
