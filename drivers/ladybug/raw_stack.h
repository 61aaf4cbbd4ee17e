#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "core/base/result.h"
#include "core/image/image.h"

namespace omnihdr::ladybug {

inline constexpr int kSensors = 6;

// Where a block of the raw frame belongs in the rig's stack: the frame holds the six sensors one
// below the other, each lying on its side as the rig file describes it. This is the one place that
// knows the order; it has not been seen on a real head (README.md).
struct RawBlock {
  int sensor = 0;
  bool turned = false;  // by 180 degrees
};
inline constexpr std::array<RawBlock, kSensors> kRawBlocks = {
    {{0, false}, {1, false}, {2, false}, {3, false}, {4, false}, {5, false}}};

// A raw frame as the rig's stack of sensors. `bytes` holds at least six blocks of width · height
// (kData otherwise); what follows is padding.
Result<Image<std::uint8_t>> StackFromRaw(std::span<const std::byte> bytes, int width, int height);

}  // namespace omnihdr::ladybug
