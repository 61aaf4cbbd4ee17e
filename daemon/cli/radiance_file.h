#pragma once

#include <cstdint>
#include <string>

#include "core/base/result.h"
#include "core/image/exr.h"
#include "core/image/image.h"

namespace omnihdr {

// A radiance map as the commands write it beside the views of sessions: channels R, G and B, the
// mask channel "origin" (PixelOrigin, explained in the file), and a disparity where there is one.
// Pictures are borrowed, all of one size.
struct RadianceFile {
  const Image<float>* radiance = nullptr;       // W×H×3
  const Image<std::uint8_t>* origin = nullptr;  // W×H
  const Image<float>* disparity = nullptr;      // W×H, or null
  ExrPixelType type = ExrPixelType::kHalf;      // of the radiance
  ExrAttributes attributes;                     // software, primaries and the like are added
};
Status WriteRadianceFile(const std::string& file, const RadianceFile& content);

}  // namespace omnihdr
