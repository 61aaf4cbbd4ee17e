#include "daemon/supervisor.h"

#include <gtest/gtest.h>

#include "daemon/logging.h"

namespace omnihdr::supervisor_test {
namespace {

using std::chrono::seconds;

HostTime At(seconds time) { return HostTime::FromNanoseconds(Nanoseconds(time).count()); }

TEST(Supervisor, AStageThatGoesOnIsNotStalled) {
  Supervisor supervisor;
  std::uint64_t progress = 0;
  supervisor.Watch(
      "camera", [&] { return progress; }, seconds(10), At(seconds(0)));
  for (int i = 1; i < 100; ++i) {
    if (i % 5 == 0) ++progress;
    ASSERT_EQ(supervisor.Stalled(At(seconds(i))), std::nullopt) << i;
  }
}

TEST(Supervisor, AStageThatStandsStillLongerThanItsPatienceIsNamed) {
  Supervisor supervisor;
  std::uint64_t recorder = 0;
  supervisor.Watch(
      "camera", [] { return std::uint64_t{7}; }, seconds(60), At(seconds(0)));
  supervisor.Watch(
      "recorder", [&] { return recorder; }, seconds(10), At(seconds(0)));
  EXPECT_EQ(supervisor.Stalled(At(seconds(10))), std::nullopt);
  EXPECT_EQ(supervisor.Stalled(At(seconds(12))), "recorder has made no progress for 12 s");
  ++recorder;
  EXPECT_EQ(supervisor.Stalled(At(seconds(13))), std::nullopt);
}

TEST(Supervisor, TimeInWhichOthersHadTheProcessorsDoesNotCount) {
  Supervisor supervisor;
  Nanoseconds waited = seconds(1000);  // before it was watched
  supervisor.Watch(
      "pipeline", [] { return std::uint64_t{7}; }, seconds(10), At(seconds(0)),
      [&] { return waited; });
  waited += seconds(30);
  EXPECT_EQ(supervisor.Stalled(At(seconds(40))), std::nullopt);
  EXPECT_EQ(supervisor.Stalled(At(seconds(41))), "pipeline has made no progress for 41 s");
}

TEST(FloodGate, OneMessageASecondPassesAndStandsForTheRest) {
  FloodGate gate;
  EXPECT_EQ(gate.Pass(At(seconds(5))), 1U);
  for (int i = 0; i < 10; ++i) EXPECT_EQ(gate.Pass(At(seconds(5))), std::nullopt);
  EXPECT_EQ(gate.Pass(At(seconds(6))), 11U);
  EXPECT_EQ(gate.Pass(At(seconds(9))), 1U);
}

}  // namespace
}  // namespace omnihdr::supervisor_test
