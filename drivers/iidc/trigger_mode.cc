#include "drivers/iidc/trigger_mode.h"

#include "drivers/iidc/registers.h"

namespace omnihdr::iidc {
namespace {

constexpr std::uint32_t kOn = Bit(25);
constexpr int kSourceShift = 21;
constexpr int kModeShift = 16;
constexpr std::uint32_t kActiveHigh = Bit(24);
// Everything but polarity and the pin's state.
constexpr std::uint32_t kSetMask = kOn | 7U << kSourceShift | 0xFU << kModeShift | 0xFFFU;

}  // namespace

TriggerInquiry ParseTriggerInquiry(std::uint32_t quadlet) {
  TriggerInquiry inquiry;
  inquiry.present = (quadlet & Bit(31)) != 0;
  inquiry.polarity = (quadlet & Bit(25)) != 0;
  inquiry.software = (quadlet & Bit(16)) != 0;
  for (int source = 0; source < 4; ++source) {
    if ((quadlet & Bit(23 - source)) != 0) inquiry.sources |= Bit(source);
  }
  for (int mode = 0; mode < 16; ++mode) {
    if ((mode <= 5 || mode >= 14) && (quadlet & Bit(15 - mode)) != 0) inquiry.modes |= Bit(mode);
  }
  return inquiry;
}

Result<TriggerInquiry> InquireTrigger(const Registers& registers) {
  OMNIHDR_ASSIGN(const std::uint32_t quadlet,
                 registers.Read(kTriggerMode - kFeatureInquiryBelow, "TRIGGER_INQ"));
  return ParseTriggerInquiry(quadlet);
}

Status SetUpSoftwareTrigger(const Registers& registers, int mode, int pictures) {
  if ((mode != 0 && mode != 14 && mode != 15) || pictures < 1 || pictures > 255) {
    return Fail(ErrorKind::kConfig,
                "trigger mode {} with {} pictures: expected mode 0, 14 or 15 and 1 to 255", mode,
                pictures);
  }
  OMNIHDR_ASSIGN(const std::uint32_t quadlet,
                 registers.Read(kTriggerMode - kFeatureInquiryBelow, "TRIGGER_INQ"));
  const TriggerInquiry inquiry = ParseTriggerInquiry(quadlet);
  if (!inquiry.present || !inquiry.software) {
    return Fail(ErrorKind::kConfig,
                "TRIGGER_INQ (0x530): {:#010x}: the camera has no software "
                "trigger",
                quadlet);
  }
  if ((inquiry.modes & Bit(mode)) == 0) {
    return Fail(ErrorKind::kConfig,
                "TRIGGER_INQ (0x530): {:#010x}: the camera has no trigger mode "
                "{}",
                quadlet, mode);
  }
  const std::uint32_t parameter = mode == 15 ? static_cast<std::uint32_t>(pictures) : 0;
  const std::uint32_t value = Bit(31) | kOn | kSoftwareSource << kSourceShift |
                              static_cast<std::uint32_t>(mode) << kModeShift | parameter;
  OMNIHDR_TRY(registers.WriteChecked(kTriggerMode, value, kSetMask, "TRIGGER_MODE"));
  return {};
}

Status SetUpWiredTrigger(const Registers& registers, int mode, int source, bool active_low) {
  if ((mode != 0 && mode != 14) || source < 0 || source > 3) {
    return Fail(ErrorKind::kConfig,
                "trigger mode {} at input {}: expected mode 0 or 14 and input 0 to 3", mode,
                source);
  }
  OMNIHDR_ASSIGN(const std::uint32_t quadlet,
                 registers.Read(kTriggerMode - kFeatureInquiryBelow, "TRIGGER_INQ"));
  const TriggerInquiry inquiry = ParseTriggerInquiry(quadlet);
  if (!inquiry.present || (inquiry.sources & Bit(source)) == 0) {
    return Fail(ErrorKind::kConfig,
                "TRIGGER_INQ (0x530): {:#010x}: the camera has no trigger input {}", quadlet,
                source);
  }
  if ((inquiry.modes & Bit(mode)) == 0) {
    return Fail(ErrorKind::kConfig,
                "TRIGGER_INQ (0x530): {:#010x}: the camera has no trigger mode {}", quadlet, mode);
  }
  const std::uint32_t polarity = active_low ? 0 : kActiveHigh;
  OMNIHDR_ASSIGN(const std::uint32_t before, registers.Read(kTriggerMode, "TRIGGER_MODE"));
  if (!inquiry.polarity && (before & kActiveHigh) != polarity) {
    return Fail(ErrorKind::kConfig,
                "TRIGGER_INQ (0x530): {:#010x}: the camera's input is active {} and cannot be set",
                quadlet, active_low ? "high" : "low");
  }
  const std::uint32_t value = Bit(31) | kOn | polarity |
                              static_cast<std::uint32_t>(source) << kSourceShift |
                              static_cast<std::uint32_t>(mode) << kModeShift;
  OMNIHDR_TRY(registers.WriteChecked(kTriggerMode, value, kSetMask | kActiveHigh, "TRIGGER_MODE"));
  return {};
}

Status SwitchTriggerOff(const Registers& registers) {
  OMNIHDR_ASSIGN(const std::uint32_t before, registers.Read(kTriggerMode, "TRIGGER_MODE"));
  OMNIHDR_TRY(registers.WriteChecked(kTriggerMode, before & ~kOn, kOn, "TRIGGER_MODE"));
  return {};
}

Status WaitForTriggerReady(const Registers& registers) {
  OMNIHDR_TRY(registers.WaitFor(kSoftwareTrigger, Bit(31), 0, "SOFTWARE_TRIGGER"));
  return {};
}

Status SendSoftwareTrigger(const Registers& registers) {
  return registers.Write(kSoftwareTrigger, Bit(31), "SOFTWARE_TRIGGER");
}

}  // namespace omnihdr::iidc
