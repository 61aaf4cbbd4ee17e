#include "core/image/image_io.h"

#include <gtest/gtest.h>
#include <zlib.h>

#include <array>
#include <cmath>
#include <cstring>
#include <fstream>
#include <opencv2/core.hpp>
#include <opencv2/imgcodecs.hpp>
#include <random>
#include <string>
#include <string_view>

#include "tests/support/temporary_directory.h"

namespace omnihdr::image_io_test {
namespace {

using Bytes = std::vector<std::byte>;

template <typename T>
Image<T> RandomImage(int width, int height, int channels) {
  std::mt19937 generator(7);
  std::uniform_int_distribution<unsigned> value(0, std::numeric_limits<T>::max());
  Image<T> image(width, height, channels);
  for (T& v : image.values()) v = static_cast<T>(value(generator));
  return image;
}

template <typename T>
const Image<T>& Pixels(const DecodedImage& image) {
  return std::get<Image<T>>(image.pixels);
}

template <typename T>
void ExpectSamePixels(const Image<T>& a, const Image<T>& b) {
  ASSERT_EQ(a.width(), b.width());
  ASSERT_EQ(a.height(), b.height());
  ASSERT_EQ(a.channels(), b.channels());
  EXPECT_EQ(std::memcmp(a.data(), b.data(), a.size() * sizeof(T)), 0);
}

// Writers of files as any other program could have made them.
class FileBuilder {
 public:
  FileBuilder& Raw(std::string_view text) {
    for (const char c : text) bytes_.push_back(static_cast<std::byte>(c));
    return *this;
  }
  FileBuilder& Number(std::uint64_t value, int size, bool big_endian) {
    for (int k = 0; k < size; ++k) {
      const int shift = 8 * (big_endian ? size - 1 - k : k);
      bytes_.push_back(static_cast<std::byte>(value >> shift));
    }
    return *this;
  }
  Bytes bytes() const { return bytes_; }
  std::size_t size() const { return bytes_.size(); }

