#pragma once

#include <cstdint>

// The register map of IIDC 1.31/1.32 and of Point Grey's additions (README.md). Bits are numbered
// with 31 as the most significant; the manuals count the other way.
namespace omnihdr::iidc {

constexpr std::uint32_t Bit(int number) { return std::uint32_t{1} << number; }
// Bits high..low of a register, moved to the right.
constexpr std::uint32_t Field(std::uint32_t value, int high, int low) {
  return (value >> low) & ((std::uint32_t{2} << (high - low)) - 1);
}

inline constexpr std::uint64_t kRegisterSpace = 0xFFFF'F000'0000;
inline constexpr std::uint64_t kConfigRom = kRegisterSpace + 0x400;

// Offsets from the command base.
inline constexpr std::uint32_t kInitialize = 0x000;
inline constexpr std::uint32_t kFormatInquiry = 0x100;
inline constexpr std::uint32_t kFormat7ModeInquiry = 0x19C;
inline constexpr std::uint32_t kFormat7Pointers = 0x2E0;  // + 4 · mode
inline constexpr std::uint32_t kBasicInquiry = 0x400;
inline constexpr std::uint32_t kFeatureHighInquiry = 0x404;
inline constexpr std::uint32_t kVideoMode = 0x604;
inline constexpr std::uint32_t kVideoFormat = 0x608;
inline constexpr std::uint32_t kCameraPower = 0x610;
inline constexpr std::uint32_t kIsoEnable = 0x614;
inline constexpr std::uint32_t kVideoModeError = 0x628;
inline constexpr std::uint32_t kSoftwareTrigger = 0x62C;
inline constexpr std::uint32_t kFrameInfo = 0x12F8;
inline constexpr std::uint32_t kHdrControl = 0x1800;
inline constexpr std::uint32_t kSerialNumber = 0x1F20;
inline constexpr std::uint32_t kHeadSerialNumber = 0x1F80;
inline constexpr std::uint32_t kJpegControl = 0x1E80;

// Feature registers (value; inquiry and pointer lie below).
inline constexpr std::uint32_t kBrightness = 0x800;
inline constexpr std::uint32_t kAutoExposure = 0x804;
inline constexpr std::uint32_t kSharpness = 0x808;
inline constexpr std::uint32_t kWhiteBalance = 0x80C;
inline constexpr std::uint32_t kHue = 0x810;
inline constexpr std::uint32_t kSaturation = 0x814;
inline constexpr std::uint32_t kGamma = 0x818;
inline constexpr std::uint32_t kShutter = 0x81C;
inline constexpr std::uint32_t kGain = 0x820;
inline constexpr std::uint32_t kIris = 0x824;
inline constexpr std::uint32_t kFocus = 0x828;
inline constexpr std::uint32_t kTemperature = 0x82C;
inline constexpr std::uint32_t kTriggerMode = 0x830;
inline constexpr std::uint32_t kTriggerDelay = 0x834;
inline constexpr std::uint32_t kFrameRate = 0x83C;
inline constexpr std::uint32_t kFeatureInquiryBelow = 0x300;
inline constexpr std::uint32_t kAbsolutePointerAboveInquiry = 0x200;

}  // namespace omnihdr::iidc
