// Several emulated cameras as one rig: what the compliance suite does not know.

#include "drivers/v4l2/rig_camera.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <filesystem>
#include <fstream>
#include <memory>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include "core/base/file.h"
#include "drivers/v4l2/kernel_call.h"
#include "drivers/v4l2/recording.h"
#include "tests/drivers/v4l2/emulated.h"

namespace omnihdr::rig_camera_test {
namespace {

using emulators::V4l2CameraModel;
using emulators::V4l2ModelOptions;
using std::chrono::milliseconds;
using ::testing::HasSubstr;
using ::testing::Not;

constexpr int kRows = 24;

// Three cameras, each with its own pace, latency and light, so that no picture passes for another.
class RigCameraTest : public ::testing::Test {
 protected:
  void SetUp() override {
    for (int i = 0; i < 3; ++i) {
      V4l2ModelOptions options;
      options.path = "/dev/video" + std::to_string(2 * i);
      options.name = "pci-usb-" + std::to_string(i);
      options.serial = "S" + std::to_string(i);
      options.interval_s = 0.004 + 0.0013 * i;
      options.latency_frames = 1 + i;
      options.light = 100000.0 * (1.0 + 0.3 * i);
      models_.push_back(std::make_shared<V4l2CameraModel>(options, clock_));
    }
    WriteRig(3);
    options_.rig_file = rig();
    options_.coding = v4l2::Coding::kGrey;
    options_.frame_timeout_s = 3.0;  // the machine may be busy
    // Not the kernel's order, and by three kinds of names.
    options_.devices = {"S2", "/dev/video0", "pci-usb-1"};
  }
  std::filesystem::path rig() const { return folder_.path() / "head.toml"; }
  void WriteRig(int sensors) const {
    std::ofstream(rig()) << emulators::EmulatedRig(sensors, 32, kRows, BayerOrder::kNone);
  }
  V4l2CameraModel& ModelOf(int sensor) {
    constexpr int kModels[] = {2, 0, 1};
    return *models_[static_cast<std::size_t>(kModels[sensor])];
  }
  void Make() {
    camera_ = std::make_unique<v4l2::V4l2RigCamera>(
        options_, [this](std::size_t) { return emulators::MakeEmulatedV4l2(models_); },
        milliseconds(50));
  }
  void Begin() {
    Make();
    const Result<CameraInfo> info = camera_->Open();
    ASSERT_TRUE(info) << info.error().message;
    info_ = *info;
    const Status started = camera_->Start();
    ASSERT_TRUE(started) << started.error().message;
  }
  Error OpenError() {
    Make();
    const Result<CameraInfo> info = camera_->Open();
    EXPECT_FALSE(info);
    return info ? Error{} : info.error();
  }
  CameraFrame TakeOne(double seconds) {
    Result<CameraFrame> frame = testing::TakePicture(*camera_, next_++, seconds);
    EXPECT_TRUE(frame) << frame.error().message;
    return frame ? std::move(*frame) : CameraFrame{};
  }
  // The sensor's rows are its own camera's scene at that exposure.
  void ExpectSensor(const CameraFrame& frame, int sensor, double seconds) {
    const auto& image = std::get<Image<std::uint8_t>>(frame.pixels);
    for (int y = 0; y < kRows; ++y) {
      for (int x = 0; x < image.width(); ++x) {
        const double share = std::min(ModelOf(sensor).Brightness(seconds, 1.0, x, y), 1.0);
        ASSERT_EQ(image.at(x, sensor * kRows + y), std::lround(share * 255.0))
            << "sensor " << sensor << ": " << x << " " << y;
      }
    }
  }
  void ExpectBlack(const CameraFrame& frame, int sensor) {
    const auto& image = std::get<Image<std::uint8_t>>(frame.pixels);
    for (int y = 0; y < kRows; ++y) {
      for (int x = 0; x < image.width(); ++x) ASSERT_EQ(image.at(x, sensor * kRows + y), 0);
    }
  }