 private:
  Bytes bytes_;
};

std::string BigEndian32(std::uint32_t v) {
  return {static_cast<char>(v >> 24U), static_cast<char>(v >> 16U), static_cast<char>(v >> 8U),
          static_cast<char>(v)};
}

std::string PngChunk(const std::string& type, const std::string& data) {
  const std::string body = type + data;
  const auto crc =
      crc32(0, reinterpret_cast<const Bytef*>(body.data()), static_cast<uInt>(body.size()));
  return BigEndian32(static_cast<std::uint32_t>(data.size())) + body +
         BigEndian32(static_cast<std::uint32_t>(crc));
}

// A PNG of any kind: `rows` are the filtered scan lines, `extra` chunks between IHDR and IDAT.
Bytes BuildPng(std::uint32_t width, std::uint32_t height, int bits, int colour_type,
               const std::string& rows, const std::string& extra = "") {
  std::string compressed(compressBound(static_cast<uLong>(rows.size())), '\0');
  auto size = static_cast<uLongf>(compressed.size());
  compress(reinterpret_cast<Bytef*>(compressed.data()), &size,
           reinterpret_cast<const Bytef*>(rows.data()), static_cast<uLong>(rows.size()));
  compressed.resize(size);
  const std::string header = BigEndian32(width) + BigEndian32(height) +
                             std::string{static_cast<char>(bits), static_cast<char>(colour_type)} +
                             std::string(3, '\0');
  FileBuilder file;
  file.Raw(std::string_view("\x89PNG\r\n\x1A\n", 8));
  file.Raw(PngChunk("IHDR", header)).Raw(extra).Raw(PngChunk("IDAT", compressed));
  file.Raw(PngChunk("IEND", ""));
  return file.bytes();
}

// An uncompressed TIFF with one strip; `width` and `height` may lie about it.
template <typename T>
Bytes BuildTiff(const Image<T>& image, bool big_endian, std::uint32_t width, std::uint32_t height) {
  const auto channels = static_cast<std::uint32_t>(image.channels());
  FileBuilder f;
  f.Raw(big_endian ? "MM" : "II").Number(42, 2, big_endian).Number(8, 4, big_endian);
  constexpr int kEntries = 9;
  const std::uint32_t bits_at = 8 + 2 + 12 * kEntries + 4;
  const std::uint32_t pixels_at = bits_at + 6;
  f.Number(kEntries, 2, big_endian);
  const auto entry = [&](int tag, int type, std::uint32_t count, std::uint32_t value) {
    f.Number(static_cast<unsigned>(tag), 2, big_endian)
        .Number(static_cast<unsigned>(type), 2, big_endian)
        .Number(count, 4, big_endian);
    if (type == 3 && count == 1) {
      f.Number(value, 2, big_endian).Number(0, 2, big_endian);
    } else {
      f.Number(value, 4, big_endian);
    }
  };
  entry(256, 4, 1, width);
  entry(257, 4, 1, height);
  entry(258, 3, channels, channels == 1 ? 8 * sizeof(T) : bits_at);
  entry(259, 3, 1, 1);                      // no compression
  entry(262, 3, 1, channels == 1 ? 1 : 2);  // black is zero / RGB
  entry(273, 4, 1, pixels_at);              // strip offset
  entry(277, 3, 1, channels);
  entry(278, 4, 1, height);  // rows per strip
  entry(279, 4, 1, static_cast<std::uint32_t>(image.size() * sizeof(T)));
  f.Number(0, 4, big_endian);  // no further directory
  for (int k = 0; k < 3; ++k) f.Number(8 * sizeof(T), 2, big_endian);
  for (const T v : image.values()) f.Number(v, sizeof(T), big_endian);
  return f.bytes();
}

template <typename T>
Bytes BuildTiff(const Image<T>& image, bool big_endian) {
  return BuildTiff(image, big_endian, static_cast<std::uint32_t>(image.width()),
                   static_cast<std::uint32_t>(image.height()));
}

template <typename T>
class EveryDepth : public ::testing::Test {};
using Depths = ::testing::Types<std::uint8_t, std::uint16_t>;
TYPED_TEST_SUITE(EveryDepth, Depths);

TYPED_TEST(EveryDepth, APngRoundTripKeepsEveryBitOfGreyAndRgb) {
  for (const int channels : {1, 3}) {
    for (const int compression : {0, 1, 9}) {
      const Image<TypeParam> image = RandomImage<TypeParam>(37, 23, channels);
      const Result<Bytes> png = EncodePng(image.view(), compression);
      ASSERT_TRUE(png) << png.error().message;
      const Result<DecodedImage> back = DecodeImage(*png, "test.png");
      ASSERT_TRUE(back) << back.error().message;
      EXPECT_EQ(back->is_16_bit(), sizeof(TypeParam) == 2);
      EXPECT_EQ(back->channels(), channels);
      ExpectSamePixels(Pixels<TypeParam>(*back), image);
    }
  }
}

TYPED_TEST(EveryDepth, APngOfACropHoldsTheCropAlone) {
  const Image<TypeParam> image = RandomImage<TypeParam>(20, 10, 3);
  const Result<Bytes> png = EncodePng(image.view().Crop(3, 2, 9, 5));
  ASSERT_TRUE(png);
  const Result<DecodedImage> back = DecodeImage(*png, "crop.png");
  ASSERT_TRUE(back);
  ASSERT_EQ(back->width(), 9);
  ASSERT_EQ(back->height(), 5);
  EXPECT_EQ(Pixels<TypeParam>(*back).at(0, 0, 1), image.at(3, 2, 1));
  EXPECT_EQ(Pixels<TypeParam>(*back).at(8, 4, 2), image.at(11, 6, 2));
}

TYPED_TEST(EveryDepth, ATiffOfEitherByteOrderReadsAsItWasWritten) {
  for (const int channels : {1, 3}) {
    for (const bool big_endian : {false, true}) {
      const Image<TypeParam> image = RandomImage<TypeParam>(19, 11, channels);
      const Result<DecodedImage> back = DecodeImage(BuildTiff(image, big_endian), "test.tiff");
      ASSERT_TRUE(back) << back.error().message;
      ASSERT_EQ(back->is_16_bit(), sizeof(TypeParam) == 2);
      ExpectSamePixels(Pixels<TypeParam>(*back), image);
    }
  }
}

TEST(DecodeImage, RgbOrderIsRedFirst) {
  // One red, one green, one blue pixel, filter byte first.
  const Bytes png = BuildPng(3, 1, 8, 2, std::string("\0\xFF\0\0\0\xFF\0\0\0\xFF", 10));
  const Result<DecodedImage> image = DecodeImage(png, "rgb.png");
  ASSERT_TRUE(image) << image.error().message;
  const auto& p = Pixels<std::uint8_t>(*image);
  EXPECT_EQ(p.at(0, 0, 0), 255);
  EXPECT_EQ(p.at(0, 0, 2), 0);
  EXPECT_EQ(p.at(1, 0, 1), 255);
  EXPECT_EQ(p.at(2, 0, 2), 255);
}

TEST(DecodeImage, AlphaIsDropped) {
  const Bytes png = BuildPng(2, 1, 8, 6, std::string("\0\x10\x20\x30\x00\x40\x50\x60\x80", 9));
  const Result<DecodedImage> image = DecodeImage(png, "rgba.png");
  ASSERT_TRUE(image) << image.error().message;
  ASSERT_EQ(image->channels(), 3);
  const auto& p = Pixels<std::uint8_t>(*image);
  EXPECT_EQ(p.at(0, 0, 0), 0x10);
  EXPECT_EQ(p.at(0, 0, 2), 0x30);
  EXPECT_EQ(p.at(1, 0, 1), 0x50);
}

TEST(DecodeImage, APaletteIsExpanded) {
  const std::string palette = PngChunk("PLTE", std::string("\x01\x02\x03\xF0\xE0\xD0", 6));
  const Bytes png = BuildPng(3, 1, 8, 3, std::string("\0\1\0\1", 4), palette);
  const Result<DecodedImage> image = DecodeImage(png, "palette.png");
  ASSERT_TRUE(image) << image.error().message;
  ASSERT_EQ(image->channels(), 3);
  const auto& p = Pixels<std::uint8_t>(*image);
  EXPECT_EQ(p.at(0, 0, 0), 0xF0);
  EXPECT_EQ(p.at(1, 0, 1), 0x02);
  EXPECT_EQ(p.at(2, 0, 2), 0xD0);
}

TEST(DecodeImage, OneBitGreyIsExpandedToBlackAndWhite) {
  const Bytes png = BuildPng(8, 1, 1, 0, std::string("\0\xA5", 2));
  const Result<DecodedImage> image = DecodeImage(png, "bits.png");
  ASSERT_TRUE(image) << image.error().message;
  const auto& p = Pixels<std::uint8_t>(*image);
  EXPECT_EQ(p.at(0, 0), 255);
  EXPECT_EQ(p.at(1, 0), 0);
  EXPECT_EQ(p.at(7, 0), 255);
}

TEST(DecodeImage, ExifOrientationIsIgnored) {
  // An APP1 segment that asks for a quarter turn.
  const Image<std::uint8_t> image(16, 8, 3);
  Result<Bytes> jpeg = EncodeJpeg(image.view(), 90);
  ASSERT_TRUE(jpeg);
  FileBuilder exif;
  exif.Raw(std::string_view("\xFF\xE1", 2)).Number(2 + 6 + 8 + 2 + 12 + 4, 2, true);
  exif.Raw(std::string_view("Exif\0\0II*\0", 10)).Number(8, 4, false).Number(1, 2, false);
  exif.Number(0x0112, 2, false).Number(3, 2, false).Number(1, 4, false);
  exif.Number(6, 4, false).Number(0, 4, false);
  const Bytes segment = exif.bytes();
  jpeg->insert(jpeg->begin() + 2, segment.begin(), segment.end());
  const Result<DecodedImage> back = DecodeImage(*jpeg, "turned.jpg");
  ASSERT_TRUE(back) << back.error().message;
  EXPECT_EQ(back->width(), 16);
  EXPECT_EQ(back->height(), 8);
}

TEST(DecodeImage, AnyTruncatedPngIsRefused) {
  const Result<Bytes> png = EncodePng(RandomImage<std::uint8_t>(41, 29, 3).view(), 6);
  ASSERT_TRUE(png);
  for (std::size_t size = 0; size < png->size(); size += 1 + size / 16) {
    const Result<DecodedImage> image = DecodeImage(std::span(*png).first(size), "cut.png");
    EXPECT_FALSE(image) << "with " << size << " of " << png->size() << " bytes";
    if (!image) {
      EXPECT_NE(image.error().message.find("cut.png"), std::string::npos);
    }
  }
  // The last byte of the last chunk of pixels, and into the end chunk.
  for (std::size_t missing = 13; missing <= 40; ++missing) {
    EXPECT_FALSE(DecodeImage(std::span(*png).first(png->size() - missing), "cut.png"))
        << "without the last " << missing << " bytes";
  }
}

TEST(DecodeImage, APngWithADamagedChunkIsRefused) {
  Result<Bytes> png = EncodePng(RandomImage<std::uint8_t>(41, 29, 3).view(), 6);
  ASSERT_TRUE(png);
  (*png)[png->size() / 2] ^= std::byte{0x40};
  EXPECT_FALSE(DecodeImage(*png, "damaged.png"));
}

TEST(DecodeImage, AnyTruncatedJpegIsRefused) {
  const Result<Bytes> jpeg = EncodeJpeg(RandomImage<std::uint8_t>(48, 32, 3).view(), 80);
  ASSERT_TRUE(jpeg);
  for (std::size_t size = 0; size < jpeg->size(); size += 1 + size / 24) {
    EXPECT_FALSE(DecodeImage(std::span(*jpeg).first(size), "cut.jpg"))
        << "with " << size << " of " << jpeg->size() << " bytes";
  }
  EXPECT_FALSE(DecodeImage(std::span(*jpeg).first(jpeg->size() - 1), "cut.jpg"));
}

TEST(DecodeImage, ATruncatedTiffIsRefused) {
  const Bytes tiff = BuildTiff(RandomImage<std::uint8_t>(19, 11, 3), false);
  for (std::size_t size = 0; size < tiff.size(); size += 7) {
    EXPECT_FALSE(DecodeImage(std::span(tiff).first(size), "cut.tiff"))
        << "with " << size << " of " << tiff.size() << " bytes";
  }
}

TEST(DecodeImage, AHeaderThatClaimsMorePixelsThanAllowedIsRefusedBySize) {
  const std::string row(64, '\0');
  const std::uint32_t huge = 0x7FFFFFFF;
  const std::array<Bytes, 4> files = {
      BuildPng(huge, huge, 8, 2, row), BuildPng(huge, 1, 16, 0, row),
      BuildPng(65536, 8192, 8, 2, row),
      BuildTiff(RandomImage<std::uint8_t>(8, 8, 3), false, 0xFFFFFFFF, 0xFFFFFFFF)};
  for (const Bytes& file : files) {
    const Result<DecodedImage> image = DecodeImage(file, "huge");
    ASSERT_FALSE(image);
    EXPECT_EQ(image.error().kind, ErrorKind::kData);
    EXPECT_NE(image.error().message.find("expected at most"), std::string::npos)
        << image.error().message;
  }
}

TEST(DecodeImage, AHugeJpegIsRefusedBySize) {
  Result<Bytes> jpeg = EncodeJpeg(RandomImage<std::uint8_t>(16, 16, 3).view(), 80);
  ASSERT_TRUE(jpeg);
  bool found = false;
  for (std::size_t k = 2; k + 9 < jpeg->size() && !found; ++k) {
    if ((*jpeg)[k] != std::byte{0xFF} || (*jpeg)[k + 1] != std::byte{0xC0}) continue;
    for (std::size_t i = 5; i < 9; ++i) (*jpeg)[k + i] = std::byte{0xFF};
    found = true;
  }
  ASSERT_TRUE(found) << "no frame header in our own JPEG";
  const Result<DecodedImage> image = DecodeImage(*jpeg, "huge.jpg");
  ASSERT_FALSE(image);
  EXPECT_NE(image.error().message.find("65535x65535"), std::string::npos) << image.error().message;
}

TEST(DecodeImage, SizesOfZeroAreRefused) {
  EXPECT_FALSE(DecodeImage(BuildPng(0, 5, 8, 2, "x"), "zero.png"));
  EXPECT_FALSE(
      DecodeImage(BuildTiff(RandomImage<std::uint8_t>(4, 4, 1), false, 0, 4), "zero.tiff"));
}

TEST(DecodeImage, WhatIsNoImageIsNamedSo) {
  for (const std::string& text : {std::string(), std::string("hello"), std::string(4096, 'x'),
                                  std::string("BM") + std::string(200, '\0')}) {
    const Result<DecodedImage> image =
        DecodeImage(std::as_bytes(std::span(text.data(), text.size())), "notes.txt");
    ASSERT_FALSE(image);
    EXPECT_EQ(image.error().message, "notes.txt: not a PNG, JPEG or TIFF file");
  }
}

TEST(DecodeImage, GarbageBehindAValidMagicNeverCrashes) {
  std::mt19937 generator(3);
  std::uniform_int_distribution<int> byte(0, 255);
  const Bytes png = *EncodePng(RandomImage<std::uint8_t>(12, 9, 3).view());
  const Bytes jpeg = *EncodeJpeg(RandomImage<std::uint8_t>(12, 9, 3).view(), 80, true);
  const Bytes tiff = BuildTiff(RandomImage<std::uint16_t>(12, 9, 3), true);
  for (const Bytes& good : {png, jpeg, tiff}) {
    for (int round = 0; round < 300; ++round) {
      Bytes bad = good;
      for (int k = 0; k < 1 + round % 5; ++k) {
        bad[static_cast<std::size_t>(generator()) % bad.size()] =
            static_cast<std::byte>(byte(generator));
      }
      const Result<DecodedImage> image = DecodeImage(bad, "garbage");
      if (!image) {
        EXPECT_NE(image.error().message.find("garbage"), std::string::npos);
      }
    }
  }
}

TEST(ReadImage, NamesTheFileThatIsMissing) {
  const testing::TemporaryDirectory directory;
  const Result<DecodedImage> image = ReadImage(directory.path() / "nowhere.png");
  ASSERT_FALSE(image);
  EXPECT_EQ(image.error().kind, ErrorKind::kNoInput);
  EXPECT_NE(image.error().message.find("nowhere.png"), std::string::npos);
}

TEST(ReadImage, GoesByContentNotByName) {
  const testing::TemporaryDirectory directory;
  const std::filesystem::path path = directory.path() / "really_a_png.jpg";
  const Result<Bytes> png = EncodePng(RandomImage<std::uint8_t>(5, 4, 1).view());
  ASSERT_TRUE(png);
  std::ofstream(path, std::ios::binary)
      .write(reinterpret_cast<const char*>(png->data()), static_cast<std::streamsize>(png->size()));
  const Result<DecodedImage> image = ReadImage(path);
  ASSERT_TRUE(image) << image.error().message;
  EXPECT_EQ(image->width(), 5);
}

TEST(EncodePng, OnlyOneOrThreeChannelsArePictures) {
  for (const int channels : {2, 4}) {
    EXPECT_FALSE(EncodePng(Image<std::uint8_t>(4, 4, channels).view()));
    EXPECT_FALSE(EncodeJpeg(Image<std::uint8_t>(4, 4, channels).view(), 90));
  }
  EXPECT_FALSE(EncodePng(Image<std::uint8_t>().view()));
}

// A picture JPEG keeps well.
Image<std::uint8_t> SmoothImage(int width, int height) {
  Image<std::uint8_t> image(width, height, 3);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      image.at(x, y, 0) = static_cast<std::uint8_t>(40 + 150 * x / width);
      image.at(x, y, 1) = static_cast<std::uint8_t>(60 + 120 * y / height);
      image.at(x, y, 2) = 90;
    }
  }
  return image;
}

