#pragma once

#include <filesystem>
#include <map>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"

namespace omnihdr {

enum class ExrCompression { kNone, kZips, kZip, kPiz };
enum class ExrPixelType { kHalf, kFloat };

// One named channel of an EXR file: a single-channel view and how it is stored.
struct ExrChannel {
  std::string name;
  ImageView<const float>
      pixels;  // channel 0 of the view is written; its other channels are skipped
  ExrPixelType type = ExrPixelType::kHalf;
  int channel = 0;  // which interleaved channel of `pixels`
};

struct ExrAttributes {
  bool latlong = true;                         // envmap = latlong
  std::map<std::string, std::string> strings;  // extra string attributes
  std::map<std::string, double> floats;        // extra float attributes (expTime, ...)
};

// Writes `path` in place, not atomically and not synced: the view writer does both for a directory.
// Values that overflow half (> 65504) are an error of the caller and are clamped; NaN is kept.
Status WriteExr(const std::filesystem::path& path, const std::vector<ExrChannel>& channels,
                const ExrAttributes& attributes,
                ExrCompression compression = ExrCompression::kZips);

// All channels of a scan-line or tiled EXR as float. The file is untrusted: sizes are checked
// before anything is allocated, and every failure is an error naming the path.
struct ExrImage {
  int width = 0;
  int height = 0;
  std::map<std::string, Image<float>> channels;
  std::map<std::string, std::string> strings;
};
Result<ExrImage> ReadExr(const std::filesystem::path& path);

}  // namespace omnihdr
