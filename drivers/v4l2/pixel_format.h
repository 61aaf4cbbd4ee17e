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
#include "core/sphere/rig.h"

namespace omnihdr::v4l2 {

// What a pixel is made of, as configuration names it; kAuto = the deepest one that camera and
// layout agree on.
enum class Coding {
  kAuto,
  kGrey,
  kY10,
  kY12,
  kY16,
  kBayer8,
  kBayer10,
  kBayer12,
  kBayer16,
  kYuyv,
  kMjpeg,
};
std::string_view ToString(Coding coding);

// A format of V4L2 that this driver reads.
struct PixelFormat {
  std::uint32_t fourcc = 0;
  Coding coding = Coding::kGrey;
  int bits = 8;                          // of a value; above 8 in 16-bit words, little-endian
  BayerOrder bayer = BayerOrder::kNone;  // of a mosaic
  int channels = 1;                      // of the picture made of it: 3 = finished colour
};
// All, the deepest first and mosaics before finished colour.
std::span<const PixelFormat> PixelFormats();
std::optional<PixelFormat> FindPixelFormat(std::uint32_t fourcc);

// A buffer's layout as the driver has set it.
struct FrameLayout {
  PixelFormat format;
  int width = 0;
  int height = 0;
  std::size_t bytes_per_line = 0;  // uncompressed
  std::size_t image_bytes = 0;     // the largest buffer
  bool full_range = false;         // kYuyv: luma 0 to 255 rather than 16 to 235
};
inline constexpr int kMaxSide = 65536;
inline constexpr std::size_t kMaxImageBytes = std::size_t{1} << 28;
// kProtocol when the numbers contradict each other or are too large.
Status CheckLayout(const FrameLayout& layout);

using Pixels = std::variant<Image<std::uint8_t>, Image<std::uint16_t>>;
// The picture in a buffer: a mosaic or grey as it is (values above the format's bits cut to them),
// YUYV (BT.601) and MJPEG as RGB. kData when bytes are missing or no picture of that size.
Result<Pixels> ReadPixels(std::span<const std::byte> bytes, const FrameLayout& layout);
// A black picture of the layout's size.
Pixels BlackPixels(const FrameLayout& layout);

// How bright a buffer is: of a sample of its values, as fractions of the largest.
struct Level {
  double mean = 0.0;
  double clipped = 0.0;  // share of values at the upper end
};
Result<Level> MeasureLevel(std::span<const std::byte> bytes, const FrameLayout& layout);

}  // namespace omnihdr::v4l2
