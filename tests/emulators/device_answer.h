#pragma once

#include <cstddef>

namespace omnihdr::emulators {

// What a device model answers to a request.
enum class DeviceAnswer { kOk, kStall, kNak, kGone };

// What came of reading a device's stream into a buffer. `ended`: a short (or empty) packet ended
// the transfer, or the buffer is full.
struct DeviceMoved {
  DeviceAnswer answer = DeviceAnswer::kNak;  // kNak: nothing yet
  std::size_t bytes = 0;
  bool ended = false;
};

}  // namespace omnihdr::emulators
