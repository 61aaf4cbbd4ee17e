// omnihdrd on a storage that is full, read-only, failing, slow or gone, and comes back.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <cerrno>
#include <chrono>
#include <thread>

#include "core/base/crc32c.h"
#include "core/base/file.h"
#include "core/session/session_reader.h"
#include "tests/faults/drive.h"

namespace omnihdr::storage_test {
namespace {

namespace fs = std::filesystem;
using faults::Call;
using faults::File;
using faults::RecordedDrive;
using faults::StorageFaults;
using integration::FilesBelow;
using integration::RunOmnihdr;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr int kBefore = 2;
constexpr int kDuring = 2;
constexpr int kAfter = 2;

struct Trouble {
  std::string name;
  std::function<void(StorageFaults&)> begins;
  std::string message;       // what the status says
  bool lines_get_in = true;  // while it lasts
  bool is_trouble = true;    // and not only slow
  int watch_s = 0;           // how long the views are watched meanwhile
};
void PrintTo(const Trouble& trouble, std::ostream* out) { *out << trouble.name; }

class Storage : public ::testing::TestWithParam<Trouble> {
 protected:
  void Trigger(int count) {
    for (int i = 0; i < count; ++i) {
      ASSERT_TRUE(drive_.StatusHolds(
          [](const auto& s) { return s["state"] != "starting" && s["camera"]["ready"] == true; }));
      // The camera may still be busy with the one before: that would be a missed trigger.
      ASSERT_TRUE(drive_.StatusHolds([this](const auto& s) {
        return lines_must_get_in_ ? s["triggers"]["in_flight"] == 0 : true;
      })) << drive_.Log();
      ASSERT_TRUE(integration::Eventually(
          [&] { return static_cast<bool>(drive_.Client().Post("/v1/trigger")); }));
      ++triggered_;
    }
  }
  RecordedDrive drive_{kBefore + kDuring + kAfter, "software"};
  bool lines_must_get_in_ = true;
  int triggered_ = 0;
};

TEST_P(Storage, IsToldOfAndEveryTriggerHasItsLineAndNothingIsLostThatWasThere) {
  const Trouble& trouble = GetParam();
  const auto daemon = drive_.Start();
  ASSERT_TRUE(drive_.StatusHolds([](const auto& s) { return s["state"] == "armed"; }));
  ASSERT_NO_FATAL_FAILURE(Trigger(kBefore));
  ASSERT_TRUE(drive_.StatusHolds([](const auto& s) { return s["frames_recorded"] == kBefore; }));
  const std::string before = drive_.JournalText();

  trouble.begins(drive_.faults());
  lines_must_get_in_ = trouble.lines_get_in;
  ASSERT_NO_FATAL_FAILURE(Trigger(kDuring));
  if (trouble.lines_get_in) {
    ASSERT_TRUE(drive_.StatusHolds([](const auto& s) { return s["triggers"]["in_flight"] == 0; }));
  }
  if (trouble.is_trouble) {
    ASSERT_TRUE(drive_.StatusHolds([](const auto& s) { return s["state"] == "storage-full"; }))
        << drive_.Log();
    EXPECT_THAT(drive_.Status()["reason"].get<std::string>(), HasSubstr(trouble.message));
    EXPECT_GT(drive_.faults().failed(), 0U);
  }
  EXPECT_TRUE(drive_.JournalText().starts_with(before));
  // The pipeline never sees a line that is taken back.
  const auto watched = std::chrono::steady_clock::now() + std::chrono::seconds(trouble.watch_s);
  while (std::chrono::steady_clock::now() < watched) {
    const nlohmann::json status = drive_.Status();
    if (status.is_object()) {
      ASSERT_THAT(status["views"]["error"].get<std::string>(), Not(HasSubstr("frames.jsonl")));
    }
    std::this_thread::sleep_for(std::chrono::milliseconds(20));
  }

  drive_.faults().Clear();
  lines_must_get_in_ = true;
  ASSERT_NO_FATAL_FAILURE(Trigger(kAfter));
  ASSERT_TRUE(drive_.StatusHolds([](const auto& s) {
    return s["triggers"]["in_flight"] == 0 && s["state"] != "storage-full";
  })) << drive_.Log();
  ASSERT_TRUE(drive_.Client().Post("/v1/stop"));
  EXPECT_EQ(daemon->Wait(std::chrono::seconds(120)), 0) << drive_.Log();

  const auto contents = ReadSession(drive_.session());
  ASSERT_TRUE(contents) << contents.error().message;
  EXPECT_TRUE(drive_.JournalText().starts_with(before));
  ASSERT_EQ(contents->journal.frames.size(), static_cast<std::size_t>(triggered_));
  int lost = 0;
  for (const FrameRecord& record : contents->journal.frames) {
    if (record.status != FrameStatus::kOk) {
      ++lost;
      EXPECT_EQ(record.status, FrameStatus::kDiskFull);
      EXPECT_THAT(record.detail, HasSubstr(trouble.message));
      EXPECT_GE(Value(record.frame), static_cast<std::uint64_t>(kBefore));
      EXPECT_LT(Value(record.frame), static_cast<std::uint64_t>(kBefore + kDuring));
      continue;
    }
    const auto bytes = ReadFile(drive_.session() / record.file);
    ASSERT_TRUE(bytes) << bytes.error().message;
    EXPECT_EQ(Crc32c(*bytes), record.crc32c);
  }
  // Pixels wait for the disk with their line; only where the line alone gets in they are lost.
  EXPECT_EQ(lost, trouble.is_trouble && trouble.lines_get_in ? kDuring : 0);
  EXPECT_EQ(drive_.Damage(false), "");
  // And the views are those of this journal.
  const auto [code, output] = RunOmnihdr(
      {"process", drive_.session().string(), "--out", (drive_.directory() / "again").string(),
       "--config", (drive_.directory() / "c.toml").string(), "--quiet"},
      drive_.directory());
  ASSERT_EQ(code, 0) << output;
  EXPECT_TRUE(FilesBelow(drive_.session() / "views") ==
              FilesBelow(drive_.directory() / "again" / "views"));
}

constexpr std::uint32_t kAllButTheJournal =
    faults::kAllFiles & ~(1U << static_cast<std::uint32_t>(File::kJournal));

INSTANTIATE_TEST_SUITE_P(
    All, Storage,
    ::testing::Values(
        Trouble{"FullButForTheJournalsReserve",
                [](StorageFaults& f) {
                  f.Fail({Call::kWrite, Call::kMakeDirectory}, ENOSPC, kAllButTheJournal);
                },
                "No space left on device"},
        Trouble{"FullToTheLastByte",
                [](StorageFaults& f) {
                  f.Fail({Call::kWrite, Call::kMakeDirectory, Call::kAllocate}, ENOSPC);
                },
                "No space left on device", false},
        Trouble{"ReadOnly",
                [](StorageFaults& f) {
                  f.Fail({Call::kOpen, Call::kWrite, Call::kMakeDirectory, Call::kRename,
                          Call::kRemove, Call::kTruncate, Call::kAllocate},
                         EROFS);
                },
                "Read-only file system", false},
        Trouble{"FailingToWrite",
                [](StorageFaults& f) { f.Fail({Call::kWrite}, EIO, kAllButTheJournal); },
                "Input/output error"},
        Trouble{"FailingToSynchronise",
                [](StorageFaults& f) {
                  f.Fail({Call::kSync, Call::kSyncDirectory}, EIO);
                },
                "Input/output error", false},
        Trouble{"FailingToSynchroniseTheJournalAfterAWhile",
                [](StorageFaults& f) {
                  f.Slow(1'500'000, 0);
                  f.Fail({Call::kSync}, EIO, 1U << static_cast<std::uint32_t>(File::kJournal));
                },
                "Input/output error", false, true, 5},
        Trouble{"Gone",
                [](StorageFaults& f) {
                  f.Fail(
                      {Call::kOpen, Call::kWrite, Call::kSync, Call::kSyncDirectory, Call::kRename,
                       Call::kMakeDirectory, Call::kRemove, Call::kTruncate, Call::kAllocate},
                      ENODEV);
                },
                "No such device", false},
        Trouble{"Slow", [](StorageFaults& f) { f.Slow(200'000, 0); }, "", true, false}),
    [](const ::testing::TestParamInfo<Trouble>& param) { return param.param.name; });

}  // namespace
}  // namespace omnihdr::storage_test
