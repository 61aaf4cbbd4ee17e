#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <variant>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "drivers/iidc/frame_info.h"

namespace omnihdr::iidc {

// What a frame's bytes are.
enum class PictureFormat {
  kRaw,   // pixels, row by row; the first ones covered by the embedded information
  kJpeg,  // a Ladybug's colour-separated JPEGs behind a header that has the same information
};
std::string_view ToString(PictureFormat format);

struct PictureLayout {
  PictureFormat format = PictureFormat::kRaw;
  int sensors = 1;
  int width = 0;               // of one sensor; of all of them when they are not alike
  int height = 0;              // of all sensors, stacked
  bool deep = false;           // kRaw: 16 bits a value, the high byte first
  int depth = 0;               // deep: bits that mean something, at the top; 0 = not told
  std::uint32_t embedded = 0;  // items enabled; of no interest for kJpeg
};

// What the camera says about a frame in the frame.
struct FrameFacts {
  EmbeddedInfo info;
  bool one_exposure = true;  // kJpeg: all sensors had the same
};
// Nothing when the frame is too short for it, damaged, or says nothing.
std::optional<FrameFacts> ReadFacts(std::span<const std::byte> frame, const PictureLayout& layout);

// The rig's stacked mosaic out of a frame's bytes. Raw: rows that are missing are black, and the
// pixels under the embedded information are those two rows below, the nearest of their colour.
// JPEG: all or an error (kData). Deep: values of 16 bits; kData when bits below the depth are set,
// since then order of bytes or alignment are not what they are taken for.
using Pixels = std::variant<Image<std::uint8_t>, Image<std::uint16_t>>;
Result<Pixels> ReadPicture(std::vector<std::byte> frame, const PictureLayout& layout);

}  // namespace omnihdr::iidc
