// Journal and views, the writers alone: killed at every call that changes a file, and with every
// such call failing once.

#include <fcntl.h>
#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cstdlib>
#include <functional>
#include <set>

#include "core/base/crc32c.h"
#include "core/base/file.h"
#include "core/session/journal.h"
#include "core/session/session_reader.h"
#include "core/session/view_writer.h"
#include "tests/faults/storage_faults.h"
#include "tests/integration/programs.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::writer_test {
namespace {

namespace fs = std::filesystem;
using faults::Call;
using faults::Moment;
using faults::StorageFaults;
using integration::FilesBelow;

constexpr int kFrames = 4;
constexpr int kSomethingFailed = 3;  // the drive's exit code when it could not go on

std::string PixelsOf(int frame) {
  return std::string(3000, static_cast<char>('a' + frame)) + "end";
}

FrameRecord RecordOf(int frame) {
  FrameRecord record;
  record.frame = FrameId{static_cast<std::uint64_t>(frame)};
  record.position = PositionId{frame};
  record.file = fmt::format("raw/{:06}.png", frame);
  record.exposure.time = ExposureTime::Seconds(0.004);
  record.trigger_time = HostTime::FromNanoseconds(1'000'000'000LL * (frame + 1));
  record.timestamp = record.trigger_time;
  return record;
}

SessionInfo Info() {
  SessionInfo info;
  info.created = "2026-01-01T00:00:00Z";
  info.camera.model = "test";
  info.camera.width = 128;
  info.camera.height = 64;
  info.files.push_back({"note.txt", "what lies beside it"});
  return info;
}

Status FillView(const fs::path& directory, int position) {
  for (const char* name : {"radiance.exr", "preview.jpg"}) {
    OMNIHDR_TRY(WriteFileAtomic(directory / name,
                                std::string_view(fmt::format("{} of {}", name, position))));
  }
  ViewRecord record;
  record.position = PositionId{position};
  record.frames = {static_cast<std::uint64_t>(position)};
  record.reference = static_cast<std::uint64_t>(position);
  record.mode = "temporal";
  record.valid_fraction = 1.0;
  return WriteFileAtomic(directory / "view.json", FormatViewRecord(record));
}

// What the daemon does with a session, from wherever it is to the end: frames, each followed by its
// view. `appended` hears of every line that is said to be durable.
Status Drive(const fs::path& session, const std::function<void(int)>& appended) {
  std::error_code error;
  Result<SessionWriter> writer = fs::exists(session / "session.json", error)
                                     ? SessionWriter::Resume(session)
                                     : SessionWriter::Create(session, Info());
  if (!writer) return Forward(writer.error());
  OMNIHDR_TRY(RemoveTemporaryViews(session / "views"));
  OMNIHDR_ASSIGN(const auto views, CompleteViews(session / "views"));
  for (int frame = 0; frame < kFrames; ++frame) {
    if (static_cast<std::uint64_t>(frame) >= writer->next_frame()) {
      const std::string pixels = PixelsOf(frame);
      OMNIHDR_TRY(writer->Append(RecordOf(frame), std::as_bytes(std::span(pixels))));
      appended(frame);
    }
    if (std::find(views.begin(), views.end(), PositionId{frame}) != views.end()) continue;
    OMNIHDR_TRY(WriteView(session / "views", PositionId{frame}, false,
                          [&](const fs::path& directory) { return FillView(directory, frame); }));
  }
  return WriteFileAtomic(session / "ended.json", std::string_view("{}\n"));
}

// Where synchronising costs nothing: this is about order, and there are thousands of runs.
class Writers : public ::testing::Test {
 protected:
  Writers() : directory_(InMemory()) {}
  fs::path session() const { return directory_.path() / "s"; }
  void Fresh() const { fs::remove_all(session()); }

  // Runs Drive in a process of its own: exit code, or 128 + signal. `acknowledged` gets the frames
  // it was told are durable.
  int Run(std::set<int>* acknowledged = nullptr) const {
    const fs::path told = directory_.path() / "told";
    fs::remove(told);
    const pid_t child = ::fork();
    if (child == 0) {
      const int out = ::open(told.c_str(), O_WRONLY | O_CREAT | O_CLOEXEC, 0644);
      faults_.ActivateHere();
      const Status done = Drive(session(), [out](int frame) {
        const char byte = static_cast<char>(frame);
        if (::write(out, &byte, 1) != 1) ::_exit(4);
      });
      ::_exit(done ? 0 : kSomethingFailed);
    }
    int status = 0;
    EXPECT_EQ(::waitpid(child, &status, 0), child);
    if (acknowledged != nullptr) {
      const Result<std::string> bytes = ReadTextFile(told);
      if (bytes) acknowledged->insert(bytes->begin(), bytes->end());
    }
    return WIFSIGNALED(status) ? 128 + WTERMSIG(status) : WEXITSTATUS(status);
  }

  // Whatever has happened: lines tell the truth, none that was acknowledged is missing, and every
  // view that can be seen is whole.
  void ExpectWhole(const std::set<int>& acknowledged,
                   const std::map<std::string, std::string>& reference) const {
    std::set<int> journaled;
    if (fs::exists(session() / "session.json")) {
      const auto contents = ReadSession(session());
      ASSERT_TRUE(contents) << contents.error().message;
      EXPECT_THAT(contents->journal.rejected, ::testing::IsEmpty());
      for (const FrameRecord& record : contents->journal.frames) {
        journaled.insert(static_cast<int>(Value(record.frame)));
        if (record.status != FrameStatus::kOk) {
          EXPECT_TRUE(record.file.empty());
          continue;
        }
        const auto bytes = ReadFile(session() / record.file);
        ASSERT_TRUE(bytes) << bytes.error().message;
        EXPECT_EQ(Crc32c(*bytes), record.crc32c) << record.file;
      }
    }
    for (const int frame : acknowledged) EXPECT_TRUE(journaled.contains(frame)) << frame;
    for (const auto& [name, bytes] : FilesBelow(session() / "views")) {
      if (name.front() == '.') continue;  // what an interrupted writer left, under no view's name
      const auto found = reference.find("views/" + name);
      ASSERT_NE(found, reference.end()) << name;
      EXPECT_EQ(found->second, bytes) << name;
      EXPECT_TRUE(fs::exists((session() / "views" / name).parent_path() / "view.json")) << name;
    }
  }

  static fs::path InMemory() {
    return ::access("/dev/shm", W_OK) == 0 ? fs::path("/dev/shm") : fs::temp_directory_path();
  }

  const testing::TemporaryDirectory directory_;
  StorageFaults faults_{directory_.path() / "faults", session()};
};

TEST_F(Writers, KilledAtAnyCallTheyGoOnToTheSameBytes) {
  ASSERT_EQ(Run(), 0);
  const auto reference = FilesBelow(session());
  const std::uint64_t calls = faults_.calls();
  ASSERT_EQ(reference.size(), 2U + 2 + kFrames + 3 * kFrames);
  ASSERT_GT(calls, 100U) << "the library does not see the calls";
  std::uint64_t killed = 0;
  for (std::uint64_t call = 1; call <= calls; ++call) {
    for (const Moment moment : {Moment::kBefore, Moment::kHalf, Moment::kAfter}) {
      SCOPED_TRACE(fmt::format("killed {} call {}", ToString(moment), call));
      Fresh();
      faults_.Clear();
      faults_.KillAt(call, moment);
      std::set<int> acknowledged;
      ASSERT_EQ(Run(&acknowledged), 128 + SIGKILL);
      ++killed;
      ExpectWhole(acknowledged, reference);
      faults_.Clear();
      ASSERT_EQ(Run(), 0);
      ASSERT_TRUE(FilesBelow(session()) == reference);
    }
  }
  EXPECT_EQ(killed, 3 * calls);
  RecordProperty("kills", static_cast<int>(killed));
}

TEST_F(Writers, KilledAgainWhileTheyMendTheyStillGoOnToTheSameBytes) {
  ASSERT_EQ(Run(), 0);
  const auto reference = FilesBelow(session());
  const std::uint64_t calls = faults_.calls();
  // Every call of a second run after a kill at every tenth of the first.
  for (std::uint64_t call = 3; call <= calls; call += 10) {
    for (std::uint64_t again = 1; again < 12; ++again) {
      SCOPED_TRACE(fmt::format("killed in call {}, then in call {}", call, again));
      Fresh();
      std::set<int> acknowledged;
      faults_.Clear();
      faults_.KillAt(call, Moment::kHalf);
      ASSERT_EQ(Run(&acknowledged), 128 + SIGKILL);
      faults_.Clear();
      faults_.KillAt(again, Moment::kHalf);
      const int second = Run(&acknowledged);
      ASSERT_TRUE(second == 128 + SIGKILL || second == 0) << second;
      ExpectWhole(acknowledged, reference);
      faults_.Clear();
      ASSERT_EQ(Run(), 0);
      ASSERT_TRUE(FilesBelow(session()) == reference);
    }
  }
}

TEST_F(Writers, AnyCallThatFailsOnceCostsAtMostItsOwnFrameWhichSaysSo) {
  ASSERT_EQ(Run(), 0);
  const auto reference = FilesBelow(session());
  const std::uint64_t calls = faults_.calls();
  std::uint64_t failed = 0;
  for (std::uint64_t call = 1; call <= calls; ++call) {
    for (const int error : {ENOSPC, EIO, EROFS}) {
      SCOPED_TRACE(fmt::format("call {} fails with errno {}", call, error));
      Fresh();
      faults_.Clear();
      faults_.FailOnce(call, error);
      std::set<int> acknowledged;
      const int code = Run(&acknowledged);
      ASSERT_TRUE(code == 0 || code == kSomethingFailed) << code;
      failed += faults_.failed();
      ExpectWhole(acknowledged, reference);
      faults_.Clear();
      ASSERT_EQ(Run(), 0);
      auto after = FilesBelow(session());
      // A frame whose pixels could not be stored has a line that says so.
      const auto contents = ReadSession(session());
      ASSERT_TRUE(contents) << contents.error().message;
      ASSERT_EQ(contents->journal.frames.size(), static_cast<std::size_t>(kFrames));
      int lost = 0;
      auto expected = reference;
      for (const FrameRecord& record : contents->journal.frames) {
        if (record.status == FrameStatus::kOk) continue;
        ++lost;
        EXPECT_EQ(record.status, FrameStatus::kDiskFull);
        EXPECT_FALSE(record.detail.empty());
        // The pixels themselves may have got there: when only their directory's entry was not sure.
        const std::string file = fmt::format("raw/{:06}.png", Value(record.frame));
        expected.erase(file);
        after.erase(file);
      }
      EXPECT_LE(lost, 1);
      if (lost > 0) {
        expected.erase("frames.jsonl");
        after.erase("frames.jsonl");
      }
      ASSERT_TRUE(after == expected);
    }
  }
  EXPECT_EQ(failed, 3 * calls);
}

TEST_F(Writers, AJournalCutAnywhereInItsLastLinesGoesOn) {
  ASSERT_EQ(Run(), 0);
  const auto reference = FilesBelow(session());
  const std::string journal = reference.at("frames.jsonl");
  std::vector<std::size_t> ends;
  for (std::size_t i = 0; i < journal.size(); ++i) {
    if (journal[i] == '\n') ends.push_back(i + 1);
  }
  ASSERT_EQ(ends.size(), static_cast<std::size_t>(kFrames));
  for (std::size_t cut = ends[kFrames - 3]; cut <= journal.size(); ++cut) {
    SCOPED_TRACE(fmt::format("cut to {} of {} bytes", cut, journal.size()));
    fs::resize_file(session() / "frames.jsonl", cut);
    // A line that lacks nothing but its newline is one.
    const auto whole = static_cast<std::size_t>(
        std::count_if(ends.begin(), ends.end(), [cut](std::size_t end) { return end <= cut + 1; }));
    const auto contents = ReadSession(session());
    ASSERT_TRUE(contents) << contents.error().message;
    ASSERT_EQ(contents->journal.frames.size(), whole);
    {
      const auto writer = SessionWriter::Resume(session());
      ASSERT_TRUE(writer) << writer.error().message;
      ASSERT_EQ(writer->next_frame(), whole);
    }
    ASSERT_EQ(Run(), 0);
    ASSERT_TRUE(FilesBelow(session()) == reference);
  }
}

TEST_F(Writers, ADiskThatFillsUpAtAnyByteKeepsWhatWasThereAndGoesOnWhenThereIsRoom) {
  ASSERT_EQ(Run(), 0);
  const auto reference = FilesBelow(session());
  std::int64_t total = 0;
  for (const auto& [name, bytes] : reference) total += static_cast<std::int64_t>(bytes.size());
  for (std::int64_t room = 0; room < total; room += 97) {
    SCOPED_TRACE(fmt::format("room for {} of {} bytes", room, total));
    Fresh();
    faults_.Clear();
    faults_.LeaveRoom(room);
    std::set<int> acknowledged;
    ASSERT_EQ(Run(&acknowledged), kSomethingFailed);
    ExpectWhole(acknowledged, reference);
    faults_.Clear();
    ASSERT_EQ(Run(), 0);
    const auto contents = ReadSession(session());
    ASSERT_TRUE(contents) << contents.error().message;
    EXPECT_EQ(contents->journal.frames.size(), static_cast<std::size_t>(kFrames));
    for (const auto& [name, bytes] : FilesBelow(session() / "views")) {
      EXPECT_EQ(reference.at("views/" + name), bytes) << name;
    }
  }
}

}  // namespace
}  // namespace omnihdr::writer_test
