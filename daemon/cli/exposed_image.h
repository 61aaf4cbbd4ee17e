#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>

#include "core/base/result.h"
#include "core/base/units.h"
#include "core/image/image.h"

namespace omnihdr {

// A picture on the command line and how long it was exposed.
struct ExposedImageName {
  std::string file;
  ExposureTime time;
};

// A decimal number or a fraction (1/60), above 0; nothing for any other text.
std::optional<ExposureTime> ParseSeconds(std::string_view text);

// IMAGE@SECONDS, where SECONDS is a decimal number or a fraction (1/60). kUsage error otherwise.
Result<ExposedImageName> ParseExposedImage(const std::string& text);

// A mask for pictures of this size: W×H×1, under 128 = do not use. Errors: not an 8-bit picture of
// that size.
Result<Image<std::uint8_t>> LoadPictureMask(const std::string& file, int width, int height);

}  // namespace omnihdr
