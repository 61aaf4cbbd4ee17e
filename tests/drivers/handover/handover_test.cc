// Requests one way, frames the other, and the end of both.

#include "drivers/handover/handover.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <thread>

namespace omnihdr::handover_test {
namespace {

using std::chrono::milliseconds;
using ::testing::HasSubstr;

constexpr Nanoseconds kLong = std::chrono::seconds(5);

HandoverLimits Limits(std::size_t requests = 1) {
  HandoverLimits limits;
  limits.shortest = ExposureTime::Seconds(0.001);
  limits.longest = ExposureTime::Seconds(0.1);
  limits.most_gain_db = 12.0;
  limits.requests = requests;
  return limits;
}

ExposureRequest Request(std::uint64_t number, double seconds = 0.01, double gain_db = 0.0) {
  ExposureRequest request;
  request.trigger = TriggerId{number};
  request.exposure = {ExposureTime::Seconds(seconds), GainDb{gain_db}};
  return request;
}

CameraFrame FrameOf(const ExposureRequest& request) {
  CameraFrame frame;
  frame.trigger = request.trigger;
  return frame;
}

class HandoverTest : public ::testing::Test {
 protected:
  ~HandoverTest() override {
    handover_.Stop([](bool) {});
  }
  // A worker that does nothing: the test takes its place.
  void Begin(HandoverLimits limits = Limits()) {
    handover_.Open(std::move(limits));
    handover_.Start("idle", [](const std::stop_token&, Stage&) { return Status(); });
  }
  std::optional<ExposureRequest> Take(Nanoseconds timeout = Nanoseconds(0)) {
    return handover_.Take(timeout, std::stop_token());
  }
  ErrorKind TriggerError(const ExposureRequest& request, const char* says) {
    const Status status = handover_.Trigger(request);
    EXPECT_FALSE(status);
    if (status) return ErrorKind::kSoftware;
    EXPECT_THAT(status.error().message, HasSubstr(says));
    return status.error().kind;
  }

