#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include "tests/unit/core/capture/controller_bench.h"

namespace omnihdr::capture_busy_test {
namespace {

using std::chrono::milliseconds;
using testing_capture::Bench;
using testing_capture::FrameFor;

CaptureOptions Patient() {
  CaptureOptions options;
  options.busy_patience = milliseconds(50);
  return options;
}

// A picture on its way, and a trigger 20 ms after it that finds the camera busy.
struct Busy : Bench {
  explicit Busy(std::size_t buffers = 4) : Bench(buffers, 1000, 0, 1, Patient()) {
    positions.metres_per_s = 10.0;
    Trigger();
    clock.Advance(milliseconds(20));
    refusal = "reading out";
    Trigger();
  }
  std::uint64_t missed_as_busy() const {
    return controller.counts().missed[static_cast<std::size_t>(MissReason::kCameraBusy)];
  }
};

TEST(CaptureBusy, ATriggerIsTakenAsSoonAsThePictureBeforeHasCome) {
  Busy busy;
  EXPECT_EQ(busy.commanded.size(), 1U);
  EXPECT_TRUE(busy.sink.lines.empty());
  busy.clock.Advance(milliseconds(10));
  busy.refusal.clear();
  busy.controller.OnFrame(FrameFor(busy.commanded[0]));
  ASSERT_EQ(busy.commanded.size(), 2U);
  EXPECT_EQ(busy.controller.counts().waited, 1U);
  CameraFrame frame = FrameFor(busy.commanded[1], 1);
  frame.mid_exposure = HostTime::FromNanoseconds(1'035'000'000);
  busy.controller.OnFrame(std::move(frame));
  ASSERT_EQ(busy.sink.lines.size(), 2U);
  EXPECT_EQ(busy.record(0).odometer_m, 12.5);
  // The line tells of the trigger's time and of the exposure's, and has the metres of the latter.
  EXPECT_EQ(busy.record(1).status, FrameStatus::kOk);
  EXPECT_EQ(busy.record(1).trigger_time.ns(), 1'020'000'000);
  EXPECT_EQ(busy.record(1).timestamp.ns(), 1'035'000'000);
  EXPECT_NEAR(*busy.record(1).odometer_m, 12.85, 1e-9);
}

TEST(CaptureBusy, ATriggerIsTakenByAskingAgainWhenNoPictureComes) {
  Busy busy;
  busy.clock.Advance(milliseconds(2));
  busy.refusal.clear();
  ASSERT_TRUE(busy.controller.NextDeadline());
  EXPECT_LE(*busy.controller.NextDeadline(), busy.clock.Now());
  busy.controller.OnTime();
  EXPECT_EQ(busy.commanded.size(), 2U);
}

TEST(CaptureBusy, ATriggerThatHasWaitedLongEnoughIsMissedAndItsBufferIsFree) {
  Busy busy;
  busy.clock.Advance(milliseconds(50));
  busy.controller.OnTime();
  EXPECT_EQ(busy.missed_as_busy(), 1U);
  busy.refusal.clear();
  busy.controller.OnFrame(FrameFor(busy.commanded[0]));
  EXPECT_EQ(busy.commanded.size(), 1U);
  ASSERT_EQ(busy.sink.lines.size(), 2U);
  EXPECT_EQ(busy.sink.free_buffers, 3U);  // the first picture has one
  EXPECT_EQ(busy.record(1).status, FrameStatus::kMissedTrigger);
  EXPECT_EQ(busy.record(1).detail, "the camera was busy with the picture before for 50 ms");
  EXPECT_EQ(busy.controller.frameless(), 0U);
}

TEST(CaptureBusy, OneTriggerWaitsAtATimeAndTheNextIsMissed) {
  Busy busy;
  busy.Trigger();
  EXPECT_EQ(busy.missed_as_busy(), 1U);
  busy.refusal.clear();
  busy.Trigger();  // first the one that waits, then this
  ASSERT_EQ(busy.commanded.size(), 3U);
  EXPECT_EQ(Value(busy.commanded[1].trigger), 1U);
  EXPECT_EQ(Value(busy.commanded[2].trigger), 3U);
}

TEST(CaptureBusy, ACameraThatGoesTakesTheWaitingTriggerWithIt) {
  Busy busy;
  busy.controller.OnCameraLost("unplugged");
  ASSERT_EQ(busy.sink.lines.size(), 2U);
  EXPECT_EQ(busy.record(1).status, FrameStatus::kCameraTimeout);
  EXPECT_EQ(busy.controller.open_triggers(), 0U);
  // The first line still holds a buffer only if it had a picture: neither has.
  EXPECT_EQ(busy.sink.free_buffers, 4U);
}

TEST(CaptureBusy, ACameraThatRefusesWithNothingOnItsWayIsNotWaitedFor) {
  Bench bench(4, 1000, 0, 1, Patient());
  bench.refusal = "not ready";
  bench.Trigger();
  ASSERT_EQ(bench.sink.lines.size(), 1U);
  EXPECT_EQ(bench.record(0).detail, "not ready");
  EXPECT_EQ(bench.controller.frameless(), 1U);
}

RC_GTEST_PROP(CaptureBusy, EveryTriggerIsOneLineInOrderWhateverTheCameraDoes, ()) {
  Bench bench(2, 1000, 0, 1, Patient());
  std::size_t answered = 0;
  std::size_t triggers = 0;
  for (const int step : *rc::gen::container<std::vector<int>>(rc::gen::inRange(0, 5))) {
    switch (step) {
      case 0:
        bench.Trigger();
        ++triggers;
        break;
      case 1:
        bench.refusal = bench.refusal.empty() ? "busy" : "";
        break;
      case 2:
        if (answered < bench.commanded.size()) {
          bench.controller.OnFrame(FrameFor(bench.commanded[answered], answered));
          ++answered;
        }
        break;
      case 3:
        bench.clock.Advance(milliseconds(20));
        bench.controller.OnTime();
        break;
      default:
        // The recorder has stored what it was given.
        bench.sink.free_buffers =
            2 - (bench.controller.open_triggers() < 2 ? bench.controller.open_triggers() : 2);
    }
  }
  bench.refusal.clear();
  for (; answered < bench.commanded.size(); ++answered) {
    bench.controller.OnFrame(FrameFor(bench.commanded[answered], answered));
  }
  bench.clock.Advance(std::chrono::seconds(10));
  bench.controller.OnTime();
  RC_ASSERT(bench.sink.lines.size() == triggers);
  for (std::size_t i = 0; i < triggers; ++i) RC_ASSERT(Value(bench.record(i).frame) == i);
}

}  // namespace
}  // namespace omnihdr::capture_busy_test
