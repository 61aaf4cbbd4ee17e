#include "core/capture/capture_controller.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <vector>

#include "tests/unit/core/capture/controller_bench.h"

namespace omnihdr::capture_controller_test {
namespace {

using std::chrono::milliseconds;
using testing_capture::Bench;
using testing_capture::FrameFor;
using testing_capture::KeepingSink;
using testing_capture::Sawtooth;
using testing_capture::SimulatedClock;
using testing_capture::SmallCamera;

TEST(CaptureController, ATriggerBecomesALineWithPixelsAndTimes) {
  Bench bench;
  const auto accepted = bench.TryTrigger();
  ASSERT_TRUE(accepted);
  EXPECT_EQ(accepted->step, 0);
  ASSERT_EQ(bench.commanded.size(), 1U);
  EXPECT_EQ(bench.commanded[0].odometer_m, 12.5);
  bench.clock.Advance(milliseconds(30));
  bench.controller.OnFrame(FrameFor(bench.commanded[0]));
  ASSERT_EQ(bench.sink.lines.size(), 1U);
  const FrameRecord& record = bench.record(0);
  EXPECT_EQ(record.status, FrameStatus::kOk);
  EXPECT_EQ(Value(record.frame), 0U);
  EXPECT_EQ(Value(record.position), 0);
  EXPECT_EQ(record.proof, ExposureProof::kEmbedded);
  EXPECT_DOUBLE_EQ(record.exposure.time.seconds(), 0.001);
  EXPECT_EQ(record.trigger_time.ns(), 1'000'000'000);
  EXPECT_EQ(record.timestamp.ns(), 1'005'000'000);
  // UTC of the trigger, not of the moment the line is made.
  EXPECT_EQ(record.utc->ns(), SimulatedClock::kUtcOffset + 1'000'000'000);
  EXPECT_EQ(record.odometer_m, 12.5);
  EXPECT_TRUE(bench.sink.lines[0].holds_buffer);
  EXPECT_EQ(std::get<Image<std::uint8_t>>(bench.sink.lines[0].pixels).width(), 8);
}

TEST(CaptureController, AReplayedFrameKeepsTheTimeAndPlaceItWasRecordedWith) {
  Bench bench;
  bench.Trigger();
  bench.Trigger();
  CameraFrame frame = FrameFor(bench.commanded[0]);
  RecordedMoment moment;
  moment.utc = UtcTime::FromNanoseconds(123'456'789);
  moment.gnss.emplace().lat_deg = 45.4;
  moment.heading_deg = 90.0;
  moment.pose = Pose{};
  frame.recorded = moment;
  bench.controller.OnFrame(std::move(frame));
  // A recording that does not know its date does not get this host's.
  frame = FrameFor(bench.commanded[1], 1);
  frame.recorded = RecordedMoment{};
  bench.controller.OnFrame(std::move(frame));
  ASSERT_EQ(bench.sink.lines.size(), 2U);
  EXPECT_EQ(bench.record(0).utc->ns(), 123'456'789);
  EXPECT_EQ(bench.record(0).gnss->lat_deg, 45.4);
  EXPECT_EQ(bench.record(0).heading_deg, 90.0);
  EXPECT_TRUE(bench.record(0).pose.has_value());
  EXPECT_FALSE(bench.record(1).utc.has_value());
}

class MovingPlace final : public PlaceSource {
 public:
  std::optional<GnssFix> Fix(HostTime at) const override {
    if (at < HostTime::FromNanoseconds(1'000'000'000)) return std::nullopt;
    GnssFix fix;
    fix.lat_deg = static_cast<double>(at.ns()) * 1e-9;
    return fix;
  }
  std::optional<double> HeadingDeg(HostTime) const override { return 271.5; }
};

TEST(CaptureController, ALineTellsPlaceAndHeadingOfTheMiddleOfTheExposureOrOfTheLostTrigger) {
  SimulatedClock clock;
  KeepingSink sink;
  const MovingPlace place;
  std::vector<ExposureRequest> commanded;
  CaptureController controller(
      Sawtooth(), SmallCamera(), CaptureOptions{}, TriggerId{0}, sink,
      [&](const ExposureRequest& request) -> Status {
        if (!commanded.empty()) return Fail(ErrorKind::kTemporary, "busy");
        commanded.push_back(request);
        return {};
      },
      nullptr, clock, &place);
  TriggerEvent event;
  event.time = clock.Now();
  ASSERT_TRUE(controller.OnTrigger(event));
  clock.Advance(milliseconds(20));
  event.time = clock.Now();
  ASSERT_TRUE(controller.OnTrigger(event));
  controller.OnFrame(FrameFor(commanded.at(0)));
  ASSERT_EQ(sink.lines.size(), 2U);
  EXPECT_NEAR(sink.lines[0].record.gnss->lat_deg, 1.005, 1e-9);
  EXPECT_EQ(sink.lines[0].record.heading_deg, 271.5);
  EXPECT_EQ(sink.lines[1].record.status, FrameStatus::kMissedTrigger);
  EXPECT_NEAR(sink.lines[1].record.gnss->lat_deg, 1.02, 1e-9);
}

TEST(CaptureController, TriggersThatTheSourceLostAreLinesWithTheSourcesReason) {
  Bench bench;
  TriggerEvent event;
  event.time = bench.clock.Now();
  event.lost_before = 2;
  event.lost_reason = "the kernel's buffer overflowed";
  ASSERT_TRUE(bench.controller.OnTrigger(event));
  ASSERT_EQ(bench.sink.lines.size(), 2U);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(bench.record(i).status, FrameStatus::kMissedTrigger);
    EXPECT_EQ(bench.record(i).detail, "the kernel's buffer overflowed");
    EXPECT_FALSE(bench.record(i).odometer_m);
  }
}

TEST(CaptureController, MissedTriggersAreCountedByTheirReason) {
  Bench bench(1);
  bench.refusal = "busy";
  bench.Trigger(2);
  bench.refusal.clear();
  bench.Trigger();
  bench.Trigger();  // the only buffer is taken
  CameraFrame frame = FrameFor(bench.commanded[0]);
  frame.status = FrameStatus::kMissedTrigger;
  bench.controller.OnFrame(std::move(frame));
  bench.controller.OnLost({3, "its buffer was full"});
  const CaptureCounts counts = bench.controller.counts();
  const auto missed = [&](MissReason reason) {
    return counts.missed[static_cast<std::size_t>(reason)];
  };
  EXPECT_EQ(missed(MissReason::kSourceLost), 5U);
  EXPECT_EQ(missed(MissReason::kCameraBusy), 1U);
  EXPECT_EQ(missed(MissReason::kNoBuffer), 1U);
  EXPECT_EQ(missed(MissReason::kCameraError), 1U);
  EXPECT_EQ(missed(MissReason::kNoCamera), 0U);
  EXPECT_EQ(bench.sink.lines.size(), 8U);
  EXPECT_EQ(bench.record(7).detail, "its buffer was full");
}

TEST(CaptureController, ACameraThatComesLaterBringsItsPlanAndItsFramesDescription) {
  Bench bench;
  bench.Trigger();
  EXPECT_FALSE(bench.controller.camera_known());
  BracketOptions options;
  options.exposures = {ExposureTime::Seconds(0.5), ExposureTime::Seconds(0.25)};
  CameraDescription larger = SmallCamera();
  larger.width = 16;
  bench.controller.SetCamera(BracketPlan::Make(options, {}).value(), larger, {});
  EXPECT_TRUE(bench.controller.camera_known());
  bench.Trigger();
  EXPECT_DOUBLE_EQ(bench.commanded[1].exposure.time.seconds(), 0.25);
  bench.controller.OnFrame(FrameFor(bench.commanded[0]));
  EXPECT_EQ(bench.record(0).status, FrameStatus::kCorrupt) << "of the size before";
}

TEST(CaptureController, ABusyCameraIsAMissedTriggerAndTheBracketGoesOn) {
  Bench bench;
  bench.Trigger();
  bench.refusal = "still exposing";
  bench.Trigger();
  bench.refusal.clear();
  bench.Trigger();
  bench.controller.OnFrame(FrameFor(bench.commanded[0], 0));
  bench.controller.OnFrame(FrameFor(bench.commanded[1], 1));
  ASSERT_EQ(bench.sink.lines.size(), 3U);
  EXPECT_EQ(bench.record(1).status, FrameStatus::kMissedTrigger);
  EXPECT_EQ(bench.record(1).detail, "still exposing");
  EXPECT_EQ(Value(bench.record(1).position), 1);
  // The third trigger takes the third step although the second was lost.
  EXPECT_DOUBLE_EQ(bench.record(2).exposure.time.seconds(), 0.016);
  EXPECT_EQ(bench.sink.free_buffers, 2U);
}

TEST(CaptureController, AnEmptyBufferPoolIsAMissedTrigger) {
  Bench bench(1);
  bench.Trigger();
  bench.Trigger();
  EXPECT_EQ(bench.commanded.size(), 1U);
  bench.controller.OnFrame(FrameFor(bench.commanded[0]));
  ASSERT_EQ(bench.sink.lines.size(), 2U);
  EXPECT_EQ(bench.record(1).status, FrameStatus::kMissedTrigger);
  EXPECT_NE(bench.record(1).detail.find("no free frame buffer"), std::string::npos);
}

TEST(CaptureController, WithoutRoomForALineATriggerIsRefusedAndTakesNoNumber) {
  Bench bench(4, 1);
  bench.Trigger();
  const auto refused = bench.TryTrigger();
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kTemporary);
  EXPECT_EQ(bench.controller.counts().refused, 1U);
  EXPECT_EQ(Value(bench.controller.next_trigger()), 1U);
}

TEST(CaptureController, AFrameThatDoesNotComeIsACameraTimeoutAndALateOneIsThrownAway) {
  Bench bench;
  bench.Trigger();
  ASSERT_TRUE(bench.controller.NextDeadline());
  EXPECT_EQ((*bench.controller.NextDeadline() - bench.clock.Now()).count(), 2'001'000'000);
  bench.clock.Advance(milliseconds(2001));
  bench.controller.OnTime();
  ASSERT_EQ(bench.sink.lines.size(), 1U);
  EXPECT_EQ(bench.record(0).status, FrameStatus::kCameraTimeout);
  EXPECT_EQ(bench.sink.free_buffers, 4U);
  bench.controller.OnFrame(FrameFor(bench.commanded[0]));
  EXPECT_EQ(bench.controller.counts().late_frames, 1U);
  EXPECT_EQ(bench.sink.lines.size(), 1U);
}

TEST(CaptureController, AWrongExposureNeverBecomesPixels) {
  Bench bench;
  bench.Trigger();
  CameraFrame frame = FrameFor(bench.commanded[0]);
  frame.measured_exposure->time = ExposureTime::Seconds(0.002);
  bench.controller.OnFrame(std::move(frame));
  EXPECT_EQ(bench.record(0).status, FrameStatus::kExposureMismatch);
  EXPECT_DOUBLE_EQ(bench.record(0).exposure.time.seconds(), 0.002);
  EXPECT_TRUE(std::holds_alternative<std::monostate>(bench.sink.lines[0].pixels));
  EXPECT_EQ(bench.sink.free_buffers, 4U);
}

TEST(CaptureController, AnUnprovenExposureNeverBecomesPixels) {
  Bench bench;
  bench.Trigger();
  CameraFrame frame = FrameFor(bench.commanded[0]);
  frame.measured_exposure.reset();
  bench.controller.OnFrame(std::move(frame));
  EXPECT_EQ(bench.record(0).status, FrameStatus::kExposureMismatch);
  EXPECT_EQ(bench.record(0).proof, ExposureProof::kNone);
}

TEST(CaptureController, AFrameOfAnotherSizeIsCorrupt) {
  Bench bench;
  bench.Trigger();
  CameraFrame frame = FrameFor(bench.commanded[0]);
  frame.pixels = Image<std::uint8_t>(8, 3, 3);
  bench.controller.OnFrame(std::move(frame));
  EXPECT_EQ(bench.record(0).status, FrameStatus::kCorrupt);
  EXPECT_EQ(bench.record(0).detail, "frame of 8x3 in 8 bits: expected 8x4 in 8 bits");
}

TEST(CaptureController, ATornFrameKeepsTheCamerasWord) {
  Bench bench;
  bench.Trigger();
  CameraFrame frame = FrameFor(bench.commanded[0]);
  frame.status = FrameStatus::kCorrupt;
  frame.detail = "3 packets missing";
  bench.controller.OnFrame(std::move(frame));
  EXPECT_EQ(bench.record(0).status, FrameStatus::kCorrupt);
  EXPECT_EQ(bench.record(0).detail, "3 packets missing");
  EXPECT_TRUE(std::holds_alternative<std::monostate>(bench.sink.lines[0].pixels));
}

TEST(CaptureController, AnIncompleteFrameOfARigIsCorruptAndKeepsItsPixels) {
  Bench bench;
  bench.Trigger();
  CameraFrame frame = FrameFor(bench.commanded[0]);
  frame.status = FrameStatus::kCorrupt;
  frame.detail = "incomplete: sensor 1 missing";
  frame.partial = true;
  bench.controller.OnFrame(std::move(frame));
  EXPECT_EQ(bench.record(0).status, FrameStatus::kCorrupt);
  EXPECT_EQ(bench.record(0).detail, "incomplete: sensor 1 missing");
  EXPECT_TRUE(std::holds_alternative<Image<std::uint8_t>>(bench.sink.lines[0].pixels));
  // What is not of the session's size cannot be kept either.
  bench.Trigger();
  CameraFrame other = FrameFor(bench.commanded[1]);
  other.status = FrameStatus::kCorrupt;
  other.partial = true;
  other.pixels = Image<std::uint8_t>(8, 3, 3);
  bench.controller.OnFrame(std::move(other));
  EXPECT_TRUE(std::holds_alternative<std::monostate>(bench.sink.lines[1].pixels));
}

TEST(CaptureController, ALostCameraEndsWhatIsOnItsWay) {
  Bench bench;
  bench.Trigger();
  bench.Trigger();
  bench.controller.OnCameraLost("unplugged");
  ASSERT_EQ(bench.sink.lines.size(), 2U);
  EXPECT_EQ(bench.record(1).detail, "the camera has gone: unplugged");
  EXPECT_EQ(bench.sink.free_buffers, 4U);
  EXPECT_EQ(bench.controller.recent_losses().lost, 2);
}

TEST(CaptureController, EventsTheSourceLostGetLinesOfTheirOwn) {
  Bench bench;
  const auto accepted = bench.TryTrigger(2);
  EXPECT_EQ(Value(accepted->trigger), 2U);
  bench.controller.OnFrame(FrameFor(bench.commanded[0]));
  ASSERT_EQ(bench.sink.lines.size(), 3U);
  EXPECT_EQ(bench.record(0).status, FrameStatus::kMissedTrigger);
  EXPECT_FALSE(bench.record(1).odometer_m);
  EXPECT_EQ(bench.record(2).status, FrameStatus::kOk);
}

TEST(CaptureController, AFloodOfLostEventsIsBoundedAndCounted) {
  Bench bench;
  bench.Trigger(std::uint64_t{1} << 60);
  EXPECT_EQ(bench.sink.lines.size(), 256U);
  EXPECT_EQ(bench.controller.counts().lost_unlisted, (std::uint64_t{1} << 60) - 256);
}

TEST(CaptureController, GapsInTheCamerasCounterAreCounted) {
  Bench bench;
  for (const std::uint64_t counter : {10, 11, 14}) {
    bench.Trigger();
    bench.controller.OnFrame(FrameFor(bench.commanded.back(), counter));
  }
  EXPECT_EQ(bench.controller.counts().camera_gaps, 2U);
}

TEST(CaptureController, AfterARestartTheBracketGoesOnInPhase) {
  Bench bench(4, 1000, 5, 2);
  const auto accepted = bench.TryTrigger();
  EXPECT_EQ(Value(accepted->trigger), 5U);
  EXPECT_EQ(Value(accepted->position), 2);
  EXPECT_EQ(accepted->step, 2);
}

// Whatever the camera does, the journal gets one line a trigger, numbered without a gap, and no
// buffer gets lost.
RC_GTEST_PROP(CaptureController, EveryTriggerLeavesExactlyOneLineInOrder, ()) {
  Bench bench(3);
  const auto actions = *rc::gen::container<std::vector<int>>(rc::gen::inRange(0, 9));
  std::uint64_t counter = 0;
  for (const int action : actions) {
    switch (action) {
      case 0:
      case 1:
      case 2:
        bench.Trigger();
        break;
      case 3:
        bench.refusal = bench.refusal.empty() ? "busy" : "";
        break;
      case 4:
      case 5:
        if (!bench.commanded.empty()) {
          CameraFrame frame =
              FrameFor(bench.commanded[*rc::gen::inRange<std::size_t>(0, bench.commanded.size())],
                       counter++);
          if (action == 5) frame.measured_exposure.reset();
          bench.controller.OnFrame(std::move(frame));
        }
        break;
      case 6:
        bench.clock.Advance(milliseconds(*rc::gen::inRange(0, 3000)));
        bench.controller.OnTime();
        break;
      case 7:
        bench.controller.OnCameraLost("gone");
        break;
      default:
        bench.Trigger(1);
        break;
    }
  }
  bench.clock.Advance(std::chrono::seconds(10));
  bench.controller.OnTime();
  RC_ASSERT(bench.sink.lines.size() == bench.controller.counts().triggers);
  std::size_t held = 0;
  for (std::size_t i = 0; i < bench.sink.lines.size(); ++i) {
    const CaptureLine& line = bench.sink.lines[i];
    RC_ASSERT(Value(line.record.frame) == i);
    const bool has_pixels = !std::holds_alternative<std::monostate>(line.pixels);
    RC_ASSERT(has_pixels == (line.record.status == FrameStatus::kOk));
    RC_ASSERT(has_pixels == line.holds_buffer);
    RC_ASSERT(line.record.detail.empty() == has_pixels);
    if (line.holds_buffer) ++held;
  }
  RC_ASSERT(held + bench.sink.free_buffers == 3U);
}

TEST(CaptureController, AnotherBracketHoldsFromTheNextTriggerAndInThePhaseOfItsNumber) {
  Bench bench;
  bench.Trigger();
  BracketOptions options;
  options.exposures = {ExposureTime::Seconds(0.5), ExposureTime::Seconds(0.25)};
  ASSERT_TRUE(bench.controller.SetPlan(BracketPlan::Make(options, {}).value()));
  bench.Trigger();
  bench.controller.OnFrame(FrameFor(bench.commanded[0]));
  bench.controller.OnFrame(FrameFor(bench.commanded[1]));
  ASSERT_EQ(bench.sink.lines.size(), 2U);
  EXPECT_DOUBLE_EQ(bench.record(0).exposure.time.seconds(), 0.001);
  EXPECT_EQ(bench.record(0).status, FrameStatus::kOk);
  EXPECT_DOUBLE_EQ(bench.record(1).exposure.time.seconds(), 0.25);
  options.frames_per_position = 2;
  const Status refused = bench.controller.SetPlan(BracketPlan::Make(options, {}).value());
  ASSERT_FALSE(refused);
  EXPECT_NE(refused.error().message.find("frames_per_position: 2, expected 1"), std::string::npos);
}

}  // namespace
}  // namespace omnihdr::capture_controller_test
