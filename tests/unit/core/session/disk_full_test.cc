#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <signal.h>
#include <sys/mount.h>
#include <sys/resource.h>
#include <unistd.h>

#include <optional>
#include <string>
#include <vector>

#include "core/base/file.h"
#include "core/session/journal.h"
#include "core/session/session_reader.h"
#include "core/session/view_writer.h"
#include "tests/unit/core/session/session_samples.h"

namespace omnihdr::disk_full_test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// While it lives, no file of this process can grow beyond `bytes`: writes stop half-way with EFBIG,
// as they do with ENOSPC on a full disk.
class FileSizeLimit {
 public:
  explicit FileSizeLimit(rlim_t bytes) {
    ::signal(SIGXFSZ, SIG_IGN);
    ::getrlimit(RLIMIT_FSIZE, &before_);
    const rlimit limit{bytes, before_.rlim_max};
    if (::setrlimit(RLIMIT_FSIZE, &limit) != 0) ADD_FAILURE() << "setrlimit";
  }
  ~FileSizeLimit() { ::setrlimit(RLIMIT_FSIZE, &before_); }

 private:
  rlimit before_{};
};

// A small file system of its own, where this process may mount one.
class SmallDisk {
 public:
  static std::optional<std::string> Mount(const fs::path& where, const std::string& size) {
    if (::unshare(CLONE_NEWNS) != 0 && ::unshare(CLONE_NEWUSER | CLONE_NEWNS) != 0) {
      return "unshare is not allowed here";
    }
    if (::mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
        ::mount("none", where.c_str(), "tmpfs", 0, ("size=" + size).c_str()) != 0) {
      return "mount is not allowed here";
    }
    return std::nullopt;
  }
};

std::vector<std::byte> Pixels(std::size_t size) { return std::vector<std::byte>(size); }

// Everything that must hold of a session directory whatever has happened.
void ExpectIntact(const fs::path& session, std::size_t frames) {
  const Result<SessionContents> read = ReadSession(session);
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_THAT(read->journal.warnings, IsEmpty());
  ASSERT_EQ(read->journal.frames.size(), frames);
  for (const FrameRecord& frame : read->journal.frames) {
    if (frame.status != FrameStatus::kOk) continue;
    EXPECT_GT(fs::file_size(session / frame.file), 0U) << frame.file;
  }
}

