#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>

#include "core/ports/camera.h"
#include "drivers/iidc/register_bus.h"

namespace omnihdr::iidc {

// The camera's own exposure cycle (HDR_CONTROL, 0x1800): when it is on, pictures step through four
// settings of shutter and gain. No source tells where it stands at any moment, so that is measured:
// frames say in their embedded words which setting they had.

inline constexpr int kCycleSteps = 4;

// Shutter and gain as the value registers and the embedded words hold them, 12 bits. Gain 0 for a
// camera that has none.
struct CycleWords {
  std::uint32_t shutter = 0;
  std::uint32_t gain = 0;
  bool operator==(const CycleWords&) const = default;
};

// What the cycle's four steps hold so that pictures one after the other have a plan's exposures.
// Two in turn fill it twice, three leave one step over, which takes the shortest of them again.
struct CycleLayout {
  std::array<Exposure, kCycleSteps> steps;
  bool exact = true;  // it is the plan's order, over and over; not with a step left over
};
// Nothing when the plan does not fit: `why` says so, or is empty where one exposure needs no cycle.
std::optional<CycleLayout> LayOutCycle(std::span<const Exposure> order, std::string& why);

// Which step the next picture has, as far as the frames seen tell. Law: next() answers only what
// follows from a frame's own words and the rule that pictures step by one; a frame that breaks the
// rule is counted and begins the knowledge anew. Not thread-safe.
class CyclePhase {
 public:
  explicit CyclePhase(const std::array<CycleWords, kCycleSteps>& steps) : steps_(steps) {}

  // The step of the next picture; of several with the same words that go on alike, the first.
  std::optional<int> next() const;

  enum class Seen {
    kExpected,
    kLearnt,         // nothing was known for sure before
    kContradiction,  // another step's words than was due
    kForeign,        // no words, or none of the cycle's
  };
  // A picture was taken, and came with these words.
  Seen Saw(const std::optional<CycleWords>& words);
  // Pictures may have been taken that nobody saw: nothing is known.
  void Forget() { may_be_ = kAny; }
  // The step that words belong to; the first of several.
  std::optional<int> Find(const CycleWords& words) const;

 private:
  static constexpr unsigned kAny = (1U << kCycleSteps) - 1;
  std::array<CycleWords, kCycleSteps> steps_;
  unsigned may_be_ = kAny;  // bit s: the next picture may have step s
};

// Whether the camera has the register at all.
Result<bool> HasExposureCycle(const Registers& registers);
// Off while the four settings are written and read back, then on. kProtocol: a setting reads back
// as another than was written.
Status LoadExposureCycle(const Registers& registers,
                         const std::array<CycleWords, kCycleSteps>& steps, bool gain);
Status SwitchExposureCycleOff(const Registers& registers);

}  // namespace omnihdr::iidc
