#include <gmock/gmock.h>
#include <signal.h>

#include <random>
#include <thread>

#include "core/base/crc32c.h"
#include "core/base/file.h"
#include "tests/integration/daemon_fixture.h"

namespace omnihdr::stop_test {
namespace {

namespace fs = std::filesystem;

class Stop : public integration::DaemonFixture {
 protected:
  // Every line with its picture as it was recorded, every number once, nothing torn.
  void SessionIsReadable() {
    const auto contents = ReadSession(session());
    ASSERT_TRUE(contents) << contents.error().message;
    EXPECT_THAT(contents->journal.rejected, ::testing::IsEmpty());
    for (const std::string& warning : contents->journal.warnings) {
      EXPECT_THAT(warning, ::testing::HasSubstr("the session is empty"));
    }
    std::uint64_t number = 0;
    for (const FrameRecord& record : contents->journal.frames) {
      EXPECT_EQ(Value(record.frame), number++);
      if (record.status != FrameStatus::kOk) continue;
      const auto pixels = ReadFile(session() / record.file);
      ASSERT_TRUE(pixels) << pixels.error().message;
      EXPECT_EQ(Crc32c(*pixels), record.crc32c);
    }
    for (const auto& [name, content] : integration::FilesBelow(session())) {
      EXPECT_FALSE(name.ends_with(".tmp")) << name;
    }
  }
};

TEST_F(Stop, SigtermAtAnyMomentUnderLoadLeavesAReadableSessionThatGoesOn) {
  RecordSource(40);
  std::mt19937 random(1);
  std::uniform_int_distribution<int> delay_ms(0, 1500);
  for (const char* durability : {"frame", "interval"}) {
    SCOPED_TRACE(durability);
    WriteConfig(ReplayCamera("replay"), fmt::format("[recorder]\ndurability = \"{}\"\n"
                                                    "queue_frames = 2\n[pipeline]\nworkers = 1\n",
                                                    durability));
    std::error_code ignored;
    fs::remove_all(session(), ignored);
    std::size_t lines = 0;
    for (int round = 0; round < 5; ++round) {
      const int ms = delay_ms(random);
      SCOPED_TRACE(fmt::format("round {}, {} ms after the camera was ready", round, ms));
      const auto daemon = Start();
      // Where the series is at its end already the camera is ready all the same.
      ASSERT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["ready"] == true; }));
      std::this_thread::sleep_for(std::chrono::milliseconds(ms));
      daemon->Signal(SIGTERM);
      ASSERT_EQ(daemon->Wait(), 0) << daemon->Log();
      SessionIsReadable();
      const std::size_t now = Journal().size();
      EXPECT_GE(now, lines);
      lines = now;
    }
    EXPECT_GT(lines, 0U);
  }
}

}  // namespace
}  // namespace omnihdr::stop_test
