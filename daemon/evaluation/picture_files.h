#pragma once

#include <filesystem>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/image/exr.h"
#include "core/image/image.h"

namespace omnihdr {

// A picture of any kind a person may name: an EXR, a PNG, JPEG or TIFF, or the directory of a view
// (its radiance.exr).
struct Picture {
  std::string name;         // the file read
  Image<float> pixels;      // W×H×3: linear radiance, or code values 0..peak
  bool is_radiance = true;  // linear, from an EXR
  double peak = 0.0;        // of code values: 255 or 65535
  // A whole sphere in equirectangular projection has twice as many columns as rows.
  bool looks_lat_long() const { return pixels.width() == 2 * pixels.height(); }
};
// An EXR must have channels R, G and B, or Y alone. Grey pictures get three equal channels.
Result<Picture> LoadPicture(const std::filesystem::path& path);

// R, G, B (or Y three times) of an EXR as W×H×3; an error names the channels there are.
Result<Image<float>> RadianceOf(const ExrImage& exr, const std::string& name);

// White = 1, black = 0, from an 8-bit picture of the size given.
Result<Image<std::uint8_t>> LoadMask(const std::filesystem::path& path, int width, int height);

}  // namespace omnihdr
