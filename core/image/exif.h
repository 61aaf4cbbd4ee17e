#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"

namespace omnihdr {

// Where a picture was taken, as a satellite receiver said.
struct ExifPlace {
  double lat_deg = 0.0;                          // [-90, 90], north positive, WGS 84
  double lon_deg = 0.0;                          // [-180, 180], east positive
  std::optional<double> alt_m = std::nullopt;    // above sea level
  std::optional<double> error_m = std::nullopt;  // horizontal
  std::optional<UtcTime> utc = std::nullopt;     // of the fix
  bool differential = false;
};

// What a picture's EXIF data (CIPA DC-008, version 2.32) say. What is not known is left out, so
// that a picture without a fix has no place.
struct ExifInfo {
  // DateTimeOriginal with SubSecTimeOriginal to the microsecond and OffsetTimeOriginal +00:00.
  std::optional<UtcTime> utc;
  std::optional<ExifPlace> place;
  std::optional<double>
      bearing_deg;  // of the picture's middle, clockwise from true north, [0, 360)
  std::optional<double> exposure_s;
  std::string model;  // ASCII; other characters become '?'
  std::string software;
};

// `jpeg` with the data as an APP1 segment behind JFIF's, in front of all others. Errors
// (kSoftware): no JPEG, or a value out of range.
Result<std::vector<std::byte>> WithExif(std::vector<std::byte> jpeg, const ExifInfo& info);

}  // namespace omnihdr
