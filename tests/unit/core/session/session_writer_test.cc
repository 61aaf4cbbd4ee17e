#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <string>
#include <vector>

#include "core/base/crc32c.h"
#include "core/session/journal.h"
#include "core/session/session_reader.h"
#include "tests/unit/core/session/session_samples.h"

namespace omnihdr::session_writer_test {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

std::vector<std::byte> Pixels(std::size_t size, unsigned seed = 1) {
  std::vector<std::byte> bytes(size);
  for (std::byte& byte : bytes) {
    seed = seed * 1664525U + 1013904223U;
    byte = static_cast<std::byte>(seed >> 24U);
  }
  return bytes;
}

std::string Text(const std::vector<std::byte>& bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

SessionWriter MustCreate(const fs::path& directory) {
  Result<SessionWriter> writer = SessionWriter::Create(directory, test::SampleInfo());
  EXPECT_TRUE(writer) << writer.error().message;
  return std::move(*writer);
}

TEST(SessionWriter, WhatIsAppendedIsReadBackWithItsPixels) {
  const test::TemporaryDirectory directory;
  const fs::path session = directory.path() / "deep" / "er" / "one";
  SessionWriter writer = MustCreate(session);
  for (std::uint64_t i = 0; i < 4; ++i) {
    EXPECT_EQ(writer.next_frame(), i);
    const std::vector<std::byte> pixels = Pixels(1000 + i);
    ASSERT_TRUE(writer.Append(test::SampleRecord(i, static_cast<std::int64_t>(i / 2)), pixels));
    EXPECT_EQ(writer.last_position(), static_cast<std::int64_t>(i / 2));
    EXPECT_EQ(writer.frames_at_last_position(), static_cast<int>(i % 2) + 1);
  }
  const Result<SessionContents> read = ReadSession(session);
  ASSERT_TRUE(read) << read.error().message;
  EXPECT_THAT(read->journal.warnings, IsEmpty());
  EXPECT_EQ(read->info.camera.model, "test camera");
  ASSERT_EQ(read->journal.frames.size(), 4U);
  for (std::uint64_t i = 0; i < 4; ++i) {
    const FrameRecord& frame = read->journal.frames[i];
    const std::vector<std::byte> pixels = Pixels(1000 + i);
    EXPECT_EQ(test::Slurp(session / frame.file), Text(pixels));
    EXPECT_EQ(frame.crc32c, Crc32c(pixels));
  }
}

TEST(SessionWriter, ATriggerWithoutPixelsGetsALine) {
  const test::TemporaryDirectory directory;
  SessionWriter writer = MustCreate(directory.path());
  FrameRecord record = test::SampleRecord(0, 0);
  record.file.clear();
  record.status = FrameStatus::kCameraTimeout;
  ASSERT_TRUE(writer.Append(record, {}));
  EXPECT_EQ(ReadSession(directory.path())->journal.frames[0].status, FrameStatus::kCameraTimeout);
}

TEST(SessionWriter, RefusesADirectoryThatHoldsASession) {
  const test::TemporaryDirectory directory;
  { const SessionWriter writer = MustCreate(directory.path()); }
  const Result<SessionWriter> second = SessionWriter::Create(directory.path(), test::SampleInfo());
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().kind, ErrorKind::kCannotCreate);
  EXPECT_THAT(second.error().message, HasSubstr("already holds a session"));
}

TEST(SessionWriter, RefusesASecondWriter) {
  const test::TemporaryDirectory directory;
  const SessionWriter writer = MustCreate(directory.path());
  const Result<SessionWriter> second = SessionWriter::Resume(directory.path());
  ASSERT_FALSE(second);
  EXPECT_EQ(second.error().kind, ErrorKind::kTemporary);
  EXPECT_THAT(second.error().message, HasSubstr("another process is writing this session"));
}

TEST(SessionWriter, DoesNotBeginANewJournalOverThePicturesOfOneThatIsGone) {
  const test::TemporaryDirectory directory;
  {
    SessionWriter writer = MustCreate(directory.path());
    ASSERT_TRUE(writer.Append(test::SampleRecord(0, 0), Pixels(10)));
  }
  fs::remove(directory.path() / "frames.jsonl");
  const Result<SessionWriter> resumed = SessionWriter::Resume(directory.path());
  ASSERT_FALSE(resumed);
  EXPECT_EQ(resumed.error().kind, ErrorKind::kData);
  EXPECT_THAT(resumed.error().message, HasSubstr("frames.jsonl: missing"));
  EXPECT_FALSE(fs::exists(directory.path() / "frames.jsonl"));
  fs::remove_all(directory.path() / "raw");
  EXPECT_TRUE(SessionWriter::Resume(directory.path()));
}

TEST(SessionWriter, RefusesWhatCouldNotBeReadBack) {
  const test::TemporaryDirectory directory;
  SessionWriter writer = MustCreate(directory.path());
  FrameRecord no_exposure = test::SampleRecord(0, 0);
  no_exposure.exposure.time = ExposureTime::Seconds(0.0);
  FrameRecord outside = test::SampleRecord(0, 0);
  outside.file = "../outside.png";
  FrameRecord nameless = test::SampleRecord(0, 0);
  nameless.file.clear();
  nameless.status = FrameStatus::kCorrupt;
  for (const FrameRecord& record : {no_exposure, outside, nameless}) {
    const Status status = writer.Append(record, Pixels(10));
    ASSERT_FALSE(status);
    EXPECT_EQ(status.error().kind, ErrorKind::kSoftware);
    EXPECT_THAT(status.error().message, HasSubstr("append frame 0"));
  }
  EXPECT_EQ(test::Slurp(directory.path() / "frames.jsonl"), "");
  EXPECT_FALSE(fs::exists(directory.path().parent_path() / "outside.png"));
  ASSERT_TRUE(writer.Append(test::SampleRecord(0, 0), Pixels(10)));
  const Status again = writer.Append(test::SampleRecord(0, 0), Pixels(10));
  ASSERT_FALSE(again);
  EXPECT_THAT(again.error().message, HasSubstr("expected a frame number of 1 or more"));

  SessionInfo bad = test::SampleInfo();
  bad.camera.width = 3;
  const Result<SessionWriter> created = SessionWriter::Create(directory.path() / "b", bad);
  ASSERT_FALSE(created);
  EXPECT_THAT(created.error().message, HasSubstr("camera.width: 3"));
  EXPECT_FALSE(fs::exists(directory.path() / "b"));
}

TEST(SessionWriter, ResumesAfterAJournalCutAtAnyByte) {
  const test::TemporaryDirectory directory;
  const fs::path original = directory.path() / "original";
  {
    SessionWriter writer = MustCreate(original);
    for (std::uint64_t i = 0; i < 3; ++i) {
      ASSERT_TRUE(writer.Append(test::SampleRecord(i, static_cast<std::int64_t>(i)), Pixels(20)));
    }
  }
  const std::string journal = test::Slurp(original / "frames.jsonl");
  const std::string info = test::Slurp(original / "session.json");
  const fs::path session = directory.path() / "cut";
  for (std::size_t length = 0; length <= journal.size(); ++length) {
    fs::remove_all(session);
    test::Spill(session / "session.json", info);
    test::Spill(session / "frames.jsonl", journal.substr(0, length));
    test::Spill(session / "raw/000009.png.tmp", "unfinished");
    std::size_t whole = 0;
    {
      Result<SessionWriter> writer = SessionWriter::Resume(session);
      ASSERT_TRUE(writer) << writer.error().message;
      whole = writer->next_frame();
      EXPECT_EQ(writer->last_position(), static_cast<std::int64_t>(whole) - 1);
      const bool torn = length > 0 && journal[length - 1] != '\n' && journal[length] != '\n';
      EXPECT_EQ(writer->warnings().size(), torn ? 1U : 0U) << length;
      EXPECT_FALSE(fs::exists(session / "raw/000009.png.tmp"));
      ASSERT_TRUE(writer->Append(test::SampleRecord(whole, 7), Pixels(20)));
    }
    const Result<SessionContents> read = ReadSession(session);
    ASSERT_TRUE(read) << read.error().message;
    EXPECT_THAT(read->journal.warnings, IsEmpty()) << length;
    EXPECT_THAT(read->journal.rejected, IsEmpty()) << length;
    ASSERT_EQ(read->journal.frames.size(), whole + 1);
    // What was there is still there, byte by byte.
    const std::string after = test::Slurp(session / "frames.jsonl");
    std::size_t kept = 0;
    for (std::size_t i = 0; i < whole; ++i) kept = journal.find('\n', kept) + 1;
    EXPECT_EQ(after.substr(0, kept), journal.substr(0, kept));
    // A line counts from its closing brace on.
    EXPECT_EQ(static_cast<std::ptrdiff_t>(whole),
              std::count(journal.begin(),
                         journal.begin() +
                             static_cast<std::ptrdiff_t>(std::min(length + 1, journal.size())),
                         '\n'));
  }
}

TEST(SessionWriter, KilledAtAnyMomentItLeavesAJournalThatResumes) {
  const test::TemporaryDirectory directory;
  const fs::path session = directory.path() / "s";
  { const SessionWriter writer = MustCreate(session); }
  unsigned random = 20260101;
  std::size_t checked = 0;
  for (int round = 0; round < 60; ++round) {
    int told[2] = {-1, -1};  // the child tells every frame that Append has reported as stored
    ASSERT_EQ(::pipe(told), 0);
    const pid_t child = ::fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      Result<SessionWriter> writer = SessionWriter::Resume(session);
      for (unsigned i = 0; writer && i < 100'000; ++i) {
        const std::uint64_t frame = writer->next_frame();
        const auto position = static_cast<std::int64_t>(frame);
        if (!writer->Append(test::SampleRecord(frame, position), Pixels(3000))) break;
        if (::write(told[1], &frame, sizeof(frame)) != sizeof(frame)) break;
      }
      ::_exit(1);  // only when something above failed
    }
    ::close(told[1]);
    pollfd first{told[0], POLLIN, 0};
    ASSERT_EQ(::poll(&first, 1, 30'000), 1) << "the writer stores nothing";
    random = random * 1664525U + 1013904223U;
    ::usleep((random >> 16U) % 3000);
    ::kill(child, SIGKILL);
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFSIGNALED(status)) << "the writer failed by itself";
    std::int64_t last_told = -1;
    for (std::uint64_t frame = 0; ::read(told[0], &frame, sizeof(frame)) == sizeof(frame);) {
      last_told = static_cast<std::int64_t>(frame);
    }
    ::close(told[0]);

    const Result<SessionContents> read = ReadSession(session);
    ASSERT_TRUE(read) << read.error().message;
    EXPECT_THAT(read->journal.rejected, IsEmpty());
    const std::vector<FrameRecord>& frames = read->journal.frames;
    EXPECT_GE(static_cast<std::int64_t>(frames.size()) - 1, last_told);
    EXPECT_GE(last_told, static_cast<std::int64_t>(checked));
    for (; checked < frames.size(); ++checked) {
      ASSERT_EQ(Value(frames[checked].frame), checked);
      ASSERT_EQ(test::Slurp(session / frames[checked].file), Text(Pixels(3000)));
    }
  }
}

TEST(SessionWriter, ResumeKeepsRejectedLinesAndDoesNotReuseTheirNumbers) {
  const test::TemporaryDirectory directory;
  { const SessionWriter writer = MustCreate(directory.path()); }
  const std::string bad = "{\"frame\": 41, \"position\": 0, \"status\": \"fine\"}\nrubbish\n";
  test::Spill(directory.path() / "frames.jsonl", bad);
  Result<SessionWriter> writer = SessionWriter::Resume(directory.path());
  ASSERT_TRUE(writer) << writer.error().message;
  EXPECT_EQ(writer->warnings().size(), 2U);
  EXPECT_EQ(writer->next_frame(), 42U);
  ASSERT_TRUE(writer->Append(test::SampleRecord(42, 0), Pixels(5)));
  EXPECT_TRUE(test::Slurp(directory.path() / "frames.jsonl").starts_with(bad));
  EXPECT_EQ(ReadSession(directory.path())->journal.frames.size(), 1U);
}

TEST(SessionWriter, ResumeWithoutASessionIsAnError) {
  const test::TemporaryDirectory directory;
  const Result<SessionWriter> writer = SessionWriter::Resume(directory.path());
  ASSERT_FALSE(writer);
  EXPECT_EQ(writer.error().kind, ErrorKind::kNoInput);
  EXPECT_FALSE(fs::exists(directory.path() / "frames.jsonl"));
}

TEST(SessionWriter, CreateAfterACrashBeforeSessionJsonSucceeds) {
  const test::TemporaryDirectory directory;
  test::Spill(directory.path() / "frames.jsonl", "");
  fs::create_directory(directory.path() / "raw");
  EXPECT_TRUE(SessionWriter::Create(directory.path(), test::SampleInfo()));
}

}  // namespace
}  // namespace omnihdr::session_writer_test
