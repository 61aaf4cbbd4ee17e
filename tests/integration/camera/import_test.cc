// `omnihdr import`: recorded streams become a session.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "core/image/image_io.h"
#include "core/session/session_reader.h"
#include "tests/emulators/iidc_link.h"
#include "tests/emulators/ladybug_frame.h"
#include "tests/integration/programs.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::import_test {
namespace {

using integration::RunOmnihdr;
using ::testing::HasSubstr;

class Import : public ::testing::Test {
 protected:
  Import() {
    std::ofstream(path("rig.toml")) << emulators::EmulatedRig(6, 64, 48, BayerOrder::kBggr);
  }
  std::string path(const std::string& name) const { return (directory_.path() / name).string(); }
  // Grey frames of these shutter words, 0.2 s apart.
  void WriteStream(const std::string& name, const std::vector<std::uint32_t>& shutters,
                   std::uint32_t first_sequence = 0) {
    std::vector<std::vector<std::byte>> frames;
    for (std::size_t i = 0; i < shutters.size(); ++i) {
      Image<std::uint8_t> stack(64, 288, 1, static_cast<std::uint8_t>(shutters[i]));
      emulators::LadybugWords words;
      words.shutter = 0x82000000 | shutters[i];
      words.sequence = first_sequence + static_cast<std::uint32_t>(i);
      words.seconds = 1'700'000'000;
      words.microseconds = static_cast<std::uint32_t>(200'000 * i);
      frames.push_back(emulators::BuildLadybugFrame(stack, words));
    }
    const std::vector<std::byte> file = emulators::BuildPgrStream(frames, 4, 6100);
    std::ofstream(path(name), std::ios::binary)
        .write(reinterpret_cast<const char*>(file.data()), static_cast<long>(file.size()));
  }
  std::pair<int, std::string> Run(std::vector<std::string> files,
                                  const std::vector<std::string>& more = {}) {
    std::vector<std::string> arguments = {"import"};
    for (const std::string& file : files) arguments.push_back(path(file));
    for (const char* word : {"--out", "session", "--rig", "rig.toml"}) {
      arguments.push_back(word[0] == '-' ? word : path(word));
    }
    arguments.insert(arguments.end(), {"--shutter-step", "1e-4"});
    arguments.insert(arguments.end(), more.begin(), more.end());
    return RunOmnihdr(arguments, directory_.path());
  }

  testing::TemporaryDirectory directory_;
};

TEST_F(Import, FilesOfARecordingBecomeASessionWithTheirExposuresAndPixels) {
  WriteStream("a-000000.pgr", {40, 120});
  WriteStream("a-000001.pgr", {200, 40}, 3);  // one frame is missing between them
  const auto [code, output] = Run({"a-000000.pgr", "a-000001.pgr"});
  ASSERT_EQ(code, 0) << output;
  EXPECT_THAT(output, HasSubstr("4 frames"));
  EXPECT_THAT(output, HasSubstr("1 frames are missing"));
  const auto contents = ReadSession(path("session"));
  ASSERT_TRUE(contents) << contents.error().message;
  EXPECT_EQ(contents->info.camera.serial, "6100");
  EXPECT_EQ(contents->info.camera.layout, Layout::kRig);
  ASSERT_EQ(contents->journal.frames.size(), 4U);
  const double seconds[] = {0.004, 0.012, 0.02, 0.004};
  for (std::size_t i = 0; i < 4; ++i) {
    const FrameRecord& record = contents->journal.frames[i];
    EXPECT_EQ(record.status, FrameStatus::kOk) << record.detail;
    EXPECT_NEAR(record.exposure.time.seconds(), seconds[i], 1e-9);
    const auto image = ReadImage(path("session") + "/" + record.file);
    ASSERT_TRUE(image);
    EXPECT_NEAR(std::get<Image<std::uint8_t>>(image->pixels).at(9, 99), seconds[i] * 1e4, 1);
  }
  EXPECT_EQ((contents->journal.frames[1].timestamp - contents->journal.frames[0].timestamp).count(),
            200'000'000);
  ASSERT_TRUE(contents->journal.frames[1].utc);
  EXPECT_EQ(contents->journal.frames[1].utc->ns(), 1'700'000'000'200'000'000);
}

TEST_F(Import, WhatCannotBeReadIsRefusedWithItsReason) {
  std::ofstream(path("x.pgr")) << "no stream";
  auto [code, output] = Run({"x.pgr"});
  EXPECT_EQ(code, 65) << output;
  EXPECT_THAT(output, HasSubstr("stream of 9 bytes"));
  std::tie(code, output) = Run({"none.pgr"});
  EXPECT_EQ(code, 66) << output;
  WriteStream("a.pgr", {40});
  std::ofstream(path("rig.toml")) << emulators::EmulatedRig(5, 64, 48, BayerOrder::kBggr);
  std::tie(code, output) = Run({"a.pgr"});
  EXPECT_EQ(code, 78) << output;
}

}  // namespace
}  // namespace omnihdr::import_test
