// Steps of the bracket that are taken again, bursts, cameras that give no frames, and what a line
// tells of its times.
#include <gtest/gtest.h>

#include <chrono>
#include <deque>
#include <utility>
#include <vector>

#include "core/capture/capture_controller.h"
#include "core/session/utc_text.h"
#include "tests/unit/core/capture/controller_bench.h"

namespace omnihdr::capture_steps_test {
namespace {

using std::chrono::milliseconds;
using testing_capture::Bench;
using testing_capture::FrameFor;
using testing_capture::KeepingSink;
using testing_capture::Sawtooth;
using testing_capture::SimulatedClock;
using testing_capture::SmallCamera;

CaptureOptions Retaking(int retake, bool burst = false) {
  CaptureOptions options;
  options.retake = retake;
  options.burst = burst;
  return options;
}

CameraFrame WrongExposure(const ExposureRequest& request) {
  CameraFrame frame = FrameFor(request);
  frame.measured_exposure->time = ExposureTime::Seconds(0.5);
  return frame;
}

TEST(CaptureSteps, AStepThatWasNotProvedIsTakenByTheNextTriggerAndTheBracketGoesOnBehindIt) {
  Bench bench(10, 1000, 0, 1, Retaking(1));
  std::vector<double> asked;
  for (int i = 0; i < 6; ++i) {
    bench.Trigger();
    const ExposureRequest request = bench.commanded.back();
    asked.push_back(request.exposure.time.seconds());
    // The second trigger's frame and the first of its retakes have another exposure.
    bench.controller.OnFrame(i == 1 ? WrongExposure(request) : FrameFor(request));
  }
  EXPECT_EQ(asked, (std::vector<double>{0.001, 0.004, 0.004, 0.016, 0.001, 0.004}));
  EXPECT_EQ(bench.record(1).status, FrameStatus::kExposureMismatch);
  EXPECT_EQ(bench.record(1).step, 1);
  EXPECT_EQ(bench.record(1).retakes, 0U);
  EXPECT_EQ(bench.record(2).status, FrameStatus::kOk);
  EXPECT_EQ(bench.record(2).step, 1);
  EXPECT_EQ(bench.record(5).retakes, 1U);
  EXPECT_EQ(bench.controller.counts().retaken, 1U);
}

TEST(CaptureSteps, AStepThatIsNeverProvedIsTakenAgainAsOftenAsAllowedAndThenLeft) {
  Bench bench(4, 1000, 0, 1, Retaking(2));
  std::vector<int> steps;
  for (int i = 0; i < 6; ++i) {
    steps.push_back(bench.controller.upcoming().step);
    bench.Trigger();
    bench.controller.OnFrame(bench.commanded.back().exposure.time.seconds() == 0.004
                                 ? WrongExposure(bench.commanded.back())
                                 : FrameFor(bench.commanded.back()));
  }
  EXPECT_EQ(steps, (std::vector<int>{0, 1, 1, 1, 2, 0}));
  EXPECT_EQ(bench.sink.lines.size(), 6U);
}

TEST(CaptureSteps, AContinuedSessionKeepsThePhaseThatItsRetakesHaveMade) {
  CaptureOptions options = Retaking(1);
  options.retakes = 2;
  Bench bench(4, 1000, 5, 1, options);
  EXPECT_EQ(bench.TryTrigger()->step, 0) << "trigger 5 takes what trigger 3 would have taken";
}

TEST(CaptureSteps, ABurstTakesTheWholeBracketAtOnePositionWithoutWaitingForItsFrames) {
  Bench bench(4, 1000, 0, 3, Retaking(0, true));
  const auto accepted = bench.TryTrigger();
  ASSERT_TRUE(accepted);
  ASSERT_EQ(bench.commanded.size(), 3U) << "the camera takes all that it accepts";
  for (std::size_t i = 0; i < 3; ++i) bench.controller.OnFrame(FrameFor(bench.commanded[i], i));
  ASSERT_EQ(bench.sink.lines.size(), 3U);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(Value(bench.record(i).position), 0);
    EXPECT_EQ(bench.record(i).step, static_cast<int>(i));
    EXPECT_EQ(bench.record(i).trigger_time, accepted->time);
    EXPECT_EQ(bench.record(i).status, FrameStatus::kOk);
  }
  bench.Trigger();
  EXPECT_EQ(Value(bench.controller.next_trigger()), 6U);
}

TEST(CaptureSteps, ABusyCameraIsAskedAgainForTheRestOfABurst) {
  Bench bench(4, 1000, 0, 3, Retaking(0, true));
  bench.refusal = "still exposing";
  bench.Trigger();
  EXPECT_TRUE(bench.commanded.empty());
  ASSERT_TRUE(bench.controller.NextDeadline());
  EXPECT_LE(*bench.controller.NextDeadline() - bench.clock.Now(), milliseconds(2));
  // An edge meanwhile is a position that is missed, one line a frame of it.
  bench.Trigger();
  bench.clock.Advance(milliseconds(2));
  bench.refusal.clear();
  bench.controller.OnTime();
  ASSERT_EQ(bench.commanded.size(), 3U);
  for (std::size_t i = 0; i < 3; ++i) bench.controller.OnFrame(FrameFor(bench.commanded[i], i));
  ASSERT_EQ(bench.sink.lines.size(), 6U);
  for (std::size_t i = 3; i < 6; ++i) {
    EXPECT_EQ(bench.record(i).status, FrameStatus::kMissedTrigger);
    EXPECT_EQ(bench.record(i).detail, "the burst before has not ended");
    EXPECT_EQ(Value(bench.record(i).position), 1);
  }
  EXPECT_EQ(bench.sink.free_buffers, 1U);
}

TEST(CaptureSteps, ABurstThatTheCameraNeverTakesEndsInMissedLines) {
  Bench bench(4, 1000, 0, 3, Retaking(0, true));
  bench.refusal = "still exposing";
  bench.Trigger();
  bench.clock.Advance(std::chrono::seconds(10));
  bench.controller.OnTime();
  ASSERT_EQ(bench.sink.lines.size(), 3U);
  EXPECT_EQ(bench.record(2).status, FrameStatus::kMissedTrigger);
  EXPECT_NE(bench.record(2).detail.find("stayed busy"), std::string::npos);
  EXPECT_EQ(bench.controller.frameless(), 1U);
  EXPECT_EQ(bench.sink.free_buffers, 4U);
}

TEST(CaptureSteps, InABurstAStepThatWasNotProvedIsTakenAgainAtOnceForTheSameTrigger) {
  Bench bench(4, 1000, 0, 3, Retaking(1, true));
  bench.Trigger();
  ASSERT_EQ(bench.commanded.size(), 3U);
  bench.controller.OnFrame(FrameFor(bench.commanded[0]));
  bench.controller.OnFrame(WrongExposure(bench.commanded[1]));
  ASSERT_EQ(bench.commanded.size(), 4U);
  EXPECT_EQ(bench.commanded[3].trigger, bench.commanded[1].trigger);
  bench.controller.OnFrame(FrameFor(bench.commanded[2]));
  bench.controller.OnFrame(FrameFor(bench.commanded[3]));
  ASSERT_EQ(bench.sink.lines.size(), 3U);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_EQ(bench.record(i).status, FrameStatus::kOk) << i;
  EXPECT_EQ(bench.controller.counts().retaken, 1U);
  EXPECT_EQ(bench.sink.free_buffers, 1U);
}

TEST(CaptureSteps, AfterABurstThatARestartCutShortTheNextOneIsAPositionOfItsOwn) {
  Bench bench(4, 1000, 4, 3, Retaking(0, true));
  const auto accepted = bench.TryTrigger(1);
  EXPECT_EQ(Value(accepted->position), 3);
  EXPECT_EQ(accepted->step, 0);
  for (const ExposureRequest& request : bench.commanded)
    bench.controller.OnFrame(FrameFor(request));
  ASSERT_EQ(bench.sink.lines.size(), 8U);
  EXPECT_EQ(Value(bench.record(1).position), 1);
  EXPECT_EQ(bench.record(1).detail, "the burst of this position was cut short by a restart");
  for (std::size_t i = 2; i < 5; ++i) EXPECT_EQ(Value(bench.record(i).position), 2) << "lost";
  EXPECT_EQ(bench.record(5).status, FrameStatus::kOk);
}

TEST(CaptureSteps, WithoutRoomForAllOfABurstNothingOfItIsTaken) {
  Bench bench(4, 2, 0, 3, Retaking(0, true));
  EXPECT_FALSE(bench.TryTrigger());
  EXPECT_EQ(bench.sink.free_lines, 2U);
  EXPECT_EQ(bench.controller.counts().refused, 3U);
  EXPECT_EQ(Value(bench.controller.next_trigger()), 0U);
}

// A camera that streams: an exposure is in force `latency` frames after it was commanded, and as
// many may be on their way at once. Counts the frames its sensor makes.
struct StreamingCamera {
  explicit StreamingCamera(std::size_t most_on_their_way) : most(most_on_their_way) {}
  Status Command(const ExposureRequest& request) {
    if (on_their_way.size() >= most) return Fail(ErrorKind::kTemporary, "busy");
    on_their_way.push_back({request, frames_made + kLatency});
    return {};
  }
  std::optional<CameraFrame> NextFrame() {
    ++frames_made;
    if (on_their_way.empty() || on_their_way.front().second >= frames_made) return std::nullopt;
    CameraFrame frame = FrameFor(on_their_way.front().first);
    on_their_way.pop_front();
    return frame;
  }
  static constexpr std::uint64_t kLatency = 3;
  const std::size_t most;
  std::deque<std::pair<ExposureRequest, std::uint64_t>> on_their_way;
  std::uint64_t frames_made = 0;
};

// Frames that the sensor makes for a bracket of three.
std::uint64_t FramesOfABracket(std::size_t most_on_their_way) {
  SimulatedClock clock;
  KeepingSink sink;
  StreamingCamera camera(most_on_their_way);
  CaptureController controller(
      Sawtooth(3), SmallCamera(), Retaking(0, true), TriggerId{0}, sink,
      [&](const ExposureRequest& request) { return camera.Command(request); }, nullptr, clock);
  TriggerEvent event;
  event.time = clock.Now();
  EXPECT_TRUE(controller.OnTrigger(event));
  while (sink.lines.size() < 3 && camera.frames_made < 100) {
    clock.Advance(milliseconds(1));
    if (auto frame = camera.NextFrame()) controller.OnFrame(std::move(*frame));
    controller.OnTime();
  }
  for (const CaptureLine& line : sink.lines) EXPECT_EQ(line.record.status, FrameStatus::kOk);
  return camera.frames_made;
}

TEST(CaptureSteps, ABurstsCommandsRunAheadOfItsFramesAsFarAsTheCameraAccepts) {
  // The ideal: the latency once, and a frame a step.
  EXPECT_EQ(FramesOfABracket(3), StreamingCamera::kLatency + 3);
  // A camera that takes one at a time pays the latency at every step.
  EXPECT_EQ(FramesOfABracket(1), 3 * (StreamingCamera::kLatency + 1));
}

TEST(CaptureSteps, TriggersThatTheCameraLeavesWithoutAFrameAreCountedUntilOneComes) {
  Bench bench;
  for (int i = 0; i < 3; ++i) {
    bench.Trigger();
    bench.clock.Advance(std::chrono::seconds(3));
    bench.controller.OnTime();
  }
  EXPECT_EQ(bench.controller.frameless(), 3U);
  // Busy without anything on its way counts, busy with a picture does not.
  bench.refusal = "busy";
  bench.Trigger();
  EXPECT_EQ(bench.controller.frameless(), 4U);
  bench.refusal.clear();
  bench.Trigger();
  bench.refusal = "busy";
  bench.Trigger();
  EXPECT_EQ(bench.controller.frameless(), 4U);
  bench.controller.OnFrame(FrameFor(bench.commanded.back()));
  EXPECT_EQ(bench.controller.frameless(), 0U);
}

class FreeClock final : public UtcReference {
 public:
  UtcQuality Quality() const override { return quality; }
  UtcQuality quality;
};

class NoFix final : public PlaceSource {
 public:
  bool has_receiver() const override { return true; }
};

class OneFix final : public PlaceSource {
 public:
  std::optional<GnssFix> Fix(HostTime at) const override {
    GnssFix fix;
    fix.time = "2026-01-01T00:00:00.25Z";
    fix.fix = 1;
    fix.age_s = static_cast<double>((at - received).count()) * 1e-9;
    return fix;
  }
  bool has_receiver() const override { return true; }
  HostTime received;
};

TEST(CaptureSteps, WhereNobodyKeepsTheMachinesClockTheReceiverTellsTheTime) {
  SimulatedClock clock;
  KeepingSink sink;
  FreeClock utc;
  OneFix place;
  std::vector<ExposureRequest> commanded;
  CaptureController controller(
      Sawtooth(), SmallCamera(), CaptureOptions{}, TriggerId{0}, sink,
      [&](const ExposureRequest& request) -> Status {
        commanded.push_back(request);
        return {};
      },
      nullptr, clock, &place, &utc);
  TriggerEvent event;
  event.time = clock.Now();
  place.received = event.time - milliseconds(500);
  for (const bool kept : {false, true}) {
    utc.quality.synchronised = kept;
    ASSERT_TRUE(controller.OnTrigger(event));
    controller.OnFrame(FrameFor(commanded.back()));
  }
  const FrameRecord& free = sink.lines.at(0).record;
  EXPECT_EQ(free.utc_source, "gnss");
  EXPECT_EQ(free.utc_error_s, 1.0);
  ASSERT_TRUE(free.utc);
  EXPECT_EQ(IsoUtcNanoseconds(*free.utc), "2026-01-01T00:00:00.750000000Z");
  EXPECT_EQ(sink.lines.at(1).record.utc_source, "system-synchronised");
}

TEST(CaptureSteps, ALineTellsHowGoodItsTimesAreAndThatThereWasNoFix) {
  SimulatedClock clock;
  KeepingSink sink;
  FreeClock utc;
  const NoFix place;
  std::vector<ExposureRequest> commanded;
  CaptureController controller(
      Sawtooth(), SmallCamera(), CaptureOptions{}, TriggerId{0}, sink,
      [&](const ExposureRequest& request) -> Status {
        commanded.push_back(request);
        return {};
      },
      nullptr, clock, &place, &utc);
  TriggerEvent event;
  event.time = clock.Now();
  ASSERT_TRUE(controller.OnTrigger(event));
  CameraFrame frame = FrameFor(commanded[0]);
  frame.camera_time = CameraTime::FromNanoseconds(77);
  frame.mid_exposure_error = milliseconds(1);
  frame.clock_jumps = 2;
  controller.OnFrame(std::move(frame));
  utc.quality = {true, 0.002, 37};
  ASSERT_TRUE(controller.OnTrigger(event));
  controller.OnFrame(FrameFor(commanded[1]));
  const FrameRecord& free = sink.lines.at(0).record;
  EXPECT_EQ(free.utc_source, "system-free");
  EXPECT_FALSE(free.utc_error_s);
  EXPECT_EQ(free.camera_time->ns(), 77);
  EXPECT_EQ(free.timestamp_error, milliseconds(1));
  EXPECT_TRUE(free.gnss_missing);
  EXPECT_EQ(controller.counts().clock_jumps, 2U);
  const FrameRecord& kept = sink.lines.at(1).record;
  EXPECT_EQ(kept.utc_source, "system-synchronised");
  EXPECT_EQ(kept.utc_error_s, 0.002);
  EXPECT_FALSE(kept.timestamp_error);
}

}  // namespace
}  // namespace omnihdr::capture_steps_test
