// omnihdrd killed while it captures and makes views: at random moments, and at every kind of call
// by which the recorder and the view writer change a file.

#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>

#include <algorithm>
#include <chrono>
#include <cstdio>
#include <random>
#include <thread>

#include "tests/faults/drive.h"

namespace omnihdr::kill_test {
namespace {

using faults::FromEnvironment;
using faults::Moment;
using faults::RecordedDrive;
using faults::StorageFaults;
using integration::Eventually;
using ::testing::IsEmpty;

constexpr int kPositions = 7;

double SecondsSince(std::chrono::steady_clock::time_point start) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count();
}

// Drives that are killed again and again, each taken up until it is complete.
class Killed : public ::testing::Test {
 protected:
  // Judges what lies there after a kill; when the session is complete, judges that and begins anew.
  void Judge(const std::string& journal_before) {
    ASSERT_THAT(drive_.Problems(journal_before), IsEmpty()) << drive_.Log();
    ASSERT_EQ(drive_.Damage(false), "");
    journal_ = drive_.JournalText();
    if (drive_.Ended()) Complete();
  }
  void Complete() {
    ASSERT_THAT(drive_.Differences(), IsEmpty()) << drive_.Log();
    ASSERT_EQ(drive_.Damage(true), "");
    ++sessions_;
    drive_.Fresh();
    journal_.clear();
  }
  // Goes on undisturbed to the end.
  void Finish() {
    drive_.faults().Clear();
    const auto daemon = drive_.Start();
    ASSERT_TRUE(Eventually([&] { return drive_.Ended(); })) << drive_.Log();
    daemon->Signal(SIGTERM);
    ASSERT_EQ(daemon->Wait(), 0) << drive_.Log();
    ASSERT_THAT(drive_.Problems(journal_), IsEmpty()) << drive_.Log();
    Complete();
  }

  RecordedDrive drive_{kPositions};
  std::string journal_;
  int sessions_ = 0;
};

TEST_F(Killed, AtRandomMomentsItEndsWithTheSameBytes) {
  const std::uint64_t kills = FromEnvironment("OMNIHDR_TORTURE_KILLS", 12);
  std::mt19937_64 random(FromEnvironment("OMNIHDR_TORTURE_SEED", 20260101));
  auto start = std::chrono::steady_clock::now();
  drive_.Undisturbed();
  const double whole_s = SecondsSince(start);
  // From before it reads its configuration to well into the views.
  std::uniform_real_distribution<double> moment_s(0.0, 0.5 * whole_s);
  start = std::chrono::steady_clock::now();
  std::uint64_t with_frames = 0;
  for (std::uint64_t kill = 0; kill < kills; ++kill) {
    SCOPED_TRACE(fmt::format("kill {}", kill));
    const auto daemon = drive_.Start();
    std::this_thread::sleep_for(std::chrono::duration<double>(moment_s(random)));
    daemon->Signal(SIGKILL);
    ASSERT_EQ(daemon->Wait(), 128 + SIGKILL) << drive_.Log();
    const std::string before = journal_;
    ASSERT_NO_FATAL_FAILURE(Judge(before));
    if (journal_.size() != before.size()) ++with_frames;
  }
  ASSERT_NO_FATAL_FAILURE(Finish());
  fmt::print(
      "{} kills at random moments, {} of them while frames came; {} sessions, each with the bytes "
      "of an undisturbed run; {:.0f} s\n",
      kills, with_frames, sessions_, SecondsSince(start));
  std::fflush(stdout);  // what follows may take an hour
}

TEST_F(Killed, AtEveryKindOfCallItEndsWithTheSameBytes) {
  // Rounds over all points, each at other ones of their calls; 0: some points, their first call.
  const std::uint64_t rounds = FromEnvironment("OMNIHDR_TORTURE_ROUNDS", 0);
  std::mt19937_64 random(FromEnvironment("OMNIHDR_TORTURE_SEED", 20260101));
  drive_.Undisturbed();
  std::vector<StorageFaults::Point> points = drive_.faults().points();
  ASSERT_GT(points.size(), 25U) << "the library does not see the daemon's calls";
  if (rounds == 0) {
    std::shuffle(points.begin(), points.end(), random);
    points.resize(12);
  }
  const auto start = std::chrono::steady_clock::now();
  int kills = 0;
  std::vector<std::string> not_reached;
  std::size_t turn = 0;
  const auto kill_at = [&](const StorageFaults::Point& point, std::uint64_t number, Moment moment) {
    const std::string name = fmt::format("{} {}, call {}", ToString(moment), point.Name(), number);
    SCOPED_TRACE(name);
    // What is left of a session may not come to the point any more: then once more from nothing.
    for (int attempt = 0; attempt < 2; ++attempt) {
      drive_.faults().Clear();
      drive_.faults().KillAt(point.call, point.file, number, moment);
      const auto daemon = drive_.Start();
      ASSERT_TRUE(Eventually([&] { return !daemon->running() || drive_.Ended(); })) << drive_.Log();
      // Synchronising the session's directory comes after ended.json is there.
      Eventually([&] { return !daemon->running(); }, std::chrono::seconds(drive_.Ended() ? 1 : 0));
      const bool reached = !daemon->running();
      if (!reached) daemon->Signal(SIGKILL);
      ASSERT_EQ(daemon->Wait(), 128 + SIGKILL) << drive_.Log();
      ASSERT_NO_FATAL_FAILURE(Judge(journal_));
      if (reached) {
        ++kills;
        return;
      }
    }
    not_reached.push_back(name);
  };
  for (const StorageFaults::Point& point : points) {
    if (rounds == 0) {
      const auto moment = static_cast<Moment>(turn++ % 3);
      ASSERT_NO_FATAL_FAILURE(kill_at(point, 1, moment));
      continue;
    }
    for (std::uint64_t round = 0; round < rounds; ++round) {
      const std::uint64_t number = 1 + random() % std::min<std::uint64_t>(point.count, 8);
      for (const Moment moment : {Moment::kBefore, Moment::kHalf, Moment::kAfter}) {
        ASSERT_NO_FATAL_FAILURE(kill_at(point, number, moment));
      }
    }
  }
  ASSERT_NO_FATAL_FAILURE(Finish());
  fmt::print(
      "{} kills at {} kinds of calls; {} sessions, each with the bytes of an undisturbed run; "
      "{:.0f} s\n",
      kills, points.size(), sessions_, SecondsSince(start));
  for (const std::string& name : not_reached) fmt::print("not reached: {}\n", name);
  std::fflush(stdout);
  EXPECT_GE(static_cast<std::size_t>(kills), points.size() * 3 / 4);
}

}  // namespace
}  // namespace omnihdr::kill_test
