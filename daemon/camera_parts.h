#pragma once

#include <memory>

#include "core/ports/camera_release.h"
#include "daemon/config.h"
#include "drivers/all_drivers.h"
#include "drivers/gpio/camera_trigger.h"

namespace omnihdr {

// What a configuration asks of its camera's driver. Nothing is checked or opened. `wired`: on the
// trigger's wire, as the daemon has it with trigger.wired; else the camera is commanded whatever
// the configuration says: over its own interface, or by pulses of `release` where there is one.
CameraOptions MakeCameraOptions(const DaemonConfig& config, bool wired = false,
                                std::shared_ptr<CameraRelease> release = nullptr);

// The line of gpio.outputs.camera_trigger, not yet started; null when none is configured.
std::shared_ptr<gpio::CameraTrigger> MakeCameraTrigger(const DaemonConfig& config);
// The same for a program that has the camera to itself: started, and open. kUnavailable with the
// reason when it does not open within a second.
Result<std::shared_ptr<CameraRelease>> OpenCameraTrigger(const DaemonConfig& config);
// For a camera that a recording plays, whose pulses have been given already; null as above.
std::shared_ptr<CameraRelease> MakeReplayedCameraTrigger(const DaemonConfig& config);

}  // namespace omnihdr
