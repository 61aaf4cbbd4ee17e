#pragma once

#include "drivers/modbus/connection.h"

namespace omnihdr::kernel {

// Two serial ports of the guest, wired to each other (tests/kernel/run).
inline constexpr const char* kOneEnd = "/dev/ttyS1";
inline constexpr const char* kOtherEnd = "/dev/ttyS2";

inline modbus::Endpoint SerialEndpoint(const char* device) {
  modbus::Endpoint endpoint;
  endpoint.connection = modbus::Connection::kRtu;
  endpoint.device = device;
  endpoint.baud = 115200;
  return endpoint;
}

}  // namespace omnihdr::kernel
