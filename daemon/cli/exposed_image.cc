#include "daemon/cli/exposed_image.h"

#include <charconv>
#include <cmath>
#include <string_view>
#include <variant>

#include "core/image/image_io.h"

namespace omnihdr {

std::optional<ExposureTime> ParseSeconds(std::string_view text) {
  const auto number = [](std::string_view part, double* value) {
    const auto [end, error] = std::from_chars(part.data(), part.data() + part.size(), *value);
    return error == std::errc{} && end == part.data() + part.size() && std::isfinite(*value) &&
           *value > 0.0;
  };
  const std::size_t slash = text.find('/');
  double numerator = 0.0;
  double denominator = 1.0;
  if (!number(text.substr(0, slash), &numerator)) return std::nullopt;
  if (slash != std::string_view::npos && !number(text.substr(slash + 1), &denominator)) {
    return std::nullopt;
  }
  const ExposureTime time = ExposureTime::Seconds(numerator / denominator);
  if (!time.IsValid()) return std::nullopt;
  return time;
}

Result<ExposedImageName> ParseExposedImage(const std::string& text) {
  const std::size_t at = text.rfind('@');
  if (at != std::string::npos && at != 0) {
    const auto time = ParseSeconds(std::string_view(text).substr(at + 1));
    if (time) return ExposedImageName{text.substr(0, at), *time};
  }
  return Fail(ErrorKind::kUsage,
              "{}: expected IMAGE@SECONDS with SECONDS > 0, as in a.png@0.5 or "
              "a.png@1/60",
              text);
}

Result<Image<std::uint8_t>> LoadPictureMask(const std::string& file, int width, int height) {
  OMNIHDR_ASSIGN(const DecodedImage decoded, ReadImage(file));
  if (decoded.is_16_bit() || decoded.width() != width || decoded.height() != height) {
    return Fail(ErrorKind::kData,
                "{}: {}x{} of {} bits, expected an 8-bit picture of the images' size {}x{}", file,
                decoded.width(), decoded.height(), decoded.is_16_bit() ? 16 : 8, width, height);
  }
  const auto& pixels = std::get<Image<std::uint8_t>>(decoded.pixels);
  Image<std::uint8_t> mask(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) mask.at(x, y) = pixels.pixel(x, y)[0];
  }
  return mask;
}

}  // namespace omnihdr
