#include "core/image/exr.h"

#include <ImathBox.h>
#include <OpenEXR/ImfChannelList.h>
#include <OpenEXR/ImfFrameBuffer.h>
#include <OpenEXR/ImfHeader.h>
#include <OpenEXR/ImfInputFile.h>
#include <OpenEXR/ImfOutputFile.h>
#include <OpenEXR/ImfStandardAttributes.h>
#include <gtest/gtest.h>
#include <half.h>

#include <cmath>
#include <cstdlib>
#include <cstring>
#include <fstream>
#include <iterator>
#include <limits>
#include <map>
#include <random>
#include <string>

#include "tests/support/temporary_directory.h"

namespace omnihdr::exr_test {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr float kInfinity = std::numeric_limits<float>::infinity();

// Radiance over many decades, three channels.
Image<float> Decades(int width, int height) {
  std::mt19937 generator(11);
  std::uniform_real_distribution<float> exponent(-3.0F, 4.0F);
  Image<float> image(width, height, 3);
  for (float& v : image.values()) v = std::pow(10.0F, exponent(generator));
  return image;
}

std::string FileBytes(const std::filesystem::path& path) {
  std::ifstream file(path, std::ios::binary);
  return {std::istreambuf_iterator<char>(file), std::istreambuf_iterator<char>()};
}

void WriteBytes(const std::filesystem::path& path, const std::string& bytes) {
  std::ofstream(path, std::ios::binary)
      .write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
}

class Exr : public ::testing::Test {
 protected:
  std::filesystem::path path() const { return directory_.path() / "picture.exr"; }
  testing::TemporaryDirectory directory_;
};

TEST_F(Exr, FloatChannelsComeBackToTheLastBitInEveryCompression) {
  Image<float> image = Decades(33, 17);
  image.at(4, 5, 1) = kNan;
  image.at(6, 7, 2) = kInfinity;
  for (const ExrCompression compression :
       {ExrCompression::kNone, ExrCompression::kZips, ExrCompression::kZip, ExrCompression::kPiz}) {
    ASSERT_TRUE(WriteExr(path(),
                         {{"R", image, ExrPixelType::kFloat, 0},
                          {"G", image, ExrPixelType::kFloat, 1},
                          {"B", image, ExrPixelType::kFloat, 2}},
                         {}, compression));
    const Result<ExrImage> back = ReadExr(path());
    ASSERT_TRUE(back) << back.error().message;
    ASSERT_EQ(back->width, 33);
    ASSERT_EQ(back->height, 17);
    ASSERT_EQ(back->channels.size(), 3U);
    const std::array<const Image<float>*, 3> channels = {
        &back->channels.at("R"), &back->channels.at("G"), &back->channels.at("B")};
    for (int y = 0; y < 17; ++y) {
      for (int x = 0; x < 33; ++x) {
        for (int c = 0; c < 3; ++c) {
          const float expected = image.at(x, y, c);
          const float got = channels[static_cast<std::size_t>(c)]->at(x, y);
          if (std::isnan(expected)) {
            EXPECT_TRUE(std::isnan(got));
          } else {
            EXPECT_EQ(got, expected);
          }
        }
      }
    }
  }
}

TEST_F(Exr, HalfChannelsComeBackToElevenBits) {
  const Image<float> image = Decades(33, 17);
  ASSERT_TRUE(WriteExr(path(), {{"Y", image, ExrPixelType::kHalf, 1}}, {}));
  const Result<ExrImage> back = ReadExr(path());
  ASSERT_TRUE(back) << back.error().message;
  for (int y = 0; y < 17; ++y) {
    for (int x = 0; x < 33; ++x) {
      const float expected = image.at(x, y, 1);
      EXPECT_NEAR(back->channels.at("Y").at(x, y), expected, expected / 2048.0F);
    }
  }
}

TEST_F(Exr, WhatHalfCannotHoldIsClampedAndNanIsKept) {
  Image<float> image(4, 1);
  image.at(0, 0) = 1e6F;
  image.at(1, 0) = -kInfinity;
  image.at(2, 0) = kNan;
  image.at(3, 0) = 65504.0F;
  ASSERT_TRUE(WriteExr(path(), {{"Y", image, ExrPixelType::kHalf, 0}}, {}));
  const Result<ExrImage> back = ReadExr(path());
  ASSERT_TRUE(back) << back.error().message;
  const Image<float>& y = back->channels.at("Y");
  EXPECT_EQ(y.at(0, 0), 65504.0F);
  EXPECT_EQ(y.at(1, 0), -65504.0F);
  EXPECT_TRUE(std::isnan(y.at(2, 0)));
  EXPECT_EQ(y.at(3, 0), 65504.0F);
}

TEST_F(Exr, HalvesAreTheNearestAndHalfwayToEven) {
  std::mt19937 generator(7);
  std::uniform_real_distribution<float> exponent(-9.0F, 4.8F);
  Image<float> image(512, 260, 2);
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      // Half of them lie halfway between two halves, denormal ones too.
      const auto bits = static_cast<std::uint16_t>(y * image.width() + x) & 0x7BFFU;
      const float low = half(half::FromBits, static_cast<std::uint16_t>(bits));
      const float high = half(half::FromBits, static_cast<std::uint16_t>(bits + 1U));
      const float sign = x % 3 == 0 ? -1.0F : 1.0F;
      image.at(x, y, 1) =
          sign * (y % 2 == 0 && std::isfinite(high) ? 0.5F * (low + high)
                                                    : std::pow(10.0F, exponent(generator)));
    }
  }
  ASSERT_TRUE(WriteExr(path(), {{"Y", image, ExrPixelType::kHalf, 1}}, {}));
  const Result<ExrImage> back = ReadExr(path());
  ASSERT_TRUE(back) << back.error().message;
  for (int y = 0; y < image.height(); ++y) {
    for (int x = 0; x < image.width(); ++x) {
      const float value = image.at(x, y, 1);
      const float expected = std::abs(value) >= 65504.0F ? std::copysign(65504.0F, value)
                                                         : static_cast<float>(half(value));
      ASSERT_EQ(back->channels.at("Y").at(x, y), expected) << value;
    }
  }
}

