#pragma once

#include <memory>

#include "drivers/usb/usb.h"

namespace omnihdr::usb {

// The machine's USB devices, through libusb-1.0. Every Open has a libusb context of its own, so
// that a device that comes later is seen with or without udev running. Any thread.
std::unique_ptr<Bus> MakeLibusbBus();

}  // namespace omnihdr::usb