TEST(DiskFull, PixelsThatDoNotFitGetALineThatSaysSo) {
  const test::TemporaryDirectory directory;
  Result<SessionWriter> writer = SessionWriter::Create(directory.path(), test::SampleInfo());
  ASSERT_TRUE(writer);
  ASSERT_TRUE(writer->Append(test::SampleRecord(0, 0), Pixels(1000)));
  {
    const FileSizeLimit limit(50'000);
    const Status status = writer->Append(test::SampleRecord(1, 1), Pixels(100'000));
    ASSERT_FALSE(status);
    EXPECT_EQ(status.error().kind, ErrorKind::kIo);
    EXPECT_THAT(status.error().message, HasSubstr("append frame 1: "));
    EXPECT_THAT(status.error().message, HasSubstr("File too large"));
  }
  EXPECT_EQ(writer->next_frame(), 2U);
  EXPECT_FALSE(fs::exists(directory.path() / "raw/000001.png"));
  EXPECT_FALSE(fs::exists(directory.path() / "raw/000001.png.tmp"));
  ASSERT_TRUE(writer->Append(test::SampleRecord(2, 2), Pixels(100'000)));
  ExpectIntact(directory.path(), 3);
  const FrameRecord full = ReadSession(directory.path())->journal.frames[1];
  EXPECT_EQ(full.status, FrameStatus::kDiskFull);
  EXPECT_TRUE(full.file.empty());
  EXPECT_FALSE(full.crc32c);
  EXPECT_THAT(full.detail, HasSubstr("File too large"));
}

TEST(DiskFull, ALineThatDoesNotFitLeavesTheLinesBeforeAndCanBeAppendedLater) {
  const test::TemporaryDirectory directory;
  Result<SessionWriter> writer = SessionWriter::Create(directory.path(), test::SampleInfo());
  ASSERT_TRUE(writer);
  FrameRecord record = test::SampleRecord(0, 0);
  record.file.clear();
  record.status = FrameStatus::kMissedTrigger;
  ASSERT_TRUE(writer->Append(record, {}));
  const std::string before = test::Slurp(directory.path() / "frames.jsonl");
  record.frame = FrameId{1};
  const std::size_t line = FormatFrameRecord(record).size() + 1;
  for (std::size_t room = 0; room < line; ++room) {
    {
      const FileSizeLimit limit(before.size() + room);
      const Status status = writer->Append(record, {});
      ASSERT_FALSE(status) << room;
      EXPECT_THAT(status.error().message, HasSubstr("frames.jsonl: write: File too large"));
    }
    ASSERT_EQ(test::Slurp(directory.path() / "frames.jsonl"), before) << room;
    EXPECT_EQ(writer->next_frame(), 1U);
  }
  ASSERT_TRUE(writer->Append(record, {}));
  ExpectIntact(directory.path(), 2);
}

TEST(DiskFull, AViewThatDoesNotFitLeavesNothingBehind) {
  const test::TemporaryDirectory directory;
  const auto fill = [](const fs::path& view) -> Status {
    OMNIHDR_TRY(WriteFileAtomic(view / "view.json", FormatViewRecord(test::SampleView(1))));
    return WriteFileAtomic(view / "radiance.exr", std::string(100'000, 'x'));
  };
  {
    const FileSizeLimit limit(50'000);
    const Status status = WriteView(directory.path(), PositionId{1}, false, fill);
    ASSERT_FALSE(status);
    EXPECT_THAT(status.error().message, HasSubstr("write view 000001: "));
    EXPECT_THAT(status.error().message, HasSubstr("File too large"));
  }
  EXPECT_TRUE(fs::is_empty(directory.path()));
  EXPECT_TRUE(WriteView(directory.path(), PositionId{1}, false, fill));
  EXPECT_EQ(CompleteViews(directory.path())->size(), 1U);
}

TEST(DiskFull, OnAFullFileSystemEveryTriggerIsStillAccountedFor) {
  const test::TemporaryDirectory directory;
  if (const auto reason = SmallDisk::Mount(directory.path(), "512k")) {
    GTEST_SKIP() << "SKIPPED: " << *reason << ": a full file system is not tested";
  }
  const fs::path session = directory.path() / "s";
  Result<SessionWriter> writer = SessionWriter::Create(session, test::SampleInfo());
  ASSERT_TRUE(writer) << writer.error().message;
  std::size_t stored = 0;
  std::size_t refused = 0;
  for (std::uint64_t i = 0; i < 40; ++i) {
    const Status status =
        writer->Append(test::SampleRecord(i, static_cast<std::int64_t>(i)), Pixels(30'000));
    if (status) {
      ++stored;
    } else {
      ++refused;
      EXPECT_THAT(status.error().message, HasSubstr("No space left on device"));
    }
    ASSERT_EQ(writer->next_frame(), i + 1) << status.error().message;
  }
  EXPECT_GT(stored, 5U);
  EXPECT_GT(refused, 5U);
  ExpectIntact(session, 40);

  const Status view =
      WriteView(session / "views", PositionId{1}, false, [](const fs::path& path) -> Status {
        OMNIHDR_TRY(WriteFileAtomic(path / "view.json", FormatViewRecord(test::SampleView(1))));
        return WriteFileAtomic(path / "radiance.exr", std::string(100'000, 'x'));
      });
  ASSERT_FALSE(view);
  EXPECT_THAT(view.error().message, HasSubstr("No space left on device"));
  EXPECT_TRUE(fs::is_empty(session / "views"));

  // Room again: it goes on where it was.
  fs::remove(session / "raw/000000.png");
  fs::remove(session / "raw/000001.png");
  ASSERT_TRUE(writer->Append(test::SampleRecord(40, 40), Pixels(30'000)));
  ::umount2(directory.path().c_str(), MNT_DETACH);
}

}  // namespace
}  // namespace omnihdr::disk_full_test