  SystemClock clock_;
  const testing::TemporaryDirectory folder_;
  std::vector<std::shared_ptr<V4l2CameraModel>> models_;
  v4l2::V4l2CameraOptions options_;
  std::unique_ptr<v4l2::V4l2RigCamera> camera_;
  CameraInfo info_;
  std::uint64_t next_ = 0;
};

TEST_F(RigCameraTest, EverySensorsRowsAreItsOwnCamerasSceneAtTheTriggersExposure) {
  Begin();
  EXPECT_EQ(info_.description.height, 3 * kRows);
  EXPECT_EQ(info_.description.model, "3 x Emulated Camera");
  EXPECT_EQ(info_.description.serial, "S2+S0+S1");
  EXPECT_EQ(info_.proof, ExposureProof::kLatency);
  EXPECT_GE(info_.exposure_latency_frames, 2);
  // No longer than the fastest camera's frame.
  EXPECT_NEAR(info_.longest.seconds(), 0.004, 1e-9);
  std::uint64_t counter = 0;
  for (const double seconds : {0.0002, 0.003, 0.0004, 0.0015, 0.0015, 0.0002}) {
    const HostTime before = clock_.Now();
    const CameraFrame frame = TakeOne(seconds);
    ASSERT_EQ(frame.status, FrameStatus::kOk) << frame.detail;
    EXPECT_FALSE(frame.partial);
    EXPECT_EQ(frame.proof, ExposureProof::kLatency);
    ASSERT_TRUE(frame.measured_exposure);
    EXPECT_NEAR(frame.measured_exposure->time.seconds(), seconds, 1e-9);
    EXPECT_GE(frame.mid_exposure, before);
    EXPECT_EQ(frame.camera_counter, ++counter);
    for (int sensor = 0; sensor < 3; ++sensor) ExpectSensor(frame, sensor, seconds);
  }
  EXPECT_EQ(camera_->counts().incomplete, 0U);
}

TEST_F(RigCameraTest, AnUnpluggedMemberMakesIncompleteSetsUntilItIsBack) {
  Begin();
  ASSERT_EQ(TakeOne(0.002).status, FrameStatus::kOk);
  ModelOf(1).Unplug();
  // Its leaving may be noticed before or after the trigger.
  for (int i = 0; i < 3; ++i) {
    const CameraFrame frame = TakeOne(0.001);
    ASSERT_EQ(frame.status, FrameStatus::kCorrupt);
    EXPECT_TRUE(frame.partial);
    EXPECT_THAT(frame.detail, HasSubstr("incomplete: sensor 1 \"1\" missing: "));
    EXPECT_THAT(frame.detail, Not(HasSubstr("sensor 0")));
    ExpectSensor(frame, 0, 0.001);
    ExpectBlack(frame, 1);
    ExpectSensor(frame, 2, 0.001);
  }
  EXPECT_EQ(camera_->counts().away, 1U);
  EXPECT_EQ(camera_->counts().incomplete, 3U);
  ModelOf(1).PlugIn();
  const HostTime deadline = clock_.Now() + std::chrono::seconds(20);
  while (camera_->counts().away > 0 && clock_.Now() < deadline) {
    std::this_thread::sleep_for(milliseconds(10));
  }
  EXPECT_EQ(camera_->counts().returns, 1U);
  // What came back with everything automatic has been set up again.
  EXPECT_EQ(ModelOf(1).ControlNow(V4L2_CID_EXPOSURE_AUTO), V4L2_EXPOSURE_MANUAL);
  const CameraFrame frame = TakeOne(0.003);
  ASSERT_EQ(frame.status, FrameStatus::kOk) << frame.detail;
  for (int sensor = 0; sensor < 3; ++sensor) ExpectSensor(frame, sensor, 0.003);
}

TEST_F(RigCameraTest, AMemberThatIsSilentIsMissingInTimeAndItsLateFrameJoinsNoOtherSet) {
  options_.frame_timeout_s = 2.0;
  Begin();
  ASSERT_EQ(TakeOne(0.002).status, FrameStatus::kOk);
  V4l2CameraModel::Faults faults;
  faults.silent = true;
  ModelOf(2).SetFaults(faults);
  const HostTime before = clock_.Now();
  const CameraFrame frame = TakeOne(0.001);
  EXPECT_LT(clock_.Now() - before, milliseconds(2000));
  ASSERT_EQ(frame.status, FrameStatus::kCorrupt);
  EXPECT_THAT(frame.detail, HasSubstr("sensor 2 \"2\" missing: no picture in time"));
  ExpectSensor(frame, 0, 0.001);
  ExpectBlack(frame, 2);
  // Its picture of that trigger comes with the next one's, and has another exposure.
  ModelOf(2).SetFaults({});
  int complete = 0;
  for (int i = 0; i < 10 && complete < 2; ++i) {
    const double seconds = i % 2 == 0 ? 0.003 : 0.0005;
    const CameraFrame next = TakeOne(seconds);
    if (next.status != FrameStatus::kOk) continue;
    ++complete;
    for (int sensor = 0; sensor < 3; ++sensor) ExpectSensor(next, sensor, seconds);
  }
  EXPECT_EQ(complete, 2);
  EXPECT_GE(camera_->counts().late_frames, 1U);
}

TEST_F(RigCameraTest, TwoTriggersOnTheirWayAreTwoSetsHoweverTheirFramesArrive) {
  Begin();
  std::vector<double> asked;
  std::vector<CameraFrame> frames;
  const double exposures[] = {0.0004, 0.003, 0.001};
  const HostTime deadline = clock_.Now() + std::chrono::seconds(30);
  while (frames.size() < 12 && clock_.Now() < deadline) {
    ExposureRequest request;
    request.trigger = TriggerId{asked.size()};
    request.exposure.time = ExposureTime::Seconds(exposures[asked.size() % 3]);
    request.trigger_time = clock_.Now();
    if (asked.size() < 12 && camera_->Trigger(request)) {
      asked.push_back(request.exposure.time.seconds());
    }
    Result<CameraFrame> frame = camera_->Receive(milliseconds(1));
    if (frame) frames.push_back(std::move(*frame));
  }
  ASSERT_EQ(frames.size(), 12U);
  for (std::size_t i = 0; i < frames.size(); ++i) {
    EXPECT_EQ(Value(frames[i].trigger), i);
    ASSERT_EQ(frames[i].status, FrameStatus::kOk) << frames[i].detail;
    for (int sensor = 0; sensor < 3; ++sensor) ExpectSensor(frames[i], sensor, asked[i]);
  }
}

TEST_F(RigCameraTest, WhatComesNextIsPreparedInEveryCamera) {
  Begin();
  ASSERT_EQ(TakeOne(0.0004).status, FrameStatus::kOk);
  const auto prepared = [this] {
    for (const CameraCounter& each : camera_->Counters()) {
      if (each.name == "prepared_exposures") return each.value;
    }
    return std::uint64_t{0};
  };
  camera_->Prepare({ExposureTime::Seconds(0.003), GainDb{}});
  const HostTime deadline = clock_.Now() + std::chrono::seconds(10);
  while (prepared() < 3 && clock_.Now() < deadline) std::this_thread::sleep_for(milliseconds(1));
  EXPECT_EQ(prepared(), 3U);
  const CameraFrame frame = TakeOne(0.003);
  ASSERT_EQ(frame.status, FrameStatus::kOk) << frame.detail;
  for (int sensor = 0; sensor < 3; ++sensor) ExpectSensor(frame, sensor, 0.003);
}

TEST_F(RigCameraTest, ASetHasTheWeakestProofOfItsMembers) {
  V4l2CameraModel::Faults faults;
  faults.dark = true;
  ModelOf(2).SetFaults(faults);
  Begin();
  EXPECT_EQ(info_.proof, ExposureProof::kReadback);
  const CameraFrame frame = TakeOne(0.002);
  ASSERT_EQ(frame.status, FrameStatus::kOk) << frame.detail;
  EXPECT_EQ(frame.proof, ExposureProof::kReadback);
  EXPECT_THAT(frame.settings_readback_json, HasSubstr("\"proof\":\"latency\""));
  EXPECT_THAT(frame.settings_readback_json, HasSubstr("\"proof\":\"readback\""));
  EXPECT_THAT(frame.settings_readback_json, HasSubstr("\"skew_s\":"));
}

TEST_F(RigCameraTest, ASetTellsTheExposureThatIsFarthestFromWhatWasAsked) {
  Begin();
  V4l2CameraModel::Faults faults;
  faults.stuck[V4L2_CID_EXPOSURE_ABSOLUTE] = 20;
  ModelOf(1).SetFaults(faults);
  const CameraFrame frame = TakeOne(0.0023);
  ASSERT_TRUE(frame.measured_exposure);
  EXPECT_NEAR(frame.measured_exposure->time.seconds(), 0.002, 1e-9);
}

TEST_F(RigCameraTest, ADamagedPictureOfOneSensorMakesTheSetCorruptAndIsNamed) {
  Begin();
  ASSERT_EQ(TakeOne(0.001).status, FrameStatus::kOk);
  V4l2CameraModel::Faults faults;
  faults.damaged = 50;
  ModelOf(0).SetFaults(faults);
  const CameraFrame frame = TakeOne(0.001);
  ASSERT_EQ(frame.status, FrameStatus::kCorrupt);
  EXPECT_TRUE(frame.partial);
  EXPECT_THAT(frame.detail, HasSubstr("incomplete: sensor 0 \"0\": the driver calls buffer"));
  ExpectSensor(frame, 1, 0.001);
}

TEST_F(RigCameraTest, WhenAllHaveGoneTheRigHasAndSaysWhy) {
  Begin();
  ASSERT_EQ(TakeOne(0.001).status, FrameStatus::kOk);
  for (const auto& model : models_) model->Unplug();
  Result<CameraFrame> gone = camera_->Receive(std::chrono::seconds(5));
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().kind, ErrorKind::kUnavailable);
  EXPECT_THAT(gone.error().message, HasSubstr("sensor 2 \"2\" (pci-usb-1): "));
  for (const auto& model : models_) model->PlugIn();
  camera_->Stop();
  camera_->Close();
  ASSERT_TRUE(camera_->Open());
  ASSERT_TRUE(camera_->Start());
  EXPECT_EQ(TakeOne(0.001).status, FrameStatus::kOk);
}

TEST_F(RigCameraTest, EveryCameraThatIsNotThereIsNamed) {
  options_.devices = {"S0", "nobody", "nothing"};
  const Error error = OpenError();
  EXPECT_EQ(error.kind, ErrorKind::kUnavailable);
  EXPECT_THAT(error.message, HasSubstr("V4L2 rig: sensor 1 \"1\" (nobody): "));
  EXPECT_THAT(error.message, HasSubstr("sensor 2 \"2\" (nothing): "));
}

TEST_F(RigCameraTest, OneCameraUnderTwoNamesIsRefused) {
  options_.devices = {"S0", "S1", "/dev/video0"};
  options_.latency_frames = 4;
  const Error error = OpenError();
  EXPECT_EQ(error.kind, ErrorKind::kConfig);
  EXPECT_THAT(error.message, HasSubstr("devices[0], devices[2]: \"S0\", \"/dev/video0\""));
}

TEST_F(RigCameraTest, AsManyCamerasAsTheRigHasSensorsAreNeeded) {
  WriteRig(4);
  EXPECT_THAT(OpenError().message, HasSubstr("devices: 3: expected 4, one for each sensor of"));
}

TEST_F(RigCameraTest, CamerasOfDifferentDepthAreRefused) {
  V4l2ModelOptions deep = models_[1]->options();
  deep.formats = {V4L2_PIX_FMT_Y12};
  models_[1] = std::make_shared<V4l2CameraModel>(deep, clock_);
  options_.coding = v4l2::Coding::kAuto;
  options_.latency_frames = 4;
  const Error error = OpenError();
  EXPECT_EQ(error.kind, ErrorKind::kConfig);
  EXPECT_THAT(error.message, HasSubstr("sensor 2 \"2\" (pci-usb-1): 12 bits"));
}

TEST_F(RigCameraTest, AfterStopItStartsAgainWithoutBeingOpenedAnew) {
  Begin();
  for (int i = 0; i < 3; ++i) {
    ASSERT_EQ(TakeOne(0.001).status, FrameStatus::kOk);
    camera_->Stop();
    EXPECT_FALSE(camera_->Receive(milliseconds(1)));
    ASSERT_TRUE(camera_->Start());
  }
}

// What a rig delivers for a few triggers.
std::vector<CameraFrame> TakeSome(Camera& camera) {
  std::vector<CameraFrame> frames;
  const Result<CameraInfo> info = camera.Open();
  EXPECT_TRUE(info) << info.error().message;
  if (!info || !camera.Start()) return frames;
  std::uint64_t number = 0;
  for (const double seconds : {0.0004, 0.002, 0.002, 0.001}) {
    Result<CameraFrame> frame = testing::TakePicture(camera, number++, seconds);
    EXPECT_TRUE(frame) << frame.error().message;
    if (frame) frames.push_back(std::move(*frame));
  }
  camera.Stop();
  camera.Close();
  return frames;
}

class RigRecording : public RigCameraTest {
 protected:
  std::filesystem::path file() const { return folder_.path() / "rig.v4l2"; }
  v4l2::V4l2RigCamera::MakeSystem Emulated() {
    return [this](std::size_t) { return emulators::MakeEmulatedV4l2(models_); };
  }
  std::vector<CameraFrame> Record() {
    auto make = v4l2::MakeRecordingSystems(Emulated(), 3, {.file = file()});
    EXPECT_TRUE(make) << make.error().message;
    v4l2::V4l2RigCamera camera(options_, std::move(*make));
    return TakeSome(camera);
  }
};

TEST_F(RigRecording, PlayedBackItGivesTheSameFramesWithTheSameProof) {
  const std::vector<CameraFrame> recorded = Record();
  ASSERT_EQ(recorded.size(), 4U);
  auto camera = v4l2::MakeReplayedCamera(options_, file());
  ASSERT_TRUE(camera) << camera.error().message;
  const std::vector<CameraFrame> played = TakeSome(**camera);
  ASSERT_EQ(played.size(), 4U);
  for (std::size_t i = 0; i < played.size(); ++i) {
    EXPECT_EQ(played[i].status, FrameStatus::kOk) << played[i].detail;
    EXPECT_EQ(played[i].measured_exposure, recorded[i].measured_exposure);
    EXPECT_EQ(played[i].proof, recorded[i].proof);
    EXPECT_EQ(played[i].settings_readback_json, recorded[i].settings_readback_json)
        << "each sensor's setting, and how far their exposures lie apart";
    const auto& a = std::get<Image<std::uint8_t>>(played[i].pixels);
    const auto& b = std::get<Image<std::uint8_t>>(recorded[i].pixels);
    EXPECT_TRUE(
        std::equal(a.values().begin(), a.values().end(), b.values().begin(), b.values().end()));
  }
}

// Where the call is over with which a recording's trigger of this number was taken.
std::size_t EndOfTrigger(const std::vector<std::byte>& bytes, int number) {
  auto calls = recording::RecordedCalls::Read(bytes, v4l2::kKernelCallMagic, "calls").value();
  std::size_t end = v4l2::kKernelCallMagic.size();
  while (const auto call = calls.Next()) {
    end += 4 + call->size();
    const auto decoded = v4l2::DecodeCall(*call);
    if (!decoded || decoded->kind != v4l2::KernelCall::Kind::kTrigger) continue;
    if (number-- == 0) return end;
  }
  ADD_FAILURE() << "no such trigger";
  return end;
}

TEST_F(RigRecording, ACameraWhoseRecordingEndsIsAMissingSensorThatSaysSo) {
  ASSERT_EQ(Record().size(), 4U);
  std::vector<std::vector<std::byte>> recordings;
  for (std::size_t i = 0; i < 3; ++i) {
    recordings.push_back(ReadFile(v4l2::RecordingOfMember(file(), i)).value());
  }
  recordings[1].resize(EndOfTrigger(recordings[1], 2));
  auto camera = v4l2::MakeReplayedRig(options_, recordings);
  ASSERT_TRUE(camera) << camera.error().message;
  ASSERT_TRUE((*camera)->Open());
  ASSERT_TRUE((*camera)->Start());
  std::uint64_t number = 0;
  for (const double seconds : {0.0004, 0.002, 0.002, 0.001}) {
    const Result<CameraFrame> frame = testing::TakePicture(**camera, number++, seconds);
    ASSERT_TRUE(frame) << frame.error().message;
    EXPECT_EQ(frame->status, number <= 2 ? FrameStatus::kOk : FrameStatus::kCorrupt);
    if (frame->status == FrameStatus::kOk) continue;
    EXPECT_TRUE(frame->partial);
    EXPECT_THAT(frame->detail, HasSubstr("sensor 1"));
    EXPECT_THAT(frame->detail, HasSubstr("the recording has ended"));
  }
}

TEST_F(RigRecording, AFileForEachCameraIsNeededAndOneThatCannotBeMadeIsSaidAtOnce) {
  const auto none = v4l2::MakeReplayedCamera(options_, file());
  ASSERT_FALSE(none);
  EXPECT_THAT(none.error().message, HasSubstr("rig.v4l2.0"));
  EXPECT_EQ(v4l2::MakeReplayedRig(options_, {}).error().kind, ErrorKind::kData);
  const auto make =
      v4l2::MakeRecordingSystems(Emulated(), 3, {.file = folder_.path() / "none" / "rig"});
  ASSERT_FALSE(make);
  EXPECT_EQ(make.error().kind, ErrorKind::kCannotCreate);
}

}  // namespace
}  // namespace omnihdr::rig_camera_test
