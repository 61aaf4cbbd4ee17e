#pragma once

#include <cstddef>
#include <memory>

#include "drivers/iidc/register_bus.h"
#include "drivers/usb/usb.h"

namespace omnihdr::iidc {

// How a register request travels over USB: a vendor request whose bRequest stands for address bits
// 47..32, wValue for bits 15..0 and wIndex for bits 31..16. kUsage: no request stands for that
// part of the address space.
Result<usb::ControlSetup> SetupForAddress(std::uint64_t address);

// An IIDC camera on USB.
std::unique_ptr<Link> MakeUsbLink(std::unique_ptr<usb::Device> device);

// Bytes of USB buffers that a camera's stream has in flight, at most.
std::size_t UsbBytesInFlight(std::size_t frame_bytes);

// The Point Grey cameras on a bus.
std::unique_ptr<LinkFinder> MakeUsbFinder(std::shared_ptr<usb::Bus> bus);

}  // namespace omnihdr::iidc