TEST(EncodeJpeg, RoundTripsASmoothPictureToWithinAFewCodes) {
  const Image<std::uint8_t> image = SmoothImage(64, 32);
  const Result<Bytes> jpeg = EncodeJpeg(image.view(), 95);
  ASSERT_TRUE(jpeg);
  const Result<DecodedImage> back = DecodeImage(*jpeg, "smooth.jpg");
  ASSERT_TRUE(back) << back.error().message;
  const auto& p = Pixels<std::uint8_t>(*back);
  for (std::size_t k = 0; k < image.size(); ++k) {
    EXPECT_NEAR(p.values()[k], image.values()[k], 6) << "value " << k;
  }
}

TEST(EncodeJpeg, APanoramaSaysSoToViewersAndStillDecodesTheSame) {
  const Image<std::uint8_t> image = SmoothImage(64, 32);
  const Result<Bytes> plain = EncodeJpeg(image.view(), 90);
  const Result<Bytes> panorama = EncodeJpeg(image.view(), 90, true);
  ASSERT_TRUE(plain && panorama);
  const std::string_view text(reinterpret_cast<const char*>(panorama->data()), panorama->size());
  for (const std::string_view key :
       {"http://ns.adobe.com/xap/1.0/", "GPano:ProjectionType=\"equirectangular\"",
        "GPano:UsePanoramaViewer=\"True\"", "GPano:FullPanoWidthPixels=\"64\"",
        "GPano:FullPanoHeightPixels=\"32\"", "GPano:CroppedAreaImageWidthPixels=\"64\"",
        "GPano:CroppedAreaLeftPixels=\"0\""}) {
    EXPECT_NE(text.find(key), std::string_view::npos) << key;
  }
  // JFIF stays the first segment, XMP is an APP1 segment behind it.
  EXPECT_EQ((*panorama)[3], std::byte{0xE0});
  const auto jfif =
      static_cast<std::size_t>((*panorama)[4]) * 256 + static_cast<std::size_t>((*panorama)[5]);
  EXPECT_EQ((*panorama)[4 + jfif], std::byte{0xFF});
  EXPECT_EQ((*panorama)[5 + jfif], std::byte{0xE1});
  const Result<DecodedImage> a = DecodeImage(*plain, "a.jpg");
  const Result<DecodedImage> b = DecodeImage(*panorama, "b.jpg");
  ASSERT_TRUE(a && b);
  ExpectSamePixels(Pixels<std::uint8_t>(*a), Pixels<std::uint8_t>(*b));
}