TEST_F(Exr, ALatLongPictureSaysSo) {
  const Image<float> image(8, 4, 1, 1.0F);
  ASSERT_TRUE(WriteExr(path(), {{"Y", image}},
                       {.envmap = ExrEnvmap::kLatLong, .strings = {}, .floats = {}}));
  {
    const Imf::InputFile file(path().c_str());
    ASSERT_TRUE(Imf::hasEnvmap(file.header()));
    EXPECT_EQ(Imf::envmap(file.header()), Imf::ENVMAP_LATLONG);
  }
  ASSERT_TRUE(
      WriteExr(path(), {{"Y", image}}, {.envmap = ExrEnvmap::kNone, .strings = {}, .floats = {}}));
  const Imf::InputFile file(path().c_str());
  EXPECT_FALSE(Imf::hasEnvmap(file.header()));
}

TEST_F(Exr, AttributesAreReadBack) {
  const Image<float> image(8, 4, 1, 1.0F);
  ASSERT_TRUE(WriteExr(path(), {{"Y", image}},
                       {.envmap = ExrEnvmap::kLatLong,
                        .strings = {{"software", "a test"}, {"omnihdrPosition", "12"}},
                        .floats = {{"expTime", 0.25}}}));
  const Result<ExrImage> back = ReadExr(path());
  ASSERT_TRUE(back) << back.error().message;
  EXPECT_EQ(back->attributes.strings.at("software"), "a test");
  EXPECT_EQ(back->attributes.strings.at("omnihdrPosition"), "12");
  const Imf::InputFile file(path().c_str());
  ASSERT_TRUE(Imf::hasExpTime(file.header()));
  EXPECT_FLOAT_EQ(Imf::expTime(file.header()), 0.25F);
}

TEST_F(Exr, PrimariesEnvmapAndTypesAreReadBack) {
  const Image<float> image(4, 24, 1, 3.0F);
  ExrAttributes attributes;
  attributes.envmap = ExrEnvmap::kCube;
  attributes.floats["expTime"] = 0.5;
  attributes.chromaticities = {0.7, 0.3, 0.2, 0.75, 0.1, 0.0, 0.31, 0.32};
  ASSERT_TRUE(WriteExr(path(),
                       {{"H", image, ExrPixelType::kHalf, 0},
                        {"F", image, ExrPixelType::kFloat, 0},
                        {"U", image, ExrPixelType::kUint, 0}},
                       attributes));
  const Result<ExrImage> back = ReadExr(path());
  ASSERT_TRUE(back) << back.error().message;
  EXPECT_EQ(back->attributes.envmap, ExrEnvmap::kCube);
  ASSERT_TRUE(back->attributes.chromaticities);
  for (std::size_t i = 0; i < 8; ++i) {
    EXPECT_NEAR((*back->attributes.chromaticities)[i], (*attributes.chromaticities)[i], 1e-6);
  }
  // Nothing but what was written: not the file's own form (pixelAspectRatio, ...).
  EXPECT_EQ(back->attributes.floats, (std::map<std::string, double>{{"expTime", 0.5}}));
  EXPECT_TRUE(back->attributes.strings.empty());
  EXPECT_EQ(back->types.at("H"), ExrPixelType::kHalf);
  EXPECT_EQ(back->types.at("F"), ExrPixelType::kFloat);
  EXPECT_EQ(back->types.at("U"), ExrPixelType::kUint);
  for (const char* name : {"H", "F", "U"}) EXPECT_EQ(back->channels.at(name).at(3, 20), 3.0F);
}

