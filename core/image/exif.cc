#include "core/image/exif.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <utility>

namespace omnihdr {
namespace {

enum class TagType : std::uint16_t {
  kByte = 1,
  kAscii = 2,
  kShort = 3,
  kLong = 4,
  kRational = 5,
  kUndefined = 7,
};

void Put(std::vector<std::byte>& out, std::uint64_t value, int bytes) {
  for (int k = 0; k < bytes; ++k) out.push_back(static_cast<std::byte>(value >> (8 * k) & 0xFFU));
}

struct TagValue {
  TagType type = TagType::kByte;
  std::uint32_t count = 0;
  std::vector<std::byte> bytes;  // little-endian
};

TagValue Ascii(const std::string& text) {
  TagValue value{TagType::kAscii, static_cast<std::uint32_t>(text.size() + 1), {}};
  for (const char c : text) {
    value.bytes.push_back(static_cast<std::byte>(c >= ' ' && c <= '~' ? c : '?'));
  }
  value.bytes.push_back(std::byte{0});
  return value;
}

TagValue Bytes(TagType type, const std::vector<std::uint8_t>& values) {
  TagValue value{type, static_cast<std::uint32_t>(values.size()), {}};
  for (const std::uint8_t v : values) value.bytes.push_back(static_cast<std::byte>(v));
  return value;
}

TagValue Short(std::uint16_t number) {
  TagValue value{TagType::kShort, 1, {}};
  Put(value.bytes, number, 2);
  return value;
}

using Fraction = std::pair<std::uint32_t, std::uint32_t>;

TagValue Rationals(const std::vector<Fraction>& fractions) {
  TagValue value{TagType::kRational, static_cast<std::uint32_t>(fractions.size()), {}};
  for (const auto& [numerator, denominator] : fractions) {
    Put(value.bytes, numerator, 4);
    Put(value.bytes, denominator, 4);
  }
  return value;
}

// With as many digits as fit, at most `digits` behind the point.
Fraction Decimal(double number, int digits) {
  double scale = std::pow(10.0, digits);
  while (scale > 1.0 && number * scale > 4e9) scale /= 10.0;
  return {static_cast<std::uint32_t>(std::llround(number * scale)),
          static_cast<std::uint32_t>(std::llround(scale))};
}

// Degrees, minutes and seconds to 1e-5 of a second: a third of a millimetre.
TagValue Angle(double degrees) {
  constexpr std::int64_t kPerSecond = 100'000;
  const std::int64_t whole = std::llround(std::abs(degrees) * 3600.0 * kPerSecond);
  return Rationals({{static_cast<std::uint32_t>(whole / (3600 * kPerSecond)), 1},
                    {static_cast<std::uint32_t>(whole / (60 * kPerSecond) % 60), 1},
                    {static_cast<std::uint32_t>(whole % (60 * kPerSecond)),
                     static_cast<std::uint32_t>(kPerSecond)}});
}

struct Calendar {
  std::string date;  // 2026:01:31
  int hour = 0;
  int minute = 0;
  int second = 0;
  std::int64_t microsecond = 0;
};

Calendar CalendarOf(UtcTime utc) {
  namespace chrono = std::chrono;
  const chrono::sys_time<Nanoseconds> time{Nanoseconds(utc.ns())};
  const auto day = chrono::floor<chrono::days>(time);
  const chrono::year_month_day date(day);
  const chrono::hh_mm_ss clock(chrono::floor<chrono::microseconds>(time - day));
  return {fmt::format("{:04}:{:02}:{:02}", static_cast<int>(date.year()),
                      static_cast<unsigned>(date.month()), static_cast<unsigned>(date.day())),
          static_cast<int>(clock.hours().count()), static_cast<int>(clock.minutes().count()),
          static_cast<int>(clock.seconds().count()), clock.subseconds().count()};
}

using Directory = std::map<std::uint16_t, TagValue>;  // tags ascend, as they must

constexpr std::size_t kEntryBytes = 12;

std::size_t SizeOf(const Directory& directory) {
  std::size_t bytes = 2 + kEntryBytes * directory.size() + 4;
  for (const auto& [tag, value] : directory) {
    if (value.bytes.size() > 4) bytes += (value.bytes.size() + 1) / 2 * 2;
  }
  return bytes;
}

// The directory at `offset` of the TIFF structure, its long values behind it.
void Append(const Directory& directory, std::size_t offset, std::vector<std::byte>& out) {
  std::size_t behind = offset + 2 + kEntryBytes * directory.size() + 4;
  std::vector<std::byte> values;
  Put(out, directory.size(), 2);
  for (const auto& [tag, value] : directory) {
    Put(out, tag, 2);
    Put(out, static_cast<std::uint16_t>(value.type), 2);
    Put(out, value.count, 4);
    if (value.bytes.size() > 4) {
      Put(out, behind + values.size(), 4);
      values.insert(values.end(), value.bytes.begin(), value.bytes.end());
      if (values.size() % 2 != 0) values.push_back(std::byte{0});
    } else {
      std::vector<std::byte> padded = value.bytes;
      padded.resize(4);
      out.insert(out.end(), padded.begin(), padded.end());
    }
  }
  Put(out, 0, 4);
  out.insert(out.end(), values.begin(), values.end());
}

Directory PhotoDirectory(const ExifInfo& info) {
  Directory photo;
  photo[0x9000] = Bytes(TagType::kUndefined, {'0', '2', '3', '2'});
  if (info.exposure_s) {
    const double s = *info.exposure_s;
    // A short one over a numerator of as many digits as the denominator has room for.
    const double numerator = std::clamp(std::floor(4e9 * s), 1.0, 1e6);
    photo[0x829A] =
        Rationals({s < 0.5 ? Fraction{static_cast<std::uint32_t>(numerator),
                                      static_cast<std::uint32_t>(std::llround(numerator / s))}
                           : Decimal(s, 6)});
  }
  if (info.utc) {
    const Calendar at = CalendarOf(*info.utc);
    photo[0x9003] =
        Ascii(fmt::format("{} {:02}:{:02}:{:02}", at.date, at.hour, at.minute, at.second));
    photo[0x9011] = Ascii("+00:00");
    photo[0x9291] = Ascii(fmt::format("{:06}", at.microsecond));
  }
  return photo;
}

Directory PlaceDirectory(const ExifInfo& info) {
  Directory gps;
  gps[0x00] = Bytes(TagType::kByte, {2, 3, 0, 0});
  if (info.bearing_deg) {
    gps[0x10] = Ascii("T");
    gps[0x11] = Rationals({Decimal(*info.bearing_deg, 3)});
  }
  if (!info.place) return gps;
  const ExifPlace& place = *info.place;
  gps[0x01] = Ascii(place.lat_deg < 0.0 ? "S" : "N");
  gps[0x02] = Angle(place.lat_deg);
  gps[0x03] = Ascii(place.lon_deg < 0.0 ? "W" : "E");
  gps[0x04] = Angle(place.lon_deg);
  if (place.alt_m) {
    gps[0x05] = Bytes(TagType::kByte, {static_cast<std::uint8_t>(*place.alt_m < 0.0 ? 1 : 0)});
    gps[0x06] = Rationals({Decimal(std::abs(*place.alt_m), 3)});
  }
  gps[0x12] = Ascii("WGS-84");
  if (place.utc) {
    const Calendar at = CalendarOf(*place.utc);
    gps[0x07] = Rationals(
        {{static_cast<std::uint32_t>(at.hour), 1},
         {static_cast<std::uint32_t>(at.minute), 1},
         {static_cast<std::uint32_t>(at.second * 1'000 + at.microsecond / 1'000), 1'000}});
    gps[0x1D] = Ascii(at.date);
  }
  gps[0x1E] = Short(place.differential ? 1 : 0);
  if (place.error_m) gps[0x1F] = Rationals({Decimal(*place.error_m, 3)});
  return gps;
}

TagValue Offset(std::size_t offset) {
  TagValue value{TagType::kLong, 1, {}};
  Put(value.bytes, offset, 4);
  return value;
}

std::vector<std::byte> Segment(const ExifInfo& info) {
  Directory image;
  if (!info.model.empty()) image[0x0110] = Ascii(info.model.substr(0, 256));
  if (!info.software.empty()) image[0x0131] = Ascii(info.software.substr(0, 256));
  const Directory photo = PhotoDirectory(info);
  const bool has_gps = info.place || info.bearing_deg;
  const Directory gps = has_gps ? PlaceDirectory(info) : Directory();
  image[0x8769] = Offset(0);
  if (has_gps) image[0x8825] = Offset(0);
  constexpr std::size_t kHeader = 8;
  const std::size_t photo_at = kHeader + SizeOf(image);
  const std::size_t gps_at = photo_at + SizeOf(photo);
  image[0x8769] = Offset(photo_at);
  if (has_gps) image[0x8825] = Offset(gps_at);

  std::vector<std::byte> tiff = {std::byte{'I'}, std::byte{'I'}};
  Put(tiff, 42, 2);
  Put(tiff, kHeader, 4);
  Append(image, kHeader, tiff);
  Append(photo, photo_at, tiff);
  if (has_gps) Append(gps, gps_at, tiff);

  const std::size_t length = 2 + 6 + tiff.size();
  std::vector<std::byte> segment = {std::byte{0xFF}, std::byte{0xE1},
                                    static_cast<std::byte>(length >> 8U),
                                    static_cast<std::byte>(length & 0xFFU)};
  for (const char c : {'E', 'x', 'i', 'f', '\0', '\0'}) {
    segment.push_back(static_cast<std::byte>(c));
  }
  segment.insert(segment.end(), tiff.begin(), tiff.end());
  return segment;
}

std::string WhyNot(const ExifInfo& info) {
  const auto out = [](double value, double low, double high) {
    return !(value >= low && value <= high);
  };
  if (info.place) {
    const ExifPlace& place = *info.place;
    if (out(place.lat_deg, -90, 90)) return fmt::format("latitude {}", place.lat_deg);
    if (out(place.lon_deg, -180, 180)) return fmt::format("longitude {}", place.lon_deg);
    if (place.alt_m && out(*place.alt_m, -1e7, 1e7)) {
      return fmt::format("altitude {}", *place.alt_m);
    }
    if (place.error_m && out(*place.error_m, 0, 1e9)) {
      return fmt::format("error {}", *place.error_m);
    }
  }
  if (info.bearing_deg && out(*info.bearing_deg, 0, 360)) {
    return fmt::format("bearing {}", *info.bearing_deg);
  }
  if (info.exposure_s && out(*info.exposure_s, 1e-9, 1e5)) {
    return fmt::format("exposure {} s", *info.exposure_s);
  }
  return "";
}

}  // namespace

Result<std::vector<std::byte>> WithExif(std::vector<std::byte> jpeg, const ExifInfo& info) {
  if (const std::string wrong = WhyNot(info); !wrong.empty()) {
    return Fail(ErrorKind::kSoftware, "EXIF: {}: out of range", wrong);
  }
  if (jpeg.size() < 4 || jpeg[0] != std::byte{0xFF} || jpeg[1] != std::byte{0xD8}) {
    return Fail(ErrorKind::kSoftware, "EXIF: {} bytes that are no JPEG", jpeg.size());
  }
  std::size_t where = 2;
  if (jpeg.size() > 6 && jpeg[2] == std::byte{0xFF} && jpeg[3] == std::byte{0xE0}) {
    where +=
        2 + (std::to_integer<std::size_t>(jpeg[4]) << 8U | std::to_integer<std::size_t>(jpeg[5]));
  }
  if (where > jpeg.size()) where = 2;
  const std::vector<std::byte> segment = Segment(info);
  jpeg.insert(jpeg.begin() + static_cast<std::ptrdiff_t>(where), segment.begin(), segment.end());
  return jpeg;
}

}  // namespace omnihdr
