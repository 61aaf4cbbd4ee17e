// A power cut while omnihdrd captures and makes views: unlike a kill it takes with it whatever was
// not synchronised.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <random>
#include <set>

#include "core/session/session_reader.h"
#include "tests/faults/drive.h"
#include "tests/faults/storage_disk.h"

namespace omnihdr::power_test {
namespace {

namespace fs = std::filesystem;
using faults::Call;
using faults::File;
using faults::FromEnvironment;
using faults::RecordedDrive;
using faults::RecordedStep;
using faults::StorageDisk;
using faults::Survives;
using integration::Eventually;
using ::testing::IsEmpty;

constexpr int kPositions = 6;

TEST(PowerCut, AfterAnyCallLosesNothingThatWasJournaledAndShowsNoHalfView) {
  const std::uint64_t resumed_runs = FromEnvironment("OMNIHDR_TORTURE_POWER_CUTS", 4);
  RecordedDrive drive(kPositions);
  drive.Undisturbed();
  const fs::path record = drive.directory() / "calls";
  drive.faults().RecordTo(record);
  {
    const auto daemon = drive.Start();
    ASSERT_TRUE(Eventually([&] { return drive.Ended() || !daemon->running(); })) << drive.Log();
    daemon->Signal(SIGTERM);
    ASSERT_EQ(daemon->Wait(), 0) << drive.Log();
  }
  ASSERT_THAT(drive.Differences(), IsEmpty());
  drive.faults().Clear();
  const std::vector<RecordedStep> steps = faults::ReadRecord(record);
  ASSERT_GT(steps.size(), 200U);

  std::mt19937_64 random(FromEnvironment("OMNIHDR_TORTURE_SEED", 20260101));
  std::set<std::size_t> resumed;
  while (resumed.size() < std::min<std::uint64_t>(resumed_runs, steps.size())) {
    resumed.insert(random() % steps.size());
  }
  StorageDisk disk;
  std::string journal;  // as written
  // What the recorder has said is durable: it goes on to the next frame only then.
  std::string sure_journal;
  std::size_t states = 0;
  for (std::size_t i = 0; i < steps.size(); ++i) {
    const RecordedStep& step = steps[i];
    disk.Apply(step);
    const File file = faults::FileOf(step.path);
    if (file == File::kJournal && step.header.call == Call::kWrite) journal += step.data;
    if (step.header.call == Call::kOpen && (file == File::kPixels || file == File::kEnded)) {
      sure_journal = journal;
    }
    for (const Survives survives :
         {Survives::kOnlyWhatIsSure, Survives::kNames, Survives::kContent}) {
      drive.Fresh();
      disk.Write(survives, drive.session());
      ++states;
      ASSERT_THAT(drive.Problems(sure_journal), IsEmpty())
          << fmt::format("after call {} of {} ({} {}), state {}", i, steps.size(),
                         ToString(step.header.call), step.path, static_cast<int>(survives));
    }
    if (!resumed.contains(i)) continue;
    drive.Fresh();
    disk.Write(Survives::kOnlyWhatIsSure, drive.session());
    ASSERT_EQ(drive.Damage(false), "") << "after call " << i;
    const auto daemon = drive.Start();
    ASSERT_TRUE(Eventually([&] { return drive.Ended() || !daemon->running(); })) << drive.Log();
    daemon->Signal(SIGTERM);
    ASSERT_EQ(daemon->Wait(), 0) << drive.Log();
    ASSERT_THAT(drive.Differences(), IsEmpty()) << "resumed after call " << i;
    ASSERT_EQ(drive.Damage(true), "") << "resumed after call " << i;
  }
  fmt::print(
      "{} disks after a power cut at each of {} calls; {} of them taken up again and ended with "
      "the "
      "bytes of an undisturbed run\n",
      states, steps.size(), resumed.size());
}

}  // namespace
}  // namespace omnihdr::power_test
