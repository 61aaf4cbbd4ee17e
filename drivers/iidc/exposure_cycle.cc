#include "drivers/iidc/exposure_cycle.h"

#include <fmt/format.h>

#include <algorithm>

#include "drivers/iidc/registers.h"

namespace omnihdr::iidc {
namespace {

constexpr std::uint32_t kOn = Bit(25);
constexpr std::uint32_t kFirstStep = 0x1820;
constexpr std::uint32_t kStepDistance = 0x20;
constexpr std::uint32_t kGainBehindShutter = 4;
constexpr std::uint32_t kWord = 0xFFF;

// Bits of steps, each one on.
unsigned Advance(unsigned steps) {
  return (steps << 1 | steps >> (kCycleSteps - 1)) & ((1U << kCycleSteps) - 1);
}

}  // namespace

std::optional<CycleLayout> LayOutCycle(std::span<const Exposure> order, std::string& why) {
  why.clear();
  const bool alike =
      std::all_of(order.begin(), order.end(), [&](const Exposure& e) { return e == order[0]; });
  if (alike) return std::nullopt;
  if (order.size() > kCycleSteps) {
    why = fmt::format("the bracket's order has {} pictures, the camera's exposure cycle {} steps",
                      order.size(), kCycleSteps);
    return std::nullopt;
  }
  CycleLayout layout;
  layout.exact = kCycleSteps % order.size() == 0;
  for (std::size_t step = 0; step < kCycleSteps; ++step) {
    layout.steps[step] = order[step % order.size()];
  }
  if (!layout.exact) {
    layout.steps.back() =
        *std::min_element(order.begin(), order.end(),
                          [](const Exposure& a, const Exposure& b) { return a.time < b.time; });
  }
  return layout;
}

std::optional<int> CyclePhase::next() const {
  std::optional<int> first;
  for (int step = 0; step < kCycleSteps; ++step) {
    if ((may_be_ & 1U << step) == 0) continue;
    if (!first) {
      first = step;
      continue;
    }
    for (int ahead = 0; ahead < kCycleSteps; ++ahead) {
      const auto a = static_cast<std::size_t>((*first + ahead) % kCycleSteps);
      const auto b = static_cast<std::size_t>((step + ahead) % kCycleSteps);
      if (steps_[a] != steps_[b]) return std::nullopt;
    }
  }
  return first;
}

CyclePhase::Seen CyclePhase::Saw(const std::optional<CycleWords>& words) {
  unsigned same = 0;
  for (int step = 0; words && step < kCycleSteps; ++step) {
    if (steps_[static_cast<std::size_t>(step)] == *words) same |= 1U << step;
  }
  if (same == 0) {
    Forget();
    return Seen::kForeign;
  }
  const bool known = next().has_value();
  const unsigned agree = may_be_ & same;
  may_be_ = Advance(agree != 0 ? agree : same);
  if (agree == 0) return Seen::kContradiction;
  return known ? Seen::kExpected : Seen::kLearnt;
}

std::optional<int> CyclePhase::Find(const CycleWords& words) const {
  const auto found = std::find(steps_.begin(), steps_.end(), words);
  if (found == steps_.end()) return std::nullopt;
  return static_cast<int>(found - steps_.begin());
}

Result<bool> HasExposureCycle(const Registers& registers) {
  OMNIHDR_ASSIGN(const std::uint32_t control, registers.Read(kHdrControl, "HDR_CONTROL"));
  return (control & Bit(31)) != 0;
}

Status LoadExposureCycle(const Registers& registers,
                         const std::array<CycleWords, kCycleSteps>& steps, bool gain) {
  OMNIHDR_TRY(SwitchExposureCycleOff(registers));
  std::uint32_t at = kFirstStep;
  for (const CycleWords& step : steps) {
    OMNIHDR_TRY(registers.WriteChecked(at, Bit(31) | step.shutter, kWord, "HDR_SHUTTER"));
    if (gain) {
      OMNIHDR_TRY(
          registers.WriteChecked(at + kGainBehindShutter, Bit(31) | step.gain, kWord, "HDR_GAIN"));
    }
    at += kStepDistance;
  }
  OMNIHDR_TRY(registers.WriteChecked(kHdrControl, Bit(31) | kOn, kOn, "HDR_CONTROL"));
  return {};
}

Status SwitchExposureCycleOff(const Registers& registers) {
  OMNIHDR_TRY(registers.WriteChecked(kHdrControl, Bit(31), kOn, "HDR_CONTROL"));
  return {};
}

}  // namespace omnihdr::iidc
