#include "drivers/sim/sim_camera.h"

#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <thread>

#include "drivers/sim/sensor.h"
#include "tests/emulators/pulsed_wire.h"

namespace omnihdr::sim::sim_camera_test {
namespace {

using std::chrono::milliseconds;

std::shared_ptr<const World> SharedWorld() {
  static const auto world = World::Create(SceneKind::kTunnel, 1);
  return world;
}

SimCameraOptions SmallOptions() {
  SimCameraOptions options;
  options.simulation.scene = SceneKind::kTunnel;
  options.simulation.width = 128;
  options.simulation.samples = 1;
  options.readout_s = 0.0;
  return options;
}

ExposureRequest Request(std::uint64_t trigger, double seconds) {
  ExposureRequest request;
  request.trigger = TriggerId{trigger};
  request.exposure.time = ExposureTime::Seconds(seconds);
  request.trigger_time = SystemClock().Now();
  return request;
}

Result<CameraFrame> Take(SimCamera& camera, const ExposureRequest& request,
                         Nanoseconds timeout = std::chrono::seconds(5)) {
  for (int i = 0; i < 2000; ++i) {
    const Status status = camera.Trigger(request);
    if (status) return camera.Receive(timeout);
    if (status.error().kind != ErrorKind::kTemporary) return Forward(status.error());
    std::this_thread::sleep_for(milliseconds(1));
  }
  return Fail(ErrorKind::kTemporary, "busy for ever");
}

bool SamePixels(const CameraFrame& a, const Image<std::uint8_t>& b) {
  const auto& image = std::get<0>(a.pixels);
  return image.size() == b.size() && std::memcmp(image.data(), b.data(), b.size()) == 0;
}

TEST(SimCamera, ReleasedByAWireItExposesAtThePulseAndNotWithoutOne) {
  SimCameraOptions options = SmallOptions();
  const auto wire = std::make_shared<emulators::PulsedWire>([] {}, milliseconds(30));
  options.release = wire;
  SimCamera camera(options, SharedWorld());
  const auto info = camera.Open();
  ASSERT_TRUE(info) << info.error().message;
  EXPECT_GE(info->min_trigger_interval, milliseconds(30));
  ASSERT_TRUE(camera.Start());
  const Result<CameraFrame> frame = Take(camera, Request(0, 0.001));
  ASSERT_TRUE(frame) << frame.error().message;
  EXPECT_EQ(frame->status, FrameStatus::kOk);
  EXPECT_EQ(wire->pulses(), 1);
  wire->Cut(true);
  const Result<CameraFrame> missed = Take(camera, Request(1, 0.001));
  ASSERT_TRUE(missed) << missed.error().message;
  EXPECT_EQ(missed->status, FrameStatus::kMissedTrigger);
  EXPECT_EQ(missed->detail, "camera trigger: the wire is cut");
  EXPECT_EQ(wire->pulses(), 1);
  options.wired = true;
  EXPECT_FALSE(options.Validate());
}

TEST(SimCamera, OnTheTriggersWireAPulseExposesWithWhatWasPreparedAndSaysWhen) {
  SimCameraOptions options = SmallOptions();
  options.wired = true;
  options.readout_s = 0.2;
  SimCamera camera(options, SharedWorld());
  const auto info = camera.Open();
  ASSERT_TRUE(info);
  EXPECT_TRUE(info->wired);
  ASSERT_TRUE(camera.Start());
  camera.Prepare({ExposureTime::Seconds(0.002), GainDb{0.0}});
  const ExposureRequest told = Request(0, 0.5);
  ASSERT_TRUE(camera.Trigger(told));
  ASSERT_TRUE(camera.Trigger(Request(1, 0.5))) << "a busy sensor does not see it, and nobody knows";
  const auto frame = camera.Receive(std::chrono::seconds(5));
  ASSERT_TRUE(frame) << frame.error().message;
  ASSERT_TRUE(frame->wired);
  EXPECT_EQ(frame->wired->at, told.trigger_time);
  EXPECT_EQ(frame->measured_exposure->time.seconds(), 0.002);
  camera.Pulse();
  const auto untold = camera.Receive(std::chrono::seconds(5));
  ASSERT_TRUE(untold) << untold.error().message;
  EXPECT_EQ(untold->camera_counter, frame->camera_counter + 1);
}

TEST(SimCamera, AFrameShowsTheWorldFromWhereTheOdometerSays) {
  const SimCameraOptions options = SmallOptions();
  SimCamera camera(options, SharedWorld());
  ASSERT_TRUE(camera.Open());
  ASSERT_TRUE(camera.Start());
  ExposureRequest request = Request(4, 0.01);
  request.odometer_m = 2.345;
  const Result<CameraFrame> frame = Take(camera, request);
  ASSERT_TRUE(frame) << frame.error().message;
  const Pose pose = options.simulation.PoseAt(*SharedWorld(), 2.345);
  const RenderedView view =
      SharedWorld()->Render(pose, options.simulation.MakeProjection(), options.simulation.samples);
  EXPECT_TRUE(
      SamePixels(*frame, Expose(view.radiance, request.exposure, options.simulation.sensor, 4)));
  const auto truth = nlohmann::json::parse(frame->truth_json);
  EXPECT_NEAR(truth["pose"]["t"][0].get<double>(), pose.translation.x(), 1e-12);
  EXPECT_NEAR(truth["pose"]["q"][0].get<double>(), pose.rotation.w(), 1e-12);
  EXPECT_EQ(truth["scene"], "tunnel");
  EXPECT_EQ(truth["seed"], 1);
}

TEST(SimCamera, WithoutAnOdometerTheVehicleIsAtTriggerNumberTimesInterval) {
  const SimCameraOptions options = SmallOptions();
  SimCamera camera(options, SharedWorld());
  ASSERT_TRUE(camera.Open());
  ASSERT_TRUE(camera.Start());
  for (std::uint64_t trigger = 0; trigger < 4; ++trigger) {
    const Result<CameraFrame> frame = Take(camera, Request(trigger, 0.01));
    ASSERT_TRUE(frame) << frame.error().message;
    const auto truth = nlohmann::json::parse(frame->truth_json);
    EXPECT_NEAR(truth["odometer_m"].get<double>(),
                static_cast<double>(trigger) * options.interval_m, 1e-9);
  }
}

TEST(SimCamera, OpenTellsHowToRenderTheTruthAgain) {
  SimCameraOptions options = SmallOptions();
  options.simulation.motion.yaw_deg_per_m = 33.0;
  options.simulation.projection = ProjectionKind::kCylindrical;
  SimCamera camera(options, SharedWorld());
  const Result<CameraInfo> info = camera.Open();
  ASSERT_TRUE(info);
  const Result<Simulation> again = ParseSimulation(info->extra_json);
  ASSERT_TRUE(again) << again.error().message;
  EXPECT_EQ(again->scene, SceneKind::kTunnel);
  EXPECT_EQ(again->motion.yaw_deg_per_m, 33.0);
  EXPECT_EQ(again->MakeProjection(), options.simulation.MakeProjection());
  EXPECT_EQ(info->description.PanoramaProjection(), options.simulation.MakeProjection());
  EXPECT_GT(info->min_trigger_interval.count(), 0);
}

TEST(SimCamera, ALostFrameLeavesAGapInTheCounterAndNoFrame) {
  SimCameraOptions options = SmallOptions();
  options.faults.lost = {1};
  SimCamera camera(options, SharedWorld());
  ASSERT_TRUE(camera.Open());
  ASSERT_TRUE(camera.Start());
  ASSERT_EQ(Take(camera, Request(0, 0.001))->camera_counter, 0U);
  const Result<CameraFrame> lost = Take(camera, Request(1, 0.001), milliseconds(300));
  ASSERT_FALSE(lost);
  EXPECT_EQ(lost.error().kind, ErrorKind::kTemporary);
  const Result<CameraFrame> next = Take(camera, Request(2, 0.001));
  ASSERT_TRUE(next);
  EXPECT_EQ(next->camera_counter, 2U);
}

TEST(SimCamera, ATornFrameIsDeliveredAndMarked) {
  SimCameraOptions options = SmallOptions();
  options.faults.torn = {1};
  SimCamera camera(options, SharedWorld());
  ASSERT_TRUE(camera.Open());
  ASSERT_TRUE(camera.Start());
  const Result<CameraFrame> before = Take(camera, Request(0, 0.02));
  const Result<CameraFrame> torn = Take(camera, Request(1, 0.001));
  ASSERT_TRUE(before);
  ASSERT_TRUE(torn);
  EXPECT_EQ(torn->status, FrameStatus::kCorrupt);
  EXPECT_FALSE(torn->detail.empty());
  const auto& a = std::get<0>(before->pixels);
  const auto& b = std::get<0>(torn->pixels);
  const std::size_t half = a.size() / 2;
  EXPECT_EQ(std::memcmp(a.data() + half, b.data() + half, half), 0);
  EXPECT_NE(std::memcmp(a.data(), b.data(), half), 0);
}

TEST(SimCamera, AnExposureThatWasNotAppliedIsReportedTruthfully) {
  SimCameraOptions options = SmallOptions();
  options.faults.exposure = {0, 1};
  SimCamera camera(options, SharedWorld());
  ASSERT_TRUE(camera.Open());
  ASSERT_TRUE(camera.Start());
  const Result<CameraFrame> first = Take(camera, Request(0, 0.001));
  ASSERT_TRUE(first);
  EXPECT_EQ(first->status, FrameStatus::kOk);
  EXPECT_NEAR(first->measured_exposure->time.seconds(), 0.002, 1e-12);
  const Result<CameraFrame> second = Take(camera, Request(1, 0.008));
  ASSERT_TRUE(second);
  EXPECT_EQ(second->proof, ExposureProof::kEmbedded);
  EXPECT_NEAR(second->measured_exposure->time.seconds(), 0.001, 1e-12);
}

TEST(SimCamera, FaultsByChanceComeAboutAsOftenAsAskedAndAtTheSameTriggers) {
  SimCameraOptions options = SmallOptions();
  options.faults.torn_probability = 0.3;
  std::vector<bool> runs[2];
  for (auto& torn : runs) {
    SimCamera camera(options, SharedWorld());
    ASSERT_TRUE(camera.Open());
    ASSERT_TRUE(camera.Start());
    for (std::uint64_t i = 0; i < 60; ++i) {
      const Result<CameraFrame> frame = Take(camera, Request(i, 0.0001));
      ASSERT_TRUE(frame);
      torn.push_back(frame->status == FrameStatus::kCorrupt);
    }
  }
  EXPECT_EQ(runs[0], runs[1]);
  const auto count = std::count(runs[0].begin(), runs[0].end(), true);
  EXPECT_GE(count, 8);
  EXPECT_LE(count, 30);
}

TEST(SimCamera, LatencyDelaysTheArrivalOfAFrame) {
  SimCameraOptions options = SmallOptions();
  options.latency_s = 0.2;
  SimCamera camera(options, SharedWorld());
  ASSERT_TRUE(camera.Open());
  ASSERT_TRUE(camera.Start());
  const HostTime before = SystemClock().Now();
  ASSERT_TRUE(Take(camera, Request(0, 0.001)));
  EXPECT_GE(SystemClock().Now() - before, milliseconds(200));
}

TEST(SimCamera, ATriggerDuringTheExposureIsRefusedAsBusy) {
  SimCamera camera(SmallOptions(), SharedWorld());
  ASSERT_TRUE(camera.Open());
  ASSERT_TRUE(camera.Start());
  ASSERT_TRUE(camera.Trigger(Request(0, 0.3)));
  const Status busy = camera.Trigger(Request(1, 0.3));
  ASSERT_FALSE(busy);
  EXPECT_EQ(busy.error().kind, ErrorKind::kTemporary);
}

TEST(SimCamera, ADeviceThatVanishesComesBackAfterItsTime) {
  SimCameraOptions options = SmallOptions();
  options.faults.vanish = {1};
  options.faults.away_s = 0.15;
  SimCamera camera(options, SharedWorld());
  ASSERT_TRUE(camera.Open());
  ASSERT_TRUE(camera.Start());
  ASSERT_TRUE(Take(camera, Request(0, 0.001)));
  EXPECT_EQ(camera.Trigger(Request(1, 0.001)).error().kind, ErrorKind::kUnavailable);
  EXPECT_EQ(camera.Receive(milliseconds(10)).error().kind, ErrorKind::kUnavailable);
  EXPECT_EQ(camera.Open().error().kind, ErrorKind::kUnavailable);
  std::this_thread::sleep_for(milliseconds(200));
  ASSERT_TRUE(camera.Open());
  ASSERT_TRUE(camera.Start());
  EXPECT_TRUE(Take(camera, Request(2, 0.001)));
}

TEST(SimCamera, ADeviceVanishesByChanceAsOftenAsAsked) {
  SimCameraOptions options = SmallOptions();
  options.faults.vanish_probability = 0.25;
  options.faults.away_s = 0.0;
  SimCamera camera(options, SharedWorld());
  int vanished = 0;
  for (std::uint64_t trigger = 0; trigger < 100; ++trigger) {
    ASSERT_TRUE(camera.Open());
    ASSERT_TRUE(camera.Start());
    const Status taken = camera.Trigger(Request(trigger, 1e-6));
    if (!taken && taken.error().kind == ErrorKind::kUnavailable) ++vanished;
    camera.Stop();
  }
  EXPECT_GT(vanished, 10);
  EXPECT_LT(vanished, 40);
}

TEST(SimCamera, OptionsOutOfRangeAreReportedByOpen) {
  SimCameraOptions options = SmallOptions();
  options.simulation.width = 7;
  SimCamera camera(options);
  const Result<CameraInfo> info = camera.Open();
  ASSERT_FALSE(info);
  EXPECT_EQ(info.error().kind, ErrorKind::kConfig);
  EXPECT_NE(info.error().message.find("width: 7"), std::string::npos);
}

}  // namespace
}  // namespace omnihdr::sim::sim_camera_test
