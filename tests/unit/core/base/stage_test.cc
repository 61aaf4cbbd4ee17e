#include "core/base/stage.h"

#include <gtest/gtest.h>

#include <chrono>
#include <stdexcept>
#include <thread>

namespace omnihdr::stage_test {
namespace {

TEST(Stage, RunsUntilItIsAskedToStop) {
  Stage stage("counter", [](std::stop_token stop, Stage& self) -> Status {
    while (!stop.stop_requested()) {
      self.Progress();
      std::this_thread::yield();
    }
    return {};
  });
  while (stage.progress() < 10) std::this_thread::yield();
  EXPECT_FALSE(stage.finished());
  stage.RequestStop();
  EXPECT_TRUE(stage.Join());
  EXPECT_TRUE(stage.finished());
}

TEST(Stage, TellsHowItEnded) {
  Stage stage("broken",
              [](std::stop_token, Stage&) -> Status { return Fail(ErrorKind::kIo, "no more"); });
  const Status outcome = stage.Join();
  ASSERT_FALSE(outcome);
  EXPECT_EQ(outcome.error().message, "no more");
}

TEST(Stage, AnExceptionEndsTheStageWithAnErrorAndGoesNoFurther) {
  Stage stage("thrower",
              [](std::stop_token, Stage&) -> Status { throw std::runtime_error("oops"); });
  const Status outcome = stage.Join();
  ASSERT_FALSE(outcome);
  EXPECT_EQ(outcome.error().message, "stage thrower: oops");
  EXPECT_EQ(outcome.error().kind, ErrorKind::kSoftware);
}

TEST(Stage, TheDestructorStopsAndJoins) {
  std::atomic<bool> ended = false;
  {
    Stage stage("guarded", [&](std::stop_token stop, Stage&) -> Status {
      while (!stop.stop_requested()) std::this_thread::yield();
      ended = true;
      return {};
    });
  }
  EXPECT_TRUE(ended);
}

}  // namespace
}  // namespace omnihdr::stage_test