TEST_F(Exr, LabelsAreWholeNumbersWhateverComes) {
  Image<float> image(5, 1);
  image.at(0, 0) = 16'777'216.0F;
  image.at(1, 0) = kNan;
  image.at(2, 0) = -3.0F;
  image.at(3, 0) = kInfinity;
  image.at(4, 0) = 2.9F;
  ASSERT_TRUE(WriteExr(path(), {{"id", image, ExrPixelType::kUint, 0}}, {}));
  const Result<ExrImage> back = ReadExr(path());
  ASSERT_TRUE(back) << back.error().message;
  const Image<float>& id = back->channels.at("id");
  EXPECT_EQ(id.at(0, 0), 16'777'216.0F);
  EXPECT_EQ(id.at(1, 0), 0.0F);
  EXPECT_EQ(id.at(2, 0), 0.0F);
  EXPECT_EQ(id.at(3, 0), 4294967296.0F);
  EXPECT_EQ(id.at(4, 0), 2.0F);
}

TEST(SmallestType, IsHalfUnlessAFiniteValueExceedsIt) {
  Image<float> image(3, 2, 3, 1.0F);
  EXPECT_EQ(SmallestType(image), ExrPixelType::kHalf);
  image.at(2, 1, 2) = kInfinity;
  image.at(1, 1, 2) = kNan;
  image.at(0, 0, 0) = 65504.0F;
  EXPECT_EQ(SmallestType(image), ExrPixelType::kHalf);
  image.at(2, 1, 2) = -65505.0F;
  EXPECT_EQ(SmallestType(image), ExrPixelType::kFloat);
}

TEST(Primaries, MustHoldTheirWhite) {
  EXPECT_EQ(WhyNotChromaticities(kRec709), "");
  // ACES AP0 (SMPTE ST 2065-1): primaries outside the spectrum are primaries all the same.
  EXPECT_EQ(WhyNotChromaticities({0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.077, 0.32168, 0.33767}), "");
  EXPECT_NE(WhyNotChromaticities({0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3, 0.3}), "");
  EXPECT_NE(WhyNotChromaticities({0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.0}), "");
  EXPECT_NE(WhyNotChromaticities({0.64, 0.33, 0.30, 0.60, 0.15, 0.06, kNan, 0.3}), "");
  EXPECT_NE(WhyNotChromaticities({0.64, 0.33, 0.30, 3.0, 0.15, 0.06, 0.3127, 0.329}), "");
}

// What an independent program reads: OpenEXR's own, when it is installed.
TEST_F(Exr, ExrheaderReadsTheStandardAttributes) {
  if (std::system("command -v exrheader >/dev/null") != 0) {
    GTEST_SKIP() << "exrheader is not installed (package openexr): skipped";
  }
  const Image<float> image(8, 4, 3, 1.0F);
  ExrAttributes attributes;
  attributes.strings = {{"software", "a test"}, {"capDate", "2026:02:03 04:05:06"}};
  attributes.floats = {{"expTime", 0.25}, {"latitude", 45.5}, {"whiteLuminance", 179.0}};
  attributes.chromaticities = kRec709;
  ASSERT_TRUE(WriteExr(path(),
                       {{"R", image, ExrPixelType::kHalf, 0},
                        {"G", image, ExrPixelType::kHalf, 1},
                        {"B", image, ExrPixelType::kFloat, 2}},
                       attributes, ExrCompression::kPiz));
  const std::filesystem::path text = directory_.path() / "header.txt";
  ASSERT_EQ(std::system(("exrheader '" + path().string() + "' >'" + text.string() + "'").c_str()),
            0);
  const std::string header = FileBytes(text);
  for (const char* line :
       {"envmap (type envmap): latitude-longitude map",
        "capDate (type string): \"2026:02:03 04:05:06\"", "expTime (type float): 0.25",
        "latitude (type float): 45.5", "whiteLuminance (type float): 179",
        "software (type string): \"a test\"", "R, 16-bit floating-point, sampling 1 1",
        "B, 32-bit floating-point, sampling 1 1", "red   (0.64 0.33)", "white (0.3127 0.329)"}) {
    EXPECT_NE(header.find(line), std::string::npos) << line << " in\n" << header;
  }
}

