#pragma once

namespace omnihdr::kernel {

// Two serial ports of the guest, wired to each other (tests/kernel/run).
inline constexpr const char* kOneEnd = "/dev/ttyS1";
inline constexpr const char* kOtherEnd = "/dev/ttyS2";
inline constexpr int kSerialBaud = 115200;

}  // namespace omnihdr::kernel
