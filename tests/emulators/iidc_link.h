#pragma once

#include <memory>

#include "drivers/iidc/register_bus.h"
#include "tests/emulators/iidc_device.h"

namespace omnihdr::emulators {

// The device model as a camera of this process: no USB in between. An emulated device that does not
// answer (NAK) takes the whole timeout.
std::unique_ptr<iidc::Link> MakeEmulatedLink(std::shared_ptr<IidcDevice> device);
// Finds the devices that are plugged in.
std::unique_ptr<iidc::LinkFinder> MakeEmulatedFinder(
    std::vector<std::shared_ptr<IidcDevice>> devices);

// A rig file for pictures of an emulated head: `sensors` of width · rows each, stacked. Returns its
// text.
std::string EmulatedRig(int sensors, int width, int rows, BayerOrder bayer);

}  // namespace omnihdr::emulators
