#pragma once

#include "daemon/config.h"
#include "drivers/all_drivers.h"

namespace omnihdr {

// What a configuration asks of its camera's driver. Nothing is checked or opened. `wired`: on the
// trigger's wire, as the daemon has it with trigger.wired; else the camera is commanded whatever
// the configuration says.
CameraOptions MakeCameraOptions(const DaemonConfig& config, bool wired = false);

}  // namespace omnihdr
