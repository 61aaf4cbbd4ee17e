// A camera that hangs on the trigger's wire: edges and frames find each other.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <utility>
#include <vector>

#include "core/capture/capture_controller.h"
#include "tests/unit/core/capture/controller_bench.h"

namespace omnihdr::capture_wired_test {
namespace {

using std::chrono::milliseconds;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using testing_capture::Bench;

CaptureOptions Wired(int retake = 1) {
  CaptureOptions options;
  options.wired = true;
  options.retake = retake;
  return options;
}

// A wire with a pulse every 100 ms, a camera on it, and a line that observes it.
class Wire {
 public:
  explicit Wire(const CaptureOptions& options = Wired()) : bench(8, 1000, 0, 1, options) {
    bench.controller.SetArmed(true);
    prepared = bench.controller.upcoming().exposure;
  }
  // The camera's picture of a pulse that came `ago`; it exposes with what was prepared.
  CameraFrame Picture(Nanoseconds ago = milliseconds(0)) {
    CameraFrame frame;
    frame.camera_counter = counter++;
    frame.wired = WiredStart{bench.clock.Now() - ago + milliseconds(1), milliseconds(1)};
    frame.measured_exposure = prepared;
    frame.proof = ExposureProof::kEmbedded;
    frame.mid_exposure = frame.wired->at + milliseconds(5);
    frame.pixels = Image<std::uint8_t>(8, 4, 3, 7);
    return frame;
  }
  // The frame arrives, and the next step is prepared.
  std::optional<TriggerId> Deliver(CameraFrame frame) {
    const auto trigger = bench.controller.OnFrame(std::move(frame));
    prepared = bench.controller.upcoming().exposure;
    return trigger;
  }
  void Wait(Nanoseconds time) {
    bench.clock.Advance(time);
    bench.controller.OnTime();
  }
  std::vector<int> Steps() const {
    std::vector<int> steps;
    for (const auto& line : bench.sink.lines) steps.push_back(line.record.step.value_or(-1));
    return steps;
  }
  Bench bench;
  Exposure prepared;
  std::uint64_t counter = 40;
};

TEST(CaptureWired, EveryEdgeHasItsFrameAndTheBracketIsSetInAdvance) {
  Wire wire;
  for (int i = 0; i < 6; ++i) {
    const HostTime edge = wire.bench.clock.Now();
    wire.bench.Trigger();
    EXPECT_EQ(wire.Deliver(wire.Picture()), TriggerId{static_cast<std::uint64_t>(i)});
    const FrameRecord& record = wire.bench.record(static_cast<std::size_t>(i));
    ASSERT_EQ(record.status, FrameStatus::kOk) << record.detail;
    EXPECT_EQ(record.trigger_time, edge);
    EXPECT_EQ(record.timestamp - edge,
              Nanoseconds(std::llround(record.exposure.time.seconds() * 0.5e9)));
    EXPECT_EQ(record.timestamp_error, milliseconds(2)) << "1 ms off, give or take 1 ms";
    wire.Wait(milliseconds(100));
  }
  EXPECT_THAT(wire.Steps(), ElementsAre(0, 1, 2, 0, 1, 2));
  EXPECT_EQ(wire.bench.controller.counts().retaken, 0U);
}

TEST(CaptureWired, AFrameThatComesBeforeItsEdgeIsToldWaitsForIt) {
  Wire wire;
  const HostTime edge = wire.bench.clock.Now();
  CameraFrame frame = wire.Picture();
  EXPECT_FALSE(wire.Deliver(std::move(frame)));
  EXPECT_EQ(wire.bench.controller.upcoming().step, 1) << "the next pulse is not to find the same";
  wire.Wait(milliseconds(50));
  EXPECT_TRUE(wire.bench.sink.lines.empty());
  TriggerEvent event;
  event.time = edge;
  ASSERT_TRUE(wire.bench.controller.OnTrigger(event));
  ASSERT_EQ(wire.bench.sink.lines.size(), 1U);
  EXPECT_EQ(wire.bench.record(0).status, FrameStatus::kOk);
  EXPECT_EQ(wire.bench.controller.counts().frames_without_edge, 0U);
}

TEST(CaptureWired, AnEdgeAtWhichTheCameraTookNothingEndsWhenTheNextOneHasItsFrame) {
  Wire wire;
  wire.bench.Trigger();
  wire.Deliver(wire.Picture());
  wire.Wait(milliseconds(100));
  wire.bench.Trigger();  // the camera is busy
  wire.Wait(milliseconds(100));
  wire.bench.Trigger();
  wire.Deliver(wire.Picture());
  ASSERT_EQ(wire.bench.sink.lines.size(), 3U);
  EXPECT_EQ(wire.bench.record(1).status, FrameStatus::kMissedTrigger);
  EXPECT_THAT(wire.bench.record(1).detail, HasSubstr("took no picture at this edge"));
  EXPECT_EQ(wire.bench.record(2).status, FrameStatus::kOk) << wire.bench.record(2).detail;
  // What was prepared for the edge before is what the camera had: a good picture of that step.
  EXPECT_EQ(wire.bench.record(2).step, 1);
  EXPECT_EQ(wire.bench.controller.upcoming().step, 2) << "its own step is due still";
  const CaptureCounts counts = wire.bench.controller.counts();
  EXPECT_EQ(counts.edges_without_frame, 1U);
  EXPECT_EQ(counts.missed[static_cast<std::size_t>(MissReason::kNotExposed)], 1U);
  EXPECT_EQ(wire.bench.sink.free_buffers, 6U) << "two pictures are held, nothing else";
}

TEST(CaptureWired, AFrameThatWasLostOnItsWayIsToldByTheCamerasCounter) {
  Wire wire;
  wire.bench.Trigger();
  wire.Deliver(wire.Picture());
  wire.Wait(milliseconds(100));
  wire.bench.Trigger();
  ++wire.counter;
  wire.Wait(milliseconds(100));
  wire.bench.Trigger();
  wire.Deliver(wire.Picture());
  EXPECT_EQ(wire.bench.record(1).status, FrameStatus::kCameraTimeout);
  EXPECT_THAT(wire.bench.record(1).detail, HasSubstr("1 of 1 frames were lost on their way"));
}

TEST(CaptureWired, AnEdgeWithoutAFrameEndsByItselfWithTheReason) {
  Wire wire;
  wire.bench.controller.SetCamera(wire.bench.controller.plan(), testing_capture::SmallCamera(), {});
  wire.bench.Trigger();
  wire.Wait(std::chrono::seconds(10));
  ASSERT_EQ(wire.bench.sink.lines.size(), 1U);
  EXPECT_EQ(wire.bench.record(0).status, FrameStatus::kCameraTimeout);
  EXPECT_THAT(wire.bench.record(0).detail, HasSubstr("the pulse did not reach the camera"));
  EXPECT_EQ(wire.bench.controller.counts().edges_without_frame, 1U);
  EXPECT_EQ(wire.bench.controller.frameless(), 1U);
}

TEST(CaptureWired, AFrameThatNoEdgeWasSeenForHasALineOfItsOwnWithTheReason) {
  Wire wire;
  wire.bench.Trigger();
  wire.Deliver(wire.Picture());
  wire.Wait(milliseconds(100));
  const HostTime pulse = wire.bench.clock.Now();
  wire.Deliver(wire.Picture());
  ASSERT_EQ(wire.bench.sink.lines.size(), 1U);
  ASSERT_TRUE(wire.bench.controller.NextDeadline());
  wire.Wait(*wire.bench.controller.NextDeadline() - wire.bench.clock.Now());
  ASSERT_EQ(wire.bench.sink.lines.size(), 2U);
  const FrameRecord& record = wire.bench.record(1);
  EXPECT_EQ(record.status, FrameStatus::kOk);
  EXPECT_THAT(record.detail, HasSubstr("no edge was seen for this frame"));
  EXPECT_EQ(record.trigger_time, pulse + milliseconds(1)) << "as the camera tells it";
  EXPECT_EQ(record.step, 1);
  EXPECT_EQ(wire.bench.controller.counts().frames_without_edge, 1U);
}

TEST(CaptureWired, AnEdgeThatTheSourceLostIsFoundByItsFrame) {
  Wire wire;
  wire.bench.Trigger();
  wire.Deliver(wire.Picture());
  wire.Wait(milliseconds(100));
  CameraFrame of_the_lost = wire.Picture();
  wire.Wait(milliseconds(100));
  wire.bench.Trigger(1);
  wire.Deliver(std::move(of_the_lost));
  wire.Deliver(wire.Picture());
  ASSERT_EQ(wire.bench.sink.lines.size(), 3U);
  EXPECT_EQ(wire.bench.record(1).status, FrameStatus::kOk);
  EXPECT_THAT(wire.bench.record(1).detail, HasSubstr("the trigger source lost this edge"));
  EXPECT_EQ(wire.bench.record(2).status, FrameStatus::kOk);
  EXPECT_EQ(wire.bench.controller.counts().frames_without_edge, 0U);
}

TEST(CaptureWired, FramesOfADisarmedDaemonAreNobodysAndThoseOnTheirWayAreKept) {
  Wire wire;
  wire.bench.Trigger();
  CameraFrame on_its_way = wire.Picture();
  wire.bench.controller.SetArmed(false);
  wire.Deliver(std::move(on_its_way));
  wire.Wait(milliseconds(100));
  wire.Deliver(wire.Picture());
  wire.Wait(std::chrono::seconds(1));
  wire.bench.controller.SetArmed(true);
  wire.Deliver(wire.Picture(milliseconds(500)));
  wire.Wait(std::chrono::seconds(1));
  EXPECT_EQ(wire.bench.sink.lines.size(), 1U);
  EXPECT_EQ(wire.bench.controller.counts().frames_disarmed, 2U);
}

TEST(CaptureWired, AnExposureThatIsNoStepOfTheBracketIsAMismatch) {
  Wire wire;
  wire.bench.Trigger();
  CameraFrame frame = wire.Picture();
  frame.measured_exposure->time = ExposureTime::Seconds(0.123);
  wire.Deliver(std::move(frame));
  EXPECT_EQ(wire.bench.record(0).status, FrameStatus::kExposureMismatch);
  EXPECT_EQ(wire.bench.controller.upcoming().step, 0) << "taken again";
}

TEST(CaptureWired, ACameraThatGoesEndsItsEdgesAndTheFramesThatWait) {
  Wire wire;
  wire.Deliver(wire.Picture());
  wire.Wait(milliseconds(100));
  wire.bench.Trigger();
  wire.bench.controller.OnCameraLost("unplugged");
  ASSERT_EQ(wire.bench.sink.lines.size(), 2U);
  EXPECT_EQ(wire.bench.record(0).status, FrameStatus::kCameraTimeout);
  EXPECT_EQ(wire.bench.record(1).status, FrameStatus::kOk);
}

TEST(CaptureWired, ACameraWithACycleOfItsOwnIsFollowedByThePlan) {
  Wire wire;
  const std::vector<Exposure> turn = wire.bench.controller.plan().Turn();
  ASSERT_EQ(turn.size(), 3U);
  for (std::size_t pulse = 0; pulse < 8; ++pulse) {
    wire.bench.Trigger();
    CameraFrame frame = wire.Picture();
    // It is one step ahead of the plan, and two from the fifth pulse on.
    frame.measured_exposure = turn[(pulse + (pulse < 4 ? 1 : 2)) % 3];
    frame.cycled = true;
    wire.Deliver(std::move(frame));
    ASSERT_EQ(wire.bench.record(pulse).status, FrameStatus::kOk);
    wire.Wait(milliseconds(100));
  }
  EXPECT_THAT(wire.Steps(), ElementsAre(1, 2, 0, 1, 0, 1, 2, 0)) << "as the frames prove";
  EXPECT_EQ(wire.bench.controller.counts().retaken, 0U);
  EXPECT_EQ(wire.bench.controller.upcoming().step, 1) << "what the camera's cycle takes next";
}

TEST(CaptureCycle, AFrameOfAnotherStepThanAskedForIsAPictureOfThatStepAndTheAskedOneIsDue) {
  CaptureOptions options;
  options.retake = 2;
  Bench bench(8, 1000, 0, 1, options);
  const std::vector<Exposure> turn = bench.controller.plan().Turn();
  for (int own = 0; own < 2; ++own) {
    bench.Trigger();
    CameraFrame frame;
    frame.trigger = TriggerId{static_cast<std::uint64_t>(own)};
    frame.cycled = own == 1;
    frame.measured_exposure = turn[1];
    frame.proof = ExposureProof::kEmbedded;
    frame.pixels = Image<std::uint8_t>(8, 4, 3, 7);
    bench.controller.OnFrame(std::move(frame));
    const FrameRecord& record = bench.record(static_cast<std::size_t>(own));
    EXPECT_EQ(record.status, own == 1 ? FrameStatus::kOk : FrameStatus::kExposureMismatch);
    EXPECT_EQ(record.exposure, turn[1]);
    EXPECT_EQ(record.step, own == 1 ? 1 : 0);
    EXPECT_EQ(bench.controller.upcoming().step, 0);
  }
}

}  // namespace
}  // namespace omnihdr::capture_wired_test
