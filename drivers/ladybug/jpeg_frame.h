#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>

#include "core/base/result.h"
#include "core/image/image.h"
#include "drivers/ladybug/raw_stack.h"

namespace omnihdr::ladybug {

inline constexpr int kChannels = 4;  // of a Bayer tile: R, G, G, B

// A compressed frame: every sensor's Bayer mosaic, taken apart into four grey pictures of half the
// size, each a JPEG of its own, behind a header of big-endian words.
struct JpegBlock {
  std::uint32_t offset = 0;  // from the frame's first byte
  std::uint32_t bytes = 0;
};
struct JpegFrameHeader {
  std::uint32_t cycle_time = 0;
  std::uint32_t data_bytes = 0;  // of the whole frame, padding included
  std::uint32_t version = 0;
  std::uint32_t seconds = 0;  // since 1970, as the host that recorded it had it; 0 = not written
  std::uint32_t microseconds = 0;
  std::uint32_t sequence = 0;
  std::uint32_t white_balance = 0;
  std::uint32_t bayer_mapping = 0;
  std::uint32_t head_serial = 0;
  std::array<std::uint32_t, kSensors> gains{};     // words of the value registers
  std::array<std::uint32_t, kSensors> shutters{};  // the same
  // By sensor and channel (0 R, 1 and 2 G, 3 B).
  std::array<std::array<JpegBlock, kChannels>, kSensors> blocks{};
  // Whether all sensors had one shutter and one gain.
  bool IsOneExposure() const;
};

inline constexpr std::size_t kJpegHeaderBytes = 0x400;

// Untrusted bytes of one frame. Errors (kData) tell what is wrong: fewer bytes than the header or
// than the header says (the buffer was too small, or compression had not finished), no fingerprint,
// another version, a channel that was not sent, blocks outside the data, in the header, over each
// other, or not a JPEG. What passes has 24 blocks that lie apart within the bytes.
Result<JpegFrameHeader> ParseJpegFrame(std::span<const std::byte> frame);

// The rig's stack of mosaics, BGGR. Every picture must be grey and of half the sensor's size.
// Errors name sensor and channel.
Result<Image<std::uint8_t>> DecodeJpegFrame(std::span<const std::byte> frame,
                                            const JpegFrameHeader& header, int width, int height);

// Where the table of the header tells of a sensor's channel. Readers of the format disagree on the
// order of the sensors; this is the one place that knows it, not seen on a real head (README.md).
constexpr std::size_t JpegTableEntry(int sensor, int channel) {
  return 0x340 + 32 * static_cast<std::size_t>(sensor) +
         8 * static_cast<std::size_t>(kChannels - 1 - channel);
}

}  // namespace omnihdr::ladybug
