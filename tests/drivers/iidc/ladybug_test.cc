// Frames of six-sensor heads: the raw stack and the colour-separated JPEGs.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <random>

#include "core/sphere/rig.h"
#include "drivers/ladybug/jpeg_frame.h"
#include "drivers/ladybug/raw_stack.h"
#include "tests/emulators/ladybug_frame.h"

namespace omnihdr::ladybug_test {
namespace {

using ladybug::kJpegHeaderBytes;
using ::testing::HasSubstr;

constexpr int kWidth = 64;
constexpr int kHeight = 48;

// A smooth mosaic whose channels and sensors all differ.
Image<std::uint8_t> Scene() {
  Image<std::uint8_t> stack(kWidth, 6 * kHeight);
  for (int y = 0; y < stack.height(); ++y) {
    for (int x = 0; x < kWidth; ++x) {
      const int colour = BayerChannel(BayerOrder::kBggr, x, y % kHeight);
      const int second_green = colour == 1 && y % 2 == 1 ? 15 : 0;
      stack.at(x, y) =
          static_cast<std::uint8_t>(20 + 60 * colour + second_green + 10 * (y / kHeight) + x / 4);
    }
  }
  return stack;
}

std::vector<std::byte> Frame() {
  emulators::LadybugWords words;
  words.cycle_time = 0x12345678;
  words.sequence = 77;
  words.gain = 0x82000005;
  words.shutter = 0x820000AB;
  return emulators::BuildLadybugFrame(Scene(), words, 95);
}

void Put(std::vector<std::byte>& bytes, std::size_t at, std::uint32_t word) {
  for (std::size_t i = 0; i < 4; ++i) {
    bytes[at + i] = static_cast<std::byte>(word >> (24 - 8 * i) & 0xFF);
  }
}

TEST(LadybugRaw, TheRigsStackIsTheRawFrameWithoutItsPadding) {
  const Image<std::uint8_t> scene = Scene();
  std::vector<std::byte> bytes(scene.size() + 100);
  for (std::size_t i = 0; i < scene.size(); ++i) bytes[i] = std::byte{scene.values()[i]};
  const auto stack = ladybug::StackFromRaw(bytes, kWidth, kHeight);
  ASSERT_TRUE(stack);
  for (std::size_t i = 0; i < ladybug::kRawBlocks.size(); ++i) {
    const int sensor = ladybug::kRawBlocks[i].sensor;
    EXPECT_EQ(stack->at(3, sensor * kHeight + 5), scene.at(3, static_cast<int>(i) * kHeight + 5));
  }
  for (std::size_t length = 0; length < scene.size(); length += 61) {
    EXPECT_FALSE(ladybug::StackFromRaw(std::span(bytes).first(length), kWidth, kHeight));
  }
}

TEST(LadybugJpeg, HeaderAndPixelsComeBack) {
  const std::vector<std::byte> frame = Frame();
  const auto header = ladybug::ParseJpegFrame(frame);
  ASSERT_TRUE(header) << header.error().message;
  EXPECT_EQ(header->cycle_time, 0x12345678U);
  EXPECT_EQ(header->sequence, 77U);
  EXPECT_EQ(header->shutters[5] & 0xFFF, 0xABU);
  EXPECT_EQ(header->head_serial, 6100U);
  EXPECT_TRUE(header->IsOneExposure());
  const auto stack = ladybug::DecodeJpegFrame(frame, *header, kWidth, kHeight);
  ASSERT_TRUE(stack) << stack.error().message;
  const Image<std::uint8_t> scene = Scene();
  for (int y = 0; y < scene.height(); ++y) {
    for (int x = 0; x < kWidth; ++x) {
      ASSERT_NEAR(stack->at(x, y), scene.at(x, y), 3) << x << " " << y;
    }
  }
}

TEST(LadybugJpeg, CutOffAtAnyByteIsAnErrorThatSaysSo) {
  const std::vector<std::byte> frame = Frame();
  for (std::size_t length = 0; length < frame.size(); ++length) {
    const auto header = ladybug::ParseJpegFrame(std::span(frame).first(length));
    ASSERT_FALSE(header) << length;
    EXPECT_EQ(header.error().kind, ErrorKind::kData);
    EXPECT_THAT(header.error().message, HasSubstr("compressed frame"));
  }
}

TEST(LadybugJpeg, ABlockCutOffIsAnErrorOfItsSensorAndChannel) {
  const std::vector<std::byte> frame = Frame();
  const auto header = ladybug::ParseJpegFrame(frame);
  ASSERT_TRUE(header);
  for (std::uint32_t cut = 1; cut < header->blocks[2][3].bytes; cut += 7) {
    ladybug::JpegFrameHeader shorter = *header;
    shorter.blocks[2][3].bytes -= cut;
    const auto stack = ladybug::DecodeJpegFrame(frame, shorter, kWidth, kHeight);
    if (stack) continue;  // the last bytes of a JPEG carry no pixels
    EXPECT_THAT(stack.error().message, HasSubstr("sensor 2 channel B"));
  }
  // As the frame itself is, when only its first bytes are there.
  for (std::size_t length = 0; length < frame.size(); length += 509) {
    EXPECT_FALSE(
        ladybug::DecodeJpegFrame(std::span(frame).first(length), *header, kWidth, kHeight) &&
        length < header->blocks[5][0].offset);
  }
}

TEST(LadybugJpeg, EachRuleBrokenIsNamed) {
  const auto broken = [](std::size_t at, std::uint32_t word) {
    std::vector<std::byte> frame = Frame();
    Put(frame, at, word);
    const auto header = ladybug::ParseJpegFrame(frame);
    return header ? std::string("accepted") : header.error().message;
  };
  EXPECT_THAT(broken(0x010, 0xDEADBEEF), HasSubstr("fingerprint 0xdeadbeef"));
  EXPECT_THAT(broken(0x014, 9), HasSubstr("header version 9"));
  EXPECT_THAT(broken(0x008, 0x7FFFFFFF), HasSubstr("buffer is too small"));
  EXPECT_THAT(broken(0x008, 5), HasSubstr("5 bytes of data"));
  const std::size_t entry = ladybug::JpegTableEntry(3, 1);
  EXPECT_THAT(broken(entry + 4, 0), HasSubstr("sensor 3 channel G1: not sent"));
  EXPECT_THAT(broken(entry, 16), HasSubstr("sensor 3 channel G1: bytes 16"));
  EXPECT_THAT(broken(entry + 4, 0xFFFFFFFF), HasSubstr("sensor 3 channel G1: bytes"));
  EXPECT_THAT(broken(entry, 0x401), HasSubstr("no JPEG at byte 1025"));
  EXPECT_THAT(broken(entry, 0x400), HasSubstr("lies over"));
}

TEST(LadybugJpeg, SensorsOfAnotherSizeAreRefused) {
  const std::vector<std::byte> frame = Frame();
  const auto header = ladybug::ParseJpegFrame(frame);
  ASSERT_TRUE(header);
  const auto stack = ladybug::DecodeJpegFrame(frame, *header, 128, 96);
  ASSERT_FALSE(stack);
  EXPECT_THAT(stack.error().message, HasSubstr("32x24 in 1 channels: expected 64x48 grey"));
}

TEST(LadybugJpeg, AnyDamageGivesAFrameOrAnError) {
  const std::vector<std::byte> good = Frame();
  std::mt19937 random(5);
  for (int round = 0; round < 300; ++round) {
    std::vector<std::byte> frame = good;
    for (int i = 0; i < 8; ++i) {
      frame[round % 2 == 0 ? random() % 0x400 : random() % frame.size()] =
          static_cast<std::byte>(random() & 0xFF);
    }
    const auto header = ladybug::ParseJpegFrame(frame);
    if (!header) continue;
    const auto stack = ladybug::DecodeJpegFrame(frame, *header, kWidth, kHeight);
    if (stack) {
      EXPECT_EQ(stack->height(), 6 * kHeight);
    }
  }
}

TEST(LadybugJpeg, SensorsOfDifferentExposureAreNotOne) {
  std::vector<std::byte> frame = Frame();
  Put(frame, 0x058 + 4 * 2, 0x820000AC);
  EXPECT_FALSE(ladybug::ParseJpegFrame(frame)->IsOneExposure());
}

}  // namespace
}  // namespace omnihdr::ladybug_test
