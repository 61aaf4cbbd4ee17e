#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>

#include "core/session/journal.h"
#include "core/session/session_reader.h"
#include "tests/unit/core/session/session_samples.h"

namespace omnihdr::durability_test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class DurabilityTest : public ::testing::Test {
 protected:
  SessionWriter Begin() { return SessionWriter::Create(session(), test::SampleInfo()).value(); }
  static FrameRecord Frame(std::uint64_t number) {
    FrameRecord record = test::SampleRecord(number, static_cast<std::int64_t>(number));
    record.file = fmt::format("raw/{:06}.png", number);
    record.status = FrameStatus::kOk;
    record.detail.clear();
    return record;
  }
  fs::path session() const { return directory_.path() / "s"; }
  fs::path root() const { return directory_.path(); }
  const std::vector<std::byte> pixels_ = std::vector<std::byte>(1000, std::byte{7});

 private:
  test::TemporaryDirectory directory_;
};

TEST_F(DurabilityTest, ByIntervalLinesAndPixelsAreThereAtOnceAndWaitForTheSync) {
  SessionWriter writer = Begin();
  writer.SetDurability(Durability::kInterval);
  for (std::uint64_t i = 0; i < 3; ++i) ASSERT_TRUE(writer.Append(Frame(i), pixels_));
  EXPECT_EQ(writer.unsynced(), 3U);
  EXPECT_EQ(ReadSession(session())->journal.frames.size(), 3U);
  EXPECT_EQ(fs::file_size(session() / "raw/000002.png"), 1000U);
  EXPECT_FALSE(fs::exists(session() / "raw/000002.png.tmp"));
  ASSERT_TRUE(writer.Sync());
  EXPECT_EQ(writer.unsynced(), 0U);
}

TEST_F(DurabilityTest, BySingleFramesNothingWaits) {
  SessionWriter writer = Begin();
  ASSERT_TRUE(writer.Append(Frame(0), pixels_));
  EXPECT_EQ(writer.unsynced(), 0U);
  EXPECT_TRUE(writer.Sync());
}

TEST_F(DurabilityTest, ASyncThatFailsIsSaidAndTriedAgain) {
  SessionWriter writer = Begin();
  writer.SetDurability(Durability::kInterval);
  ASSERT_TRUE(writer.Append(Frame(0), pixels_));
  fs::rename(session() / "raw/000000.png", session() / "elsewhere");
  const Status failed = writer.Sync();
  ASSERT_FALSE(failed);
  EXPECT_THAT(failed.error().message, HasSubstr("000000.png"));
  EXPECT_EQ(writer.unsynced(), 1U);
  fs::rename(session() / "elsewhere", session() / "raw/000000.png");
  EXPECT_TRUE(writer.Sync());
  EXPECT_EQ(writer.unsynced(), 0U);
}

TEST_F(DurabilityTest, InADirectoryThatIsNotTheOneThatWasOpenedNothingIsWritten) {
  SessionWriter writer = Begin();
  ASSERT_TRUE(writer.Append(Frame(0), pixels_));
  // As when a volume is unmounted: the path leads to another place.
  fs::rename(session(), root() / "volume");
  const Status gone = writer.Append(Frame(1), pixels_);
  ASSERT_FALSE(gone);
  EXPECT_FALSE(fs::exists(session()));
  fs::create_directories(session());
  const Status other = writer.Append(Frame(2), pixels_);
  ASSERT_FALSE(other);
  EXPECT_THAT(other.error().message, HasSubstr("expected its file system to stay mounted"));
  EXPECT_TRUE(fs::is_empty(session()));
  // The lines are kept where the session is.
  const auto frames = ReadSession(root() / "volume")->journal.frames;
  ASSERT_EQ(frames.size(), 3U);
  EXPECT_EQ(frames[2].status, FrameStatus::kDiskFull);
}

}  // namespace
}  // namespace omnihdr::durability_test
