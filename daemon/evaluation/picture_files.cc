#include "daemon/evaluation/picture_files.h"

#include <algorithm>
#include <array>
#include <cstddef>
#include <fstream>
#include <limits>
#include <system_error>
#include <utility>
#include <variant>

#include "core/image/image_io.h"
#include "core/stereo/view_merge.h"

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

bool IsExr(const fs::path& path) {
  constexpr std::array<char, 4> kMagic = {0x76, 0x2F, 0x31, 0x01};
  std::array<char, 4> start{};
  std::ifstream file(path, std::ios::binary);
  return file.read(start.data(), start.size()) && start == kMagic;
}

template <typename T>
Image<float> AsThreeChannels(const Image<T>& image) {
  Image<float> out(image.width(), image.height(), 3);
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      for (int c = 0; c < 3; ++c) {
        out.pixel(x, y)[c] = static_cast<float>(image.pixel(x, y)[image.channels() == 3 ? c : 0]);
      }
    }
  }
  return out;
}

}  // namespace

Result<Image<float>> RadianceOf(const ExrImage& exr, const std::string& name) {
  std::array<const Image<float>*, 3> channels{};
  const bool is_grey = exr.channels.count("Y") != 0 && exr.channels.count("R") == 0;
  constexpr std::array<const char*, 3> kNames = {"R", "G", "B"};
  for (std::size_t c = 0; c < 3; ++c) {
    const auto found = exr.channels.find(is_grey ? "Y" : kNames[c]);
    if (found == exr.channels.end()) {
      std::string have;
      for (const auto& [channel, pixels] : exr.channels) {
        have += (have.empty() ? "" : ", ") + channel;
      }
      return Fail(ErrorKind::kData, "{}: no channel {}, expected R, G and B, or Y; has {}", name,
                  kNames[c], have.empty() ? "none" : have);
    }
    channels[c] = &found->second;
  }
  constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
  const auto origin = exr.channels.find("origin");
  Image<float> radiance(exr.width, exr.height, 3);
  for (int y = 0; y < exr.height; ++y) {
    for (int x = 0; x < exr.width; ++x) {
      const bool has_data = origin == exr.channels.end() ||
                            origin->second.at(x, y) != static_cast<float>(PixelOrigin::kNoData);
      for (std::size_t c = 0; c < 3; ++c) {
        radiance.pixel(x, y)[c] = has_data ? channels[c]->at(x, y) : kNan;
      }
    }
  }
  return radiance;
}

Result<Picture> LoadPicture(const fs::path& path) {
  std::error_code error;
  const fs::path file = fs::is_directory(path, error) ? path / "radiance.exr" : path;
  Picture picture;
  picture.name = file.string();
  if (IsExr(file)) {
    OMNIHDR_ASSIGN(const ExrImage exr, ReadExr(file));
    OMNIHDR_ASSIGN(picture.pixels, RadianceOf(exr, picture.name));
    return picture;
  }
  Result<DecodedImage> decoded = ReadImage(file);
  if (!decoded && decoded.error().message.ends_with("TIFF file")) {
    decoded.error().message += ", nor an EXR";
  }
  if (!decoded) return Forward(std::move(decoded).error());
  picture.is_radiance = false;
  picture.peak = decoded->is_16_bit() ? 65535.0 : 255.0;
  picture.pixels =
      std::visit([](const auto& pixels) { return AsThreeChannels(pixels); }, decoded->pixels);
  return picture;
}

Result<Image<std::uint8_t>> LoadMask(const fs::path& path, int width, int height) {
  OMNIHDR_ASSIGN(const DecodedImage decoded, ReadImage(path));
  if (decoded.is_16_bit() || decoded.width() != width || decoded.height() != height) {
    return Fail(ErrorKind::kData, "{}: {}x{}, {} bits, expected an 8-bit picture of {}x{}",
                path.string(), decoded.width(), decoded.height(), decoded.is_16_bit() ? 16 : 8,
                width, height);
  }
  const auto& pixels = std::get<Image<std::uint8_t>>(decoded.pixels);
  Image<std::uint8_t> mask(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) mask.at(x, y) = pixels.pixel(x, y)[0] >= 128 ? 1 : 0;
  }
  return mask;
}

}  // namespace omnihdr
