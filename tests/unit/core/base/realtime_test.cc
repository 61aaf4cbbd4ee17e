#include "core/base/realtime.h"

#include <gtest/gtest.h>
#include <sched.h>

#include <thread>

#include "core/base/stage.h"

namespace omnihdr::realtime_test {
namespace {

// SCHED_FIFO's priority of the calling thread; 0 when it is scheduled as usual.
int PriorityNow() {
  sched_param now{};
  if (::sched_getscheduler(0) != SCHED_FIFO) return 0;
  return ::sched_getparam(0, &now) == 0 ? now.sched_priority : -1;
}

TEST(RealtimeThread, HasItsPriorityWhileItLivesAndARefusalChangesNothing) {
  EXPECT_EQ(PriorityNow(), 0);
  {
    const RealtimeThread realtime(RealtimePriority::kCamera);
    EXPECT_EQ(PriorityNow(), realtime.granted() ? static_cast<int>(RealtimePriority::kCamera) : 0);
  }
  EXPECT_EQ(PriorityNow(), 0);
}

TEST(RealtimeThread, StagesMadeByItAreScheduledAsUsual) {
  const RealtimeThread realtime(RealtimePriority::kTriggers);
  int inherited = -1;
  Stage stage("made", [&](const std::stop_token&, Stage&) {
    inherited = PriorityNow();
    return Status{};
  });
  EXPECT_TRUE(stage.Join());
  EXPECT_EQ(inherited, 0);
}

}  // namespace
}  // namespace omnihdr::realtime_test
