#include "core/image/exif.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <map>
#include <optional>
#include <string>
#include <vector>

#include "core/image/image_io.h"

namespace omnihdr::exif_test {
namespace {

using ::testing::Contains;
using ::testing::HasSubstr;
using ::testing::Key;
using ::testing::Not;

// A reader by the standard's text, as simple as can be: tags of the three directories.
struct Tag {
  int type = 0;
  std::uint32_t count = 0;
  std::vector<std::byte> bytes;
  std::string Text() const {
    return {reinterpret_cast<const char*>(bytes.data()), bytes.empty() ? 0 : bytes.size() - 1};
  }
  std::uint32_t Long(std::size_t at = 0) const {
    std::uint32_t value = 0;
    for (std::size_t k = 4; k-- > 0;)
      value = value << 8U | std::to_integer<unsigned>(bytes.at(at + k));
    return value;
  }
  double Ratio(std::size_t index = 0) const {
    return static_cast<double>(Long(8 * index)) / Long(8 * index + 4);
  }
};
using Tags = std::map<int, Tag>;

struct Read {
  Tags image;
  Tags photo;
  Tags gps;
};

std::size_t Number(const std::vector<std::byte>& bytes, std::size_t at, int size) {
  std::size_t value = 0;
  for (int k = size; k-- > 0;) {
    value = value << 8U | std::to_integer<unsigned>(bytes.at(at + static_cast<std::size_t>(k)));
  }
  return value;
}

Tags ReadDirectory(const std::vector<std::byte>& tiff, std::size_t at) {
  static constexpr std::array<std::size_t, 8> kSizes = {0, 1, 1, 2, 4, 8, 1, 1};
  Tags tags;
  int last = -1;
  const std::size_t count = Number(tiff, at, 2);
  for (std::size_t k = 0; k < count; ++k) {
    const std::size_t entry = at + 2 + 12 * k;
    const int tag = static_cast<int>(Number(tiff, entry, 2));
    EXPECT_GT(tag, last) << "tags ascend";
    last = tag;
    Tag read;
    read.type = static_cast<int>(Number(tiff, entry + 2, 2));
    read.count = static_cast<std::uint32_t>(Number(tiff, entry + 4, 4));
    const std::size_t size = kSizes.at(static_cast<std::size_t>(read.type)) * read.count;
    const std::size_t where = size > 4 ? Number(tiff, entry + 8, 4) : entry + 8;
    EXPECT_LE(where + size, tiff.size());
    EXPECT_EQ(where % 2, 0U);
    read.bytes.assign(tiff.begin() + static_cast<std::ptrdiff_t>(where),
                      tiff.begin() + static_cast<std::ptrdiff_t>(where + size));
    tags[tag] = read;
  }
  EXPECT_EQ(Number(tiff, at + 2 + 12 * count, 4), 0U) << "no further picture";
  return tags;
}

std::optional<Read> ReadExif(const std::vector<std::byte>& jpeg) {
  static constexpr char kName[] = "Exif\0";
  const auto* text = reinterpret_cast<const char*>(jpeg.data());
  const char* end = text + jpeg.size();
  const char* found = std::search(text, end, kName, kName + 6);
  if (found == end) return std::nullopt;
  const auto begin = static_cast<std::size_t>(found - text);
  const std::size_t length = std::to_integer<std::size_t>(jpeg[begin - 2]) << 8U |
                             std::to_integer<std::size_t>(jpeg[begin - 1]);
  EXPECT_EQ(jpeg[begin - 4], std::byte{0xFF});
  EXPECT_EQ(jpeg[begin - 3], std::byte{0xE1});
  const std::vector<std::byte> tiff(jpeg.begin() + static_cast<std::ptrdiff_t>(begin + 6),
                                    jpeg.begin() + static_cast<std::ptrdiff_t>(begin - 2 + length));
  EXPECT_EQ(Number(tiff, 0, 2), 0x4949U);
  EXPECT_EQ(Number(tiff, 2, 2), 42U);
  Read read;
  read.image = ReadDirectory(tiff, Number(tiff, 4, 4));
  read.photo = ReadDirectory(tiff, read.image.at(0x8769).Long());
  if (read.image.contains(0x8825)) read.gps = ReadDirectory(tiff, read.image.at(0x8825).Long());
  return read;
}

std::vector<std::byte> Jpeg() {
  const Image<std::uint8_t> image(32, 16, 3);
  return EncodeJpeg(image.view(), 90, true).value();
}

Read Written(const ExifInfo& info) {
  const auto jpeg = WithExif(Jpeg(), info);
  EXPECT_TRUE(jpeg) << jpeg.error().message;
  const std::optional<Read> read = ReadExif(*jpeg);
  EXPECT_TRUE(read);
  return read.value_or(Read{});
}

double Degrees(const Tag& tag) {
  return tag.Ratio(0) + tag.Ratio(1) / 60.0 + tag.Ratio(2) / 3600.0;
}

// 2026-07-01T12:34:56.789012345Z
const UtcTime kUtc = UtcTime::FromNanoseconds(1'782'909'296'789'012'345);

TEST(Exif, TheTimeIsUtcToTheMicrosecondAndSaysSo) {
  ExifInfo info;
  info.utc = kUtc;
  const Read read = Written(info);
  EXPECT_EQ(read.photo.at(0x9003).Text(), "2026:07:01 12:34:56");
  EXPECT_EQ(read.photo.at(0x9291).Text(), "789012");
  EXPECT_EQ(read.photo.at(0x9011).Text(), "+00:00");
}

TEST(Exif, APlaceIsReadBackToAMillimetre) {
  for (const double lat : {45.42153612, -0.00000001, -33.856784, 89.999999999, 0.0}) {
    for (const double lon : {-75.69719412, 151.215297, -179.9999999, 180.0}) {
      ExifInfo info;
      info.place = ExifPlace{lat, lon, -12.345, 0.02, kUtc, true};
      const Read read = Written(info);
      const double sign_lat = read.gps.at(1).Text() == "N" ? 1.0 : -1.0;
      const double sign_lon = read.gps.at(3).Text() == "E" ? 1.0 : -1.0;
      EXPECT_NEAR(sign_lat * Degrees(read.gps.at(2)), lat, 5e-9);
      EXPECT_NEAR(sign_lon * Degrees(read.gps.at(4)), lon, 5e-9);
      EXPECT_LT(read.gps.at(2).Ratio(2), 60.0);
      EXPECT_EQ(read.gps.at(5).bytes[0], std::byte{1}) << "below sea level";
      EXPECT_NEAR(read.gps.at(6).Ratio(), 12.345, 1e-9);
      EXPECT_EQ(read.gps.at(0x1D).Text(), "2026:07:01");
      EXPECT_NEAR(read.gps.at(7).Ratio(2), 56.789, 1e-9);
      EXPECT_EQ(read.gps.at(0x1E).bytes[0], std::byte{1});
      EXPECT_NEAR(read.gps.at(0x1F).Ratio(), 0.02, 1e-9);
    }
  }
}

TEST(Exif, WhatIsNotKnownIsLeftOut) {
  const Read bare = Written({});
  EXPECT_THAT(bare.image, Not(Contains(Key(0x8825))));
  EXPECT_THAT(bare.photo, Not(Contains(Key(0x9003))));
  EXPECT_THAT(bare.photo, Not(Contains(Key(0x829A))));
  ExifInfo bearing;
  bearing.bearing_deg = 271.25;
  const Read turned = Written(bearing);
  EXPECT_THAT(turned.gps, Not(Contains(Key(2))));
  EXPECT_EQ(turned.gps.at(0x10).Text(), "T");
  EXPECT_NEAR(turned.gps.at(0x11).Ratio(), 271.25, 1e-9);
  ExifInfo flat;
  flat.place = ExifPlace{1.0, 2.0};
  EXPECT_THAT(Written(flat).gps, Not(Contains(Key(6))));
}

TEST(Exif, ExposuresAreReadBackFromNanosecondsToHours) {
  for (const double seconds : {1e-9, 2.5e-5, 0.001, 1.0 / 250.0, 1.0 / 3.0, 0.7, 4.0, 7200.0}) {
    ExifInfo info;
    info.exposure_s = seconds;
    EXPECT_NEAR(Written(info).photo.at(0x829A).Ratio() / seconds, 1.0, 1e-6) << seconds;
  }
}

TEST(Exif, TextIsAsciiAndThePictureStaysReadable) {
  ExifInfo info;
  info.model = "Caméra 5";
  info.software = "omnihdr";
  const Read read = Written(info);
  EXPECT_EQ(read.image.at(0x0110).Text(), "Cam??ra 5");
  EXPECT_EQ(read.image.at(0x0131).Text(), "omnihdr");
  const auto jpeg = WithExif(Jpeg(), info).value();
  const auto image = DecodeImage(jpeg, "preview.jpg");
  ASSERT_TRUE(image) << image.error().message;
  EXPECT_EQ(image->width(), 32);
  // JFIF first, then EXIF, then the panorama's XMP.
  const std::string text(reinterpret_cast<const char*>(jpeg.data()), jpeg.size());
  EXPECT_LT(text.find("JFIF"), text.find("Exif"));
  EXPECT_LT(text.find("Exif"), text.find("GPano"));
}

TEST(Exif, WhatCannotBeSaidIsAnError) {
  ExifInfo info;
  info.place = ExifPlace{91.0, 0.0};
  auto written = WithExif(Jpeg(), info);
  ASSERT_FALSE(written);
  EXPECT_THAT(written.error().message, HasSubstr("latitude 91"));
  info.place.reset();
  info.exposure_s = -1.0;
  EXPECT_FALSE(WithExif(Jpeg(), info));
  EXPECT_FALSE(WithExif({}, {}));
}

}  // namespace
}  // namespace omnihdr::exif_test
