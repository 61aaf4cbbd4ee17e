#pragma once

#include <cstdint>

#include "drivers/iidc/register_bus.h"

namespace omnihdr::iidc {

// What a camera's trigger can do (register 0x530).
struct TriggerInquiry {
  bool present = false;
  bool software = false;
  bool polarity = false;
  std::uint32_t modes = 0;    // bit m: mode m (0 to 5, 14, 15)
  std::uint32_t sources = 0;  // bit s: source s (0 to 3)
};
TriggerInquiry ParseTriggerInquiry(std::uint32_t quadlet);
Result<TriggerInquiry> InquireTrigger(const Registers& registers);

inline constexpr std::uint32_t kSoftwareSource = 7;
inline constexpr int kSeriesMode = 15;  // several pictures a trigger

// Software trigger in mode 0 (one picture, shutter register), 14 (the same, the next exposure may
// overlap the readout) or 15 (`pictures` pictures a trigger). Read back. kConfig: the camera has no
// such mode or no software trigger.
Status SetUpSoftwareTrigger(const Registers& registers, int mode, int pictures = 1);
// The camera exposes by itself at a pulse on its input `source` (0 to 3), in mode 0 or 14. Read
// back. kConfig: it has no such input or mode, or not that polarity.
Status SetUpWiredTrigger(const Registers& registers, int mode, int source, bool active_low);
// Free running.
Status SwitchTriggerOff(const Registers& registers);

// Waits until the camera takes a trigger, of whatever source (deadline: the settling time); it
// tells so when it has the software trigger's register. Triggers it. Never sent twice: a trigger
// whose answer is lost may have worked.
Status WaitForTriggerReady(const Registers& registers);
Status SendSoftwareTrigger(const Registers& registers);

}  // namespace omnihdr::iidc
