#include "drivers/iidc/frame_info.h"

#include <bit>

#include "drivers/iidc/registers.h"

namespace omnihdr::iidc {
namespace {

constexpr int kAvailableShift = 16;
constexpr std::int64_t kCyclesPerSecond = 8000;
constexpr std::int64_t kTicksPerCycle = 3072;
constexpr std::int64_t kCycleNanoseconds = 125'000;

}  // namespace

std::size_t EmbeddedBytes(std::uint32_t enabled) {
  return 4 * static_cast<std::size_t>(std::popcount(enabled & kEmbeddedAll));
}

std::optional<EmbeddedInfo> ParseEmbeddedInfo(std::span<const std::byte> frame,
                                              std::uint32_t enabled) {
  if (frame.size() < EmbeddedBytes(enabled)) return std::nullopt;
  EmbeddedInfo info;
  std::optional<std::uint32_t>* const items[kEmbeddedItems] = {
      &info.cycle_time,    &info.gain,    &info.shutter, &info.brightness, &info.auto_exposure,
      &info.white_balance, &info.counter, &info.strobe,  &info.pins,       &info.position};
  std::size_t at = 0;
  for (int i = 0; i < kEmbeddedItems; ++i) {
    if ((enabled & Bit(i)) == 0) continue;
    std::uint32_t word = 0;
    for (int byte = 0; byte < 4; ++byte) {
      word = word << 8 | std::to_integer<std::uint32_t>(frame[at++]);
    }
    *items[i] = word;
  }
  return info;
}

Result<std::uint32_t> EnableEmbeddedInfo(const Registers& registers) {
  OMNIHDR_ASSIGN(const std::uint32_t before, registers.Read(kFrameInfo, "FRAME_INFO"));
  if ((before & Bit(31)) == 0) return 0U;
  const std::uint32_t available = before >> kAvailableShift & kEmbeddedAll;
  OMNIHDR_ASSIGN(const std::uint32_t after, registers.WriteChecked(kFrameInfo, Bit(31) | available,
                                                                   kEmbeddedAll, "FRAME_INFO"));
  return after & kEmbeddedAll;
}

Status DisableEmbeddedInfo(const Registers& registers) {
  OMNIHDR_ASSIGN(const std::uint32_t before, registers.Read(kFrameInfo, "FRAME_INFO"));
  if ((before & Bit(31)) == 0) return {};
  OMNIHDR_TRY(registers.WriteChecked(kFrameInfo, Bit(31), kEmbeddedAll, "FRAME_INFO"));
  return {};
}

std::optional<std::int64_t> CycleTimeNanoseconds(std::uint32_t word) {
  const std::int64_t seconds = Field(word, 31, 25);
  const std::int64_t cycles = Field(word, 24, 12);
  const std::int64_t ticks = Field(word, 11, 0);
  if (cycles >= kCyclesPerSecond || ticks >= kTicksPerCycle) return std::nullopt;
  return seconds * 1'000'000'000 + cycles * kCycleNanoseconds +
         ticks * kCycleNanoseconds / kTicksPerCycle;
}

}  // namespace omnihdr::iidc
