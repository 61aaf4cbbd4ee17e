#pragma once

#include <libusb.h>

#include <memory>
#include <string_view>

#include "drivers/usb/usb.h"

namespace omnihdr::usb {

using LibusbContext = std::shared_ptr<libusb_context>;
using LibusbHandle = std::shared_ptr<libusb_device_handle>;

// A libusb error code as an error; `what` may be empty.
tl::unexpected<Error> LibusbFailure(int code, std::string_view what);

// The stream keeps context and handle alive.
Result<std::unique_ptr<BulkStream>> StartLibusbStream(LibusbContext context, LibusbHandle handle,
                                                      const BulkStreamOptions& options);

}  // namespace omnihdr::usb
