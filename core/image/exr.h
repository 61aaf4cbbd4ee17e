#pragma once

#include <array>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"

namespace omnihdr {

enum class ExrCompression { kNone, kZips, kZip, kPiz };
// kUint: whole numbers, for labels; written from float, which holds them exactly up to 2^24.
enum class ExrPixelType { kHalf, kFloat, kUint };
// OpenEXR's standard attribute `envmap`: how a picture shows all directions.
enum class ExrEnvmap { kNone, kLatLong, kCube };

// Which of them a picture needs: kFloat when a finite value exceeds what half holds (65504), else
// kHalf.
ExrPixelType SmallestType(ImageView<const float> pixels);

// One named channel of an EXR file: a single-channel view and how it is stored.
struct ExrChannel {
  std::string name;
  ImageView<const float>
      pixels;  // channel 0 of the view is written; its other channels are skipped
  ExrPixelType type = ExrPixelType::kHalf;
  int channel = 0;  // which interleaved channel of `pixels`
};

// CIE 1931 (x, y) of red, green, blue and white, in this order.
using Chromaticities = std::array<double, 8>;
// ITU-R BT.709-6, table 1.3; white is D65.
inline constexpr Chromaticities kRec709 = {0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290};
// Why these are no primaries of a colour space, empty when they are: values in [-1, 2], y of white
// above 0, white strictly inside the triangle of the primaries.
std::string WhyNotChromaticities(const Chromaticities& chromaticities);

struct ExrAttributes {
  ExrEnvmap envmap = ExrEnvmap::kLatLong;
  std::map<std::string, std::string> strings;  // extra string attributes
  std::map<std::string, double> floats;        // extra float attributes (expTime, ...)
  std::optional<Chromaticities> chromaticities = std::nullopt;
};

// Writes `path` in place, not atomically and not synced: the view writer does both for a directory.
// Values that overflow half (> 65504) are an error of the caller and are clamped; NaN is kept.
Status WriteExr(const std::filesystem::path& path, const std::vector<ExrChannel>& channels,
                const ExrAttributes& attributes,
                ExrCompression compression = ExrCompression::kZips);

// The same by way of a file beside it: the path holds the old file or the whole new one.
Status WriteExrAtomic(const std::filesystem::path& path, const std::vector<ExrChannel>& channels,
                      const ExrAttributes& attributes,
                      ExrCompression compression = ExrCompression::kZips);

// All channels of a scan-line or tiled EXR as float. The file is untrusted: sizes are checked
// before anything is allocated, and every failure is an error naming the path.
struct ExrImage {
  int width = 0;
  int height = 0;
  std::map<std::string, Image<float>> channels;
  std::map<std::string, ExrPixelType> types;  // of the same channels, as stored
  // String, float, envmap and chromaticities attributes, so that WriteExr gives them back; without
  // those that describe the file's own form.
  ExrAttributes attributes;
};
Result<ExrImage> ReadExr(const std::filesystem::path& path);

}  // namespace omnihdr
