#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <utility>
#include <variant>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"

namespace omnihdr {

// Pixels as a file holds them: 8 or 16 bits, 1 (grey, Bayer) or 3 (RGB order) channels.
struct DecodedImage {
  std::variant<Image<std::uint8_t>, Image<std::uint16_t>> pixels;
  int width() const;
  int height() const;
  int channels() const;
  bool is_16_bit() const { return pixels.index() == 1; }
};

// Largest image a decoder accepts, in pixels: a hostile header cannot make us allocate more.
inline constexpr std::size_t kMaxImagePixels = std::size_t{1} << 28;

// Reads PNG, TIFF or JPEG by content; EXIF orientation is ignored, alpha dropped, palette expanded.
// Errors name the path. A truncated PNG or JPEG is an error, not a half-grey picture.
Result<DecodedImage> ReadImage(const std::filesystem::path& path);
// The same from memory; `name` is for the error message.
Result<DecodedImage> DecodeImage(std::span<const std::byte> bytes, const std::string& name);

// Encodes 8- or 16-bit images (1 or 3 channels, RGB). `compression` 0..9 as zlib's.
Result<std::vector<std::byte>> EncodePng(ImageView<const std::uint8_t> image, int compression = 1);
Result<std::vector<std::byte>> EncodePng(ImageView<const std::uint16_t> image, int compression = 1);
// sRGB JPEG, `quality` 1..100. When `panorama` is set, GPano XMP is added so that viewers open the
// picture as a full 360x180 degree photo.
Result<std::vector<std::byte>> EncodeJpeg(ImageView<const std::uint8_t> image, int quality,
                                          bool panorama = false);

}  // namespace omnihdr
