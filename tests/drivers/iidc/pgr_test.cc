// Recorded streams.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cstring>
#include <random>

#include "drivers/ladybug/pgr_file.h"
#include "tests/emulators/ladybug_frame.h"

namespace omnihdr::pgr_test {
namespace {

using ladybug::PgrReader;
using ::testing::HasSubstr;

class MemorySource final : public ladybug::PgrSource {
 public:
  explicit MemorySource(std::vector<std::byte> bytes) : bytes_(std::move(bytes)) {}
  std::uint64_t size() const override { return bytes_.size(); }
  Status Read(std::uint64_t offset, std::span<std::byte> to) const override {
    if (offset + to.size() > bytes_.size()) return Fail(ErrorKind::kSoftware, "beyond the end");
    if (!to.empty()) std::memcpy(to.data(), bytes_.data() + offset, to.size());
    return {};
  }

 private:
  std::vector<std::byte> bytes_;
};

Result<PgrReader> Open(std::vector<std::byte> bytes) {
  return PgrReader::Open(std::make_unique<MemorySource>(std::move(bytes)));
}

std::vector<std::vector<std::byte>> Frames(std::uint32_t count) {
  Image<std::uint8_t> stack(16, 72);
  std::vector<std::vector<std::byte>> frames;
  for (std::uint32_t i = 0; i < count; ++i) {
    for (std::uint8_t& value : stack.values()) value = static_cast<std::uint8_t>(40 * i);
    emulators::LadybugWords words;
    words.sequence = 10 + i;
    frames.push_back(emulators::BuildLadybugFrame(stack, words));
  }
  return frames;
}

std::vector<std::uint32_t> Sequences(PgrReader& reader) {
  std::vector<std::uint32_t> sequences;
  while (true) {
    auto frame = reader.Next();
    if (!frame) {
      ADD_FAILURE() << frame.error().message;
      return sequences;
    }
    if (!*frame) return sequences;
    sequences.push_back((*frame)->header.sequence);
  }
}

TEST(PgrStream, VersionsFourAndSevenAreReadClosedOrNot) {
  for (const std::uint32_t version : {4U, 7U}) {
    for (const bool closed : {true, false}) {
      auto reader = Open(emulators::BuildPgrStream(Frames(3), version, 6100, closed));
      ASSERT_TRUE(reader) << reader.error().message;
      EXPECT_EQ(reader->header().version, version);
      EXPECT_EQ(reader->header().head_serial, 6100U);
      EXPECT_EQ(reader->header().images, closed ? 3U : 0U);
      EXPECT_EQ(Sequences(*reader), (std::vector<std::uint32_t>{10, 11, 12}));
      EXPECT_EQ(reader->damaged(), 0U);
    }
  }
}

TEST(PgrStream, CutOffAnywhereGivesTheWholeFramesBeforeTheCut) {
  const std::vector<std::vector<std::byte>> frames = Frames(3);
  const std::vector<std::byte> file = emulators::BuildPgrStream(frames, 4, 6100, false);
  std::vector<std::size_t> ends;
  std::size_t end = file.size() - frames[0].size() - frames[1].size() - frames[2].size();
  for (const auto& frame : frames) ends.push_back(end += frame.size());
  for (std::size_t length = 0; length < file.size(); length += length % 512 == 0 ? 1 : 511) {
    auto reader = Open({file.begin(), file.begin() + static_cast<std::ptrdiff_t>(length)});
    if (length < ladybug::kPgrHeaderBytes) {
      ASSERT_FALSE(reader) << length;
      continue;
    }
    ASSERT_TRUE(reader) << length;
    const auto whole =
        std::count_if(ends.begin(), ends.end(), [&](std::size_t each) { return each <= length; });
    EXPECT_EQ(Sequences(*reader).size(), static_cast<std::size_t>(whole)) << length;
  }
}

TEST(PgrStream, ADamagedFrameIsPassedOverAndCounted) {
  std::vector<std::vector<std::byte>> frames = Frames(3);
  frames[1][0x14] = std::byte{9};
  auto reader = Open(emulators::BuildPgrStream(frames, 4, 6100));
  ASSERT_TRUE(reader);
  EXPECT_EQ(Sequences(*reader), (std::vector<std::uint32_t>{10, 12}));
  EXPECT_EQ(reader->damaged(), 1U);
  EXPECT_THAT(reader->last_damage(), HasSubstr("header version"));
}

TEST(PgrStream, WhatIsNoStreamOrAnUnknownVersionIsRefused) {
  std::vector<std::byte> file = emulators::BuildPgrStream(Frames(1), 9, 6100);
  EXPECT_THAT(Open(file).error().message, HasSubstr("version 9: expected 4 to 7"));
  file[0] = std::byte{'X'};
  EXPECT_THAT(Open(file).error().message, HasSubstr("no Ladybug stream"));
}

TEST(PgrStream, AnyDamageIsSurvived) {
  const std::vector<std::byte> good = emulators::BuildPgrStream(Frames(3), 4, 6100);
  std::mt19937 random(9);
  for (int round = 0; round < 300; ++round) {
    std::vector<std::byte> file = good;
    for (int i = 0; i < 20; ++i) file[random() % file.size()] = static_cast<std::byte>(random());
    auto reader = Open(std::move(file));
    const std::size_t whole = reader ? Sequences(*reader).size() : 0;
    EXPECT_LE(whole, 3U);
  }
}

}  // namespace
}  // namespace omnihdr::pgr_test