TEST(EncodeJpeg, APartOfASphereSaysWhereItLiesAndWhereItLooks) {
  PhotoSphere sphere{.full_width = 256, .full_height = 128, .left = 96, .top = 40};
  sphere.heading_deg = 271.25;
  sphere.pitch_deg = -3.0;
  const Result<Bytes> jpeg = EncodeJpeg(SmoothImage(64, 32).view(), 90, sphere);
  ASSERT_TRUE(jpeg) << jpeg.error().message;
  const std::string_view text(reinterpret_cast<const char*>(jpeg->data()), jpeg->size());
  for (const std::string_view key :
       {"GPano:FullPanoWidthPixels=\"256\"", "GPano:FullPanoHeightPixels=\"128\"",
        "GPano:CroppedAreaImageWidthPixels=\"64\"", "GPano:CroppedAreaImageHeightPixels=\"32\"",
        "GPano:CroppedAreaLeftPixels=\"96\"", "GPano:CroppedAreaTopPixels=\"40\"",
        "GPano:PoseHeadingDegrees=\"271.250\"", "GPano:PosePitchDegrees=\"-3.000\""}) {
    EXPECT_NE(text.find(key), std::string_view::npos) << key;
  }
  EXPECT_EQ(text.find("PoseRollDegrees"), std::string_view::npos) << "roll is not known";
}

