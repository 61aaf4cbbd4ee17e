#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <optional>
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
Result<std::vector<std::byte>> EncodeTiff(ImageView<const std::uint8_t> image);
Result<std::vector<std::byte>> EncodeTiff(ImageView<const std::uint16_t> image);
// Where an equirectangular picture lies on the sphere, for viewers of 360° photos: Google's Photo
// Sphere XMP metadata (GPano). Other projections have no viewers and must not be labelled so.
struct PhotoSphere {
  int full_width = 0;  // of the whole sphere at the picture's scale: twice the height
  int full_height = 0;
  int left = 0;  // the picture's place in it
  int top = 0;
  // Of the whole sphere's centre: compass bearing, clockwise from north in [0, 360); degrees above
  // the horizon in [-90, 90]; clockwise roll in [-180, 180]. Empty: not known, not written.
  std::optional<double> heading_deg = std::nullopt;
  std::optional<double> pitch_deg = std::nullopt;
  std::optional<double> roll_deg = std::nullopt;
};

// sRGB JPEG, `quality` 1..100. When `panorama` is set, the picture is labelled as a whole sphere.
Result<std::vector<std::byte>> EncodeJpeg(ImageView<const std::uint8_t> image, int quality,
                                          bool panorama = false);
// The same with the picture's place on the sphere; a place that does not hold the picture, and
// angles out of range, are errors (kSoftware).
Result<std::vector<std::byte>> EncodeJpeg(ImageView<const std::uint8_t> image, int quality,
                                          const PhotoSphere& sphere);

}  // namespace omnihdr
