#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "drivers/iidc/register_bus.h"

namespace omnihdr::iidc {

inline constexpr std::size_t kMaxRomQuadlets = 256;

// What a camera's configuration ROM says (IEEE 1212).
struct ConfigRom {
  std::uint64_t guid = 0;  // unique to the device
  std::uint32_t vendor_id = 0;
  std::uint32_t unit_spec = 0;     // 00A02D IIDC, 00B09D Point Grey
  std::uint32_t unit_version = 0;  // 0x100 = 1.04, 0x101 = 1.20, 0x102 = 1.30 and later
  std::uint64_t command_base = 0;  // address of the IIDC registers
  std::string vendor;              // printable ASCII; empty when the ROM does not say
  std::string model;
};

// Untrusted quadlets, the first at kConfigRom. Directories and texts that lie outside, lead back or
// contradict each other are errors (kProtocol) that name the quadlet; missing texts are not.
Result<ConfigRom> ParseConfigRom(std::span<const std::uint32_t> quadlets);

// Reads the ROM a quadlet at a time (a read past its end fails whole) as far as the camera answers.
Result<std::vector<std::uint32_t>> ReadConfigRom(RegisterBus& bus, Nanoseconds timeout);

// "00b09d0100a1b2c3".
std::string FormatGuid(std::uint64_t guid);

}  // namespace omnihdr::iidc