TEST_F(Exr, ADataWindowAwayFromTheOriginIsRead) {
  const Imath::Box2i display(Imath::V2i(0, 0), Imath::V2i(99, 99));
  const Imath::Box2i data(Imath::V2i(-5, 20), Imath::V2i(4, 26));
  Imf::Header header(display, data);
  header.channels().insert("Y", Imf::Channel(Imf::FLOAT));
  Image<float> pixels(10, 7);
  for (std::size_t k = 0; k < pixels.size(); ++k) pixels.data()[k] = static_cast<float>(k);
  {
    Imf::OutputFile file(path().c_str(), header);
    Imf::FrameBuffer frame_buffer;
    frame_buffer.insert("Y", Imf::Slice::Make(Imf::FLOAT, pixels.data(), data));
    file.setFrameBuffer(frame_buffer);
    file.writePixels(7);
  }
  const Result<ExrImage> back = ReadExr(path());
  ASSERT_TRUE(back) << back.error().message;
  ASSERT_EQ(back->width, 10);
  ASSERT_EQ(back->height, 7);
  EXPECT_EQ(back->channels.at("Y").at(0, 0), 0.0F);
  EXPECT_EQ(back->channels.at("Y").at(9, 6), 69.0F);
}

TEST_F(Exr, ChannelsOfDifferentSizesAreRefused) {
  const Image<float> a(8, 4);
  const Image<float> b(4, 4);
  EXPECT_FALSE(WriteExr(path(), {{"A", a}, {"B", b}}, {}));
  EXPECT_FALSE(WriteExr(path(), {}, {}));
}

TEST_F(Exr, AFileThatCannotBeMadeIsAnErrorThatNamesIt) {
  const Image<float> image(8, 4);
  const Status status =
      WriteExr(directory_.path() / "no" / "such" / "folder.exr", {{"Y", image}}, {});
  ASSERT_FALSE(status);
  EXPECT_NE(status.error().message.find("folder.exr"), std::string::npos);
}

TEST_F(Exr, ATruncatedFileIsRefusedAndNamed) {
  const Image<float> image = Decades(33, 17);
  ASSERT_TRUE(WriteExr(
      path(), {{"R", image, ExrPixelType::kFloat, 0}, {"G", image, ExrPixelType::kHalf, 1}}, {}));
  const std::string whole = FileBytes(path());
  const std::filesystem::path cut = directory_.path() / "cut.exr";
  for (std::size_t size = 0; size < whole.size(); size += 1 + whole.size() / 97) {
    WriteBytes(cut, whole.substr(0, size));
    const Result<ExrImage> back = ReadExr(cut);
    EXPECT_FALSE(back) << "with " << size << " of " << whole.size() << " bytes";
    if (!back) {
      EXPECT_NE(back.error().message.find("cut.exr"), std::string::npos);
    }
  }
}

TEST_F(Exr, WhatIsNoExrIsRefused) {
  for (const std::string& text : {std::string(), std::string("hello"), std::string(5000, 'x')}) {
    WriteBytes(path(), text);
    EXPECT_FALSE(ReadExr(path()));
  }
  EXPECT_FALSE(ReadExr(directory_.path() / "missing.exr"));
}

TEST_F(Exr, GarbageInsideNeverCrashes) {
  const Image<float> image = Decades(21, 9);
  ASSERT_TRUE(WriteExr(
      path(), {{"R", image, ExrPixelType::kFloat, 0}, {"G", image, ExrPixelType::kHalf, 1}},
      {.envmap = ExrEnvmap::kLatLong, .strings = {{"a", "b"}}, .floats = {}},
      ExrCompression::kPiz));
  const std::string whole = FileBytes(path());
  std::mt19937 generator(5);
  const std::filesystem::path bad = directory_.path() / "bad.exr";
  for (int round = 0; round < 300; ++round) {
    std::string bytes = whole;
    for (int k = 0; k < 1 + round % 4; ++k) {
      bytes[generator() % bytes.size()] = static_cast<char>(generator() & 0xFFU);
    }
    WriteBytes(bad, bytes);
    const Result<ExrImage> back = ReadExr(bad);
    if (!back) {
      EXPECT_NE(back.error().message.find("bad.exr"), std::string::npos);
    }
  }
}