  Handover handover_{"camera under test"};
};

TEST_F(HandoverTest, AHintWakesTheWorkerOnceAndGivesWayToARequest) {
  Begin();
  EXPECT_FALSE(handover_.TakeHint());
  handover_.Prepare({ExposureTime::Seconds(0.02), GainDb{0.0}});
  handover_.Prepare({ExposureTime::Seconds(0.03), GainDb{0.0}});
  const SystemClock clock;
  const HostTime before = clock.Now();
  EXPECT_FALSE(Take(kLong)) << "a hint is no request";
  EXPECT_LT(clock.Now() - before, kLong);
  EXPECT_EQ(handover_.TakeHint()->time, ExposureTime::Seconds(0.03)) << "the last one counts";
  EXPECT_FALSE(handover_.TakeHint());
  handover_.Prepare({ExposureTime::Seconds(0.02), GainDb{0.0}});
  ASSERT_TRUE(handover_.Trigger(Request(0)));
  EXPECT_TRUE(Take());
}

TEST_F(HandoverTest, WhatTriggerWouldRefuseIsNoHint) {
  Begin();
  handover_.Prepare({ExposureTime::Seconds(1.0), GainDb{0.0}});
  handover_.Prepare({ExposureTime::Seconds(0.01), GainDb{20.0}});
  EXPECT_FALSE(handover_.TakeHint());
  handover_.Prepare({ExposureTime::Seconds(0.01), GainDb{0.0}});
  handover_.GoAway("unplugged");
  EXPECT_FALSE(handover_.TakeHint());
}

TEST_F(HandoverTest, EveryTriggerOfACallerThreadIsTakenOnceAndEveryFrameReceivedInOrder) {
  handover_.Open(Limits());
  std::atomic<std::uint64_t> worked{0};
  handover_.Start("worker", [&](const std::stop_token& stop, Stage&) {
    while (!stop.stop_requested()) {
      const std::optional<ExposureRequest> request = handover_.Take(milliseconds(20), stop);
      if (!request) continue;
      EXPECT_EQ(Value(request->trigger), worked++);
      handover_.Finish(FrameOf(*request));
    }
    return Status();
  });
  constexpr std::uint64_t kTriggers = 500;
  std::thread caller([&] {
    for (std::uint64_t i = 0; i < kTriggers;) {
      const Status status = handover_.Trigger(Request(i));
      if (status) {
        ++i;
      } else {
        ASSERT_EQ(status.error().kind, ErrorKind::kTemporary);
        std::this_thread::yield();
      }
    }
  });
  for (std::uint64_t i = 0; i < kTriggers; ++i) {
    const Result<CameraFrame> frame = handover_.Receive(kLong);
    ASSERT_TRUE(frame) << frame.error().message;
    EXPECT_EQ(Value(frame->trigger), i);
  }
  caller.join();
  EXPECT_EQ(worked, kTriggers);
}

TEST_F(HandoverTest, ARequestIsBusyUntilItIsDoneEvenWhenItsFrameWasDelivered) {
  Begin();
  ASSERT_TRUE(handover_.Trigger(Request(0)));
  EXPECT_EQ(TriggerError(Request(1), "busy with the picture before"), ErrorKind::kTemporary);
  const std::optional<ExposureRequest> taken = Take();
  ASSERT_TRUE(taken);
  EXPECT_EQ(TriggerError(Request(1), "busy"), ErrorKind::kTemporary);
  handover_.Deliver(FrameOf(*taken));
  EXPECT_TRUE(handover_.Receive(Nanoseconds(0)));
  EXPECT_EQ(TriggerError(Request(1), "busy"), ErrorKind::kTemporary);
  handover_.Done();
  EXPECT_TRUE(handover_.Trigger(Request(1)));
}

TEST_F(HandoverTest, AsManyRequestsAreOnTheirWayAsTheCameraTakes) {
  Begin(Limits(2));
  ASSERT_TRUE(handover_.Trigger(Request(0)));
  ASSERT_TRUE(Take());
  ASSERT_TRUE(handover_.Trigger(Request(1)));
  EXPECT_EQ(TriggerError(Request(2), "busy"), ErrorKind::kTemporary);
  EXPECT_EQ(Value(Take()->trigger), 1U);
  EXPECT_FALSE(Take());
  handover_.Finish(FrameOf(Request(0)));
  EXPECT_TRUE(handover_.Trigger(Request(2)));
}

TEST_F(HandoverTest, PicturesThatNobodyReceivesEndInBusy) {
  Begin();
  std::uint64_t taken = 0;
  while (handover_.Trigger(Request(taken))) {
    ASSERT_LT(taken, 100U);
    ++taken;
    handover_.Finish(FrameOf(*Take()));
  }
  EXPECT_EQ(taken, Handover::kMaxWaiting);
  EXPECT_EQ(TriggerError(Request(9), "4 pictures wait to be received"), ErrorKind::kTemporary);
}

TEST_F(HandoverTest, WhatTheCameraCannotExposeIsRefusedWithItsLimits) {
  HandoverLimits limits = Limits();
  limits.gain_note = "somebody held it";
  Begin(std::move(limits));
  EXPECT_EQ(TriggerError(Request(0, 0.2), "camera under test: exposure 0.2 s: expected 0.001 to "),
            ErrorKind::kUsage);
  EXPECT_EQ(TriggerError(Request(0, 0.0), "expected"), ErrorKind::kUsage);
  EXPECT_EQ(TriggerError(Request(0, 0.01, 13.0), "expected 0 to 12 dB (somebody held it)"),
            ErrorKind::kUsage);
  EXPECT_TRUE(handover_.Trigger(Request(0, 0.1, 12.0)));
}

TEST_F(HandoverTest, BeforeOpenAndStartEveryCallSaysWhatIsMissing) {
  EXPECT_EQ(TriggerError(Request(0), "trigger: not started"), ErrorKind::kUnavailable);
  EXPECT_THAT(handover_.MayStart().error().message, HasSubstr("start: not open"));
  handover_.Open(Limits());
  EXPECT_TRUE(handover_.IsOpen());
  EXPECT_TRUE(handover_.MayStart().value());
  EXPECT_THAT(handover_.Receive(Nanoseconds(0)).error().message, HasSubstr("not started"));
  Begin();
  EXPECT_FALSE(handover_.MayStart().value());
  handover_.Close();
  EXPECT_FALSE(handover_.IsOpen());
}

TEST_F(HandoverTest, ACameraThatGoesEndsAWaitingReceiveAndForgetsWhatWasOnItsWay) {
  Begin();
  ASSERT_TRUE(handover_.Trigger(Request(0)));
  handover_.Deliver(FrameOf(Request(7)));
  ASSERT_TRUE(handover_.Receive(Nanoseconds(0)));
  std::thread worker([&] {
    std::this_thread::sleep_for(milliseconds(20));
    handover_.GoAway("somebody pulled the plug");
  });
  const Result<CameraFrame> gone = handover_.Receive(kLong);
  worker.join();
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().kind, ErrorKind::kUnavailable);
  EXPECT_EQ(gone.error().message, "camera under test: somebody pulled the plug");
  EXPECT_EQ(TriggerError(Request(1), "plug"), ErrorKind::kUnavailable);
  EXPECT_THAT(handover_.MayStart().error().message, HasSubstr("start: somebody"));
  EXPECT_FALSE(handover_.IsOpen());
  EXPECT_FALSE(Take());
  bool told_gone = false;
  handover_.Stop([&](bool is_gone) { told_gone = is_gone; });
  EXPECT_TRUE(told_gone);
  Begin();
  EXPECT_TRUE(handover_.Trigger(Request(2)));
}

TEST_F(HandoverTest, AfterStopAndStartNothingOfBeforeIsLeft) {
  Begin();
  ASSERT_TRUE(handover_.Trigger(Request(0)));
  handover_.Deliver(FrameOf(Request(0)));
  int stopped = 0;
  handover_.Stop([&](bool) { ++stopped; });
  handover_.Stop([&](bool) { ++stopped; });
  EXPECT_EQ(stopped, 1);
  Begin();
  EXPECT_FALSE(Take());
  EXPECT_EQ(handover_.Receive(Nanoseconds(0)).error().kind, ErrorKind::kTemporary);
  EXPECT_TRUE(handover_.Trigger(Request(1)));
}

TEST_F(HandoverTest, StopWakesAWorkerThatWaitsForARequest) {
  handover_.Open(Limits());
  std::atomic<int> rounds{0};
  handover_.Start("worker", [&](const std::stop_token& stop, Stage&) {
    while (!stop.stop_requested()) {
      ++rounds;
      EXPECT_FALSE(handover_.Take(milliseconds(200), stop));
    }
    return Status();
  });
  while (rounds == 0) std::this_thread::yield();
  const SystemClock clock;
  const HostTime before = clock.Now();
  handover_.Stop([](bool) {});
  EXPECT_LT(clock.Now() - before, kLong);
}

}  // namespace
}  // namespace omnihdr::handover_test
