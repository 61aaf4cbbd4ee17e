#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/image/image.h"

namespace omnihdr::emulators {

// Words of a compressed frame's header.
struct LadybugWords {
  std::uint32_t cycle_time = 0;
  std::uint32_t sequence = 0;
  std::uint32_t gain = 0;
  std::uint32_t shutter = 0;
  std::uint32_t head_serial = 6100;
  std::uint32_t seconds = 0;
  std::uint32_t microseconds = 0;
};

// A colour-separated compressed frame of a stack of six BGGR mosaics, written by the format's
// description alone: a header of big-endian words, 24 grey JPEGs, padding to 512 bytes.
std::vector<std::byte> BuildLadybugFrame(const Image<std::uint8_t>& stack,
                                         const LadybugWords& words, int quality = 90);

// A recorded stream of such frames, by the format's description alone. Not `closed`: as it is left
// when the power fails, without the number of images and the index.
std::vector<std::byte> BuildPgrStream(const std::vector<std::vector<std::byte>>& frames,
                                      std::uint32_t version, std::uint32_t head_serial,
                                      bool closed = true);

}  // namespace omnihdr::emulators
