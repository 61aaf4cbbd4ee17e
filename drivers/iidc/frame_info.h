#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>

#include "core/base/clock.h"
#include "drivers/iidc/register_bus.h"

namespace omnihdr::iidc {

// What the camera writes over the first pixels of a frame (register FRAME_INFO, 0x12F8), as the
// words it writes. Only the items that are enabled are there.
struct EmbeddedInfo {
  std::optional<std::uint32_t> cycle_time;
  std::optional<std::uint32_t> gain;
  std::optional<std::uint32_t> shutter;
  std::optional<std::uint32_t> brightness;
  std::optional<std::uint32_t> auto_exposure;
  std::optional<std::uint32_t> white_balance;
  std::optional<std::uint32_t> counter;
  std::optional<std::uint32_t> strobe;
  std::optional<std::uint32_t> pins;
  std::optional<std::uint32_t> position;
};

inline constexpr int kEmbeddedItems = 10;
inline constexpr std::uint32_t kEmbeddedCycleTime = 1 << 0;
inline constexpr std::uint32_t kEmbeddedGain = 1 << 1;
inline constexpr std::uint32_t kEmbeddedShutter = 1 << 2;
inline constexpr std::uint32_t kEmbeddedCounter = 1 << 6;
inline constexpr std::uint32_t kEmbeddedAll = (1 << kEmbeddedItems) - 1;

// Bytes that the items of an enable mask take; 4 each.
std::size_t EmbeddedBytes(std::uint32_t enabled);

// Takes the enabled items, big-endian and without gaps, from a frame's first bytes. Nothing when
// the frame is shorter than they are.
std::optional<EmbeddedInfo> ParseEmbeddedInfo(std::span<const std::byte> frame,
                                              std::uint32_t enabled);

// Switches on every item the camera has; returns the enable mask in force, 0 when it has none.
Result<std::uint32_t> EnableEmbeddedInfo(const Registers& registers);
// Leaves every byte of the frame as it is.
Status DisableEmbeddedInfo(const Registers& registers);

// A 1394 cycle time word in nanoseconds, from 0 to 128 s. Nothing when a field is out of range.
std::optional<std::int64_t> CycleTimeNanoseconds(std::uint32_t word);
inline constexpr std::int64_t kCycleTimeWrap = 128'000'000'000;

}  // namespace omnihdr::iidc