TEST(EncodeJpeg, APlaceOnTheSphereThatCannotBeIsAnError) {
  const Image<std::uint8_t> image = SmoothImage(64, 32);
  const PhotoSphere good{.full_width = 128, .full_height = 64, .left = 64, .top = 32};
  ASSERT_TRUE(EncodeJpeg(image.view(), 90, good));
  PhotoSphere bad = good;
  bad.left = 65;
  EXPECT_FALSE(EncodeJpeg(image.view(), 90, bad));
  bad = good;
  bad.top = -1;
  EXPECT_FALSE(EncodeJpeg(image.view(), 90, bad));
  bad = good;
  bad.heading_deg = 360.0;
  EXPECT_FALSE(EncodeJpeg(image.view(), 90, bad));
  bad.heading_deg = std::nan("");
  EXPECT_FALSE(EncodeJpeg(image.view(), 90, bad));
}

TEST(EncodeJpeg, APlainPictureClaimsNothing) {
  const Result<Bytes> jpeg = EncodeJpeg(SmoothImage(64, 32).view(), 90);
  ASSERT_TRUE(jpeg);
  const std::string_view text(reinterpret_cast<const char*>(jpeg->data()), jpeg->size());
  EXPECT_EQ(text.find("GPano"), std::string_view::npos);
}

}  // namespace
}  // namespace omnihdr::image_io_test