// The file with its data window (and display window) replaced.
std::string WithWindow(std::string bytes, std::int32_t x0, std::int32_t y0, std::int32_t x1,
                       std::int32_t y1) {
  for (const char* name : {"dataWindow", "displayWindow"}) {
    const std::size_t at = bytes.find(name);
    EXPECT_NE(at, std::string::npos);
    // name, zero, "box2i", zero, 4 bytes of size, four numbers
    char* p = bytes.data() + at + std::strlen(name) + 1 + 6 + 4;
    for (const std::int32_t v : {x0, y0, x1, y1}) {
      std::memcpy(p, &v, 4);
      p += 4;
    }
  }
  return bytes;
}

TEST_F(Exr, AHeaderThatClaimsMorePixelsThanAllowedIsRefused) {
  const Image<float> image(16, 8, 1, 1.0F);
  ASSERT_TRUE(WriteExr(path(), {{"Y", image, ExrPixelType::kFloat, 0}}, {}));
  const std::string whole = FileBytes(path());
  const std::filesystem::path huge = directory_.path() / "huge.exr";
  WriteBytes(huge, WithWindow(whole, 0, 0, 1 << 20, 1 << 20));
  EXPECT_FALSE(ReadExr(huge));
  WriteBytes(huge, WithWindow(whole, 0, 0, (1 << 16) - 1, (1 << 13) - 1));
  const Result<ExrImage> back = ReadExr(huge);
  ASSERT_FALSE(back);
  WriteBytes(huge, WithWindow(whole, std::numeric_limits<std::int32_t>::min() / 2, 0,
                              std::numeric_limits<std::int32_t>::max() / 2, 1));
  EXPECT_FALSE(ReadExr(huge));
}

TEST_F(Exr, ASmallFileWithManyLargeChannelsIsRefused) {
  // Few bytes that would unfold to 64 channels of 2^26 pixels: 16 GiB.
  const Image<float> tiny(16, 8, 1, 0.0F);
  std::vector<ExrChannel> channels;
  for (int k = 0; k < 64; ++k) channels.push_back({fmt::format("c{}", k), tiny});
  ASSERT_TRUE(WriteExr(path(), channels, {}, ExrCompression::kZip));
  // Long enough to hold what would be the table of chunks.
  WriteBytes(path(), WithWindow(FileBytes(path()) + std::string(1 << 16, '\1'), 0, 0, 8191, 8191));
  const Result<ExrImage> back = ReadExr(path());
  ASSERT_FALSE(back);
  EXPECT_NE(back.error().message.find("expected at most"), std::string::npos)
      << back.error().message;
}

TEST_F(Exr, AnAttributeLargerThanTheFileIsRefusedAndNamed) {
  ExrAttributes attributes;
  attributes.strings["owner"] = "nobody";
  ASSERT_TRUE(WriteExr(path(), {{"Y", Image<float>(16, 8, 1, 0.0F)}}, attributes));
  ASSERT_TRUE(ReadExr(path()));
  const std::string whole = FileBytes(path());
  const std::string field = std::string("owner\0string\0", 13);
  const std::size_t size = whole.find(field);
  ASSERT_NE(size, std::string::npos);
  for (const std::string& bytes :
       {std::string("\0\0\0\x7f", 4), std::string("\xff\xff\xff\xff", 4)}) {
    std::string wrong = whole;
    WriteBytes(path(), wrong.replace(size + field.size(), 4, bytes));
    const Result<ExrImage> back = ReadExr(path());
    ASSERT_FALSE(back);
    EXPECT_NE(back.error().message.find("'owner', type 'string'"), std::string::npos)
        << back.error().message;
  }
}

TEST_F(Exr, ASmallFileWithVeryLongLinesIsRefused) {
  // All its lines are in one chunk, which is there: not truncated, and 512 MiB of floats.
  ASSERT_TRUE(WriteExr(path(), {{"Y", Image<float>(16, 8, 1, 0.0F)}}, {}, ExrCompression::kZip));
  WriteBytes(path(), WithWindow(FileBytes(path()), 0, 0, (1 << 24) - 1, 7));
  const Result<ExrImage> back = ReadExr(path());
  ASSERT_FALSE(back);
  EXPECT_NE(back.error().message.find("expected at least"), std::string::npos)
      << back.error().message;
}

}  // namespace
}  // namespace omnihdr::exr_test
