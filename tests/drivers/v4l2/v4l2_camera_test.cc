// The camera over the emulated kernel: what the compliance suite does not know, faults above all.

#include "drivers/v4l2/v4l2_camera.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <atomic>
#include <cerrno>
#include <map>
#include <string>
#include <thread>
#include <vector>

#include "drivers/v4l2/find_camera.h"
#include "tests/drivers/v4l2/emulated.h"

namespace omnihdr::v4l2_camera_test {
namespace {

using emulators::V4l2CameraModel;
using emulators::V4l2ModelOptions;
using ::testing::ElementsAre;
using testing::EmulatedV4l2;
using ::testing::HasSubstr;

class V4l2CameraTest : public ::testing::Test {
 protected:
  void Plug(const V4l2ModelOptions& options, BayerOrder bayer = BayerOrder::kNone) {
    camera_.reset();
    emulated_ = std::make_unique<EmulatedV4l2>(options, bayer);
  }
  void Begin() { Begin(emulated_->CameraOptions()); }
  void Begin(const v4l2::V4l2CameraOptions& options) {
    camera_ = emulated_->MakeCamera(options);
    const Result<CameraInfo> info = camera_->Open();
    ASSERT_TRUE(info) << info.error().message;
    info_ = *info;
    const Status started = camera_->Start();
    ASSERT_TRUE(started) << started.error().message;
  }
  Error OpenError(const v4l2::V4l2CameraOptions& options) {
    camera_ = emulated_->MakeCamera(options);
    const Result<CameraInfo> info = camera_->Open();
    EXPECT_FALSE(info);
    return info ? Error{} : info.error();
  }
  CameraFrame TakeOne(double seconds, double gain_db = 0.0) {
    Result<CameraFrame> frame = testing::TakePicture(*camera_, next_++, seconds, gain_db);
    EXPECT_TRUE(frame) << frame.error().message;
    return frame ? std::move(*frame) : CameraFrame{};
  }
  // Every pixel of a one-channel picture is the scene's at that exposure.
  void ExpectScene(const CameraFrame& frame, double seconds, double gain, double most) {
    std::visit(
        [&](const auto& image) {
          for (int y = 0; y < image.height(); ++y) {
            for (int x = 0; x < image.width(); ++x) {
              const double share = std::min(emulated_->model->Brightness(seconds, gain, x, y), 1.0);
              ASSERT_EQ(image.at(x, y), std::lround(share * most)) << x << " " << y;
            }
          }
        },
        frame.pixels);
  }

  std::unique_ptr<EmulatedV4l2> emulated_;
  std::unique_ptr<v4l2::V4l2Camera> camera_;
  CameraInfo info_;
  std::uint64_t next_ = 0;
};

TEST(V4l2Cameras, ANodeOfMetadataIsNoCameraAndOneThatCannotBeAskedSaysWhy) {
  const EmulatedV4l2 emulated;
  const auto system = emulators::MakeEmulatedV4l2({emulated.model});
  ASSERT_EQ(system->List().size(), 2U);
  auto cameras = v4l2::ListCameras(*system);
  ASSERT_EQ(cameras.size(), 1U);
  EXPECT_EQ(cameras[0].node.path, "/dev/video2");
  EXPECT_EQ(cameras[0].card, "Emulated Camera");
  EXPECT_EQ(cameras[0].problem, "");
  emulators::V4l2CameraModel::Faults faults;
  faults.refuse[VIDIOC_QUERYCAP] = -EBUSY;
  emulated.model->SetFaults(faults);
  cameras = v4l2::ListCameras(*system);
  ASSERT_EQ(cameras.size(), 1U);
  EXPECT_THAT(cameras[0].problem, ::testing::HasSubstr("busy"));
}

TEST_F(V4l2CameraTest, EveryPixelIsTheScenesAtTheExposureThatWasProved) {
  for (const int latency : {1, 2, 5}) {
    V4l2ModelOptions options;
    options.latency_frames = latency;
    Plug(options);
    Begin();
    // No less than it is; a busy machine may make it seem more.
    EXPECT_GE(info_.exposure_latency_frames, latency - 1);
    EXPECT_EQ(info_.proof, ExposureProof::kLatency);
    for (const double seconds : {0.0002, 0.003, 0.0004, 0.0015, 0.0015}) {
      const CameraFrame frame = TakeOne(seconds);
      ASSERT_EQ(frame.status, FrameStatus::kOk) << frame.detail;
      EXPECT_EQ(frame.proof, ExposureProof::kLatency);
      ASSERT_TRUE(frame.measured_exposure);
      EXPECT_NEAR(frame.measured_exposure->time.seconds(), seconds, 1e-9);
      ExpectScene(frame, seconds, 1.0, 255.0);
    }
    EXPECT_EQ(camera_->counts().contradictions, 0U);
  }
}

// Triggers given as fast as the camera takes them, with these exposures over and over, and what
// came of them.
struct Burst {
  std::vector<double> asked;  // of the triggers that were taken
  std::vector<CameraFrame> frames;
};
Burst Shoot(Camera& camera, std::size_t triggers, const std::vector<double>& exposures) {
  const SystemClock clock;
  Burst burst;
  const HostTime deadline = clock.Now() + std::chrono::seconds(30);
  while (burst.asked.size() < triggers && clock.Now() < deadline) {
    ExposureRequest request;
    request.trigger = TriggerId{burst.asked.size()};
    request.exposure.time = ExposureTime::Seconds(exposures[burst.asked.size() % exposures.size()]);
    request.trigger_time = clock.Now();
    if (camera.Trigger(request)) burst.asked.push_back(request.exposure.time.seconds());
    Result<CameraFrame> frame = camera.Receive(std::chrono::milliseconds(1));
    if (frame) burst.frames.push_back(std::move(*frame));
  }
  while (burst.frames.size() < burst.asked.size()) {
    Result<CameraFrame> frame = camera.Receive(std::chrono::seconds(1));
    if (!frame) break;
    burst.frames.push_back(std::move(*frame));
  }
  return burst;
}

std::int64_t SequenceOf(const CameraFrame& frame) {
  const std::string key = "\"sequence\":";
  const std::size_t at = frame.settings_readback_json.find(key);
  return std::stoll(frame.settings_readback_json.substr(at + key.size()));
}

TEST_F(V4l2CameraTest, TheNextExposureIsWrittenWhileTheFrameBeforeIsStillComing) {
  V4l2ModelOptions options;
  options.latency_frames = 4;
  options.interval_s = 0.015;
  Plug(options);
  Begin();
  const Burst burst = Shoot(*camera_, 12, {0.0004, 0.003, 0.001});
  ASSERT_EQ(burst.frames.size(), 12U);
  for (std::size_t i = 0; i < burst.frames.size(); ++i) {
    const CameraFrame& frame = burst.frames[i];
    ASSERT_EQ(frame.status, FrameStatus::kOk) << frame.detail;
    EXPECT_EQ(frame.proof, ExposureProof::kLatency);
    ExpectScene(frame, burst.asked[i], 1.0, 255.0);
  }
  // One after the other, a picture takes the latency and a frame to write after: 55 frames.
  EXPECT_LT(SequenceOf(burst.frames.back()) - SequenceOf(burst.frames.front()), 44);
  EXPECT_GE(camera_->counts().early, 4U);
  EXPECT_EQ(camera_->counts().contradictions, 0U);
}

TEST_F(V4l2CameraTest, AnExposureThatWasPreparedDoesNotWaitForTheLatencyWhenItsTriggerComes) {
  V4l2ModelOptions options;
  options.latency_frames = 6;
  options.interval_s = 0.015;
  Plug(options);
  Begin();
  const auto prepared = [this] { return camera_->counts().prepared; };
  TakeOne(0.002);
  const Nanoseconds pause = std::chrono::milliseconds(200);  // over twelve frames
  std::vector<Nanoseconds> unprepared_took;
  std::vector<Nanoseconds> prepared_took;
  for (const bool prepare : {false, true}) {
    for (const double seconds : {0.0004, 0.002, 0.0004, 0.002}) {
      const std::uint64_t before = prepared();
      if (prepare) camera_->Prepare({ExposureTime::Seconds(seconds), GainDb{}});
      std::this_thread::sleep_for(pause);
      EXPECT_EQ(prepared(), before + (prepare ? 1 : 0));
      const std::size_t writes = emulated_->model->writes().size();
      const HostTime begin = SystemClock().Now();
      const CameraFrame frame = TakeOne(seconds);
      (prepare ? prepared_took : unprepared_took).push_back(SystemClock().Now() - begin);
      ASSERT_EQ(frame.status, FrameStatus::kOk) << frame.detail;
      EXPECT_EQ(frame.proof, ExposureProof::kLatency);
      ExpectScene(frame, seconds, 1.0, 255.0);
      EXPECT_EQ(emulated_->model->writes().size(), writes + (prepare ? 0 : 1));
    }
  }
  // One after the other takes the latency of six frames and more, 90 ms; a prepared one the frame
  // that is being exposed and its own.
  const auto quickest = [](const std::vector<Nanoseconds>& took) {
    return *std::min_element(took.begin(), took.end());
  };
  EXPECT_GE(quickest(unprepared_took), std::chrono::milliseconds(85));
  EXPECT_LE(quickest(prepared_took), std::chrono::milliseconds(60));
  EXPECT_EQ(camera_->counts().contradictions, 0U);
}

TEST_F(V4l2CameraTest, APreparedExposureThatIsNotAskedForCostsNothingButItself) {
  Plug({});
  Begin();
  TakeOne(0.001);
  camera_->Prepare({ExposureTime::Seconds(0.003), GainDb{}});
  const CameraFrame other = TakeOne(0.0004);
  ASSERT_EQ(other.status, FrameStatus::kOk) << other.detail;
  EXPECT_EQ(other.proof, ExposureProof::kLatency);
  ExpectScene(other, 0.0004, 1.0, 255.0);
  // One that the camera refuses is told when its trigger comes, and not before.
  V4l2CameraModel::Faults faults;
  faults.refuse[VIDIOC_S_EXT_CTRLS] = -EILSEQ;
  emulated_->model->SetFaults(faults);
  camera_->Prepare({ExposureTime::Seconds(0.003), GainDb{}});
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  const CameraFrame refused = TakeOne(0.003);
  EXPECT_EQ(refused.status, FrameStatus::kMissedTrigger);
  EXPECT_THAT(refused.detail, HasSubstr("in no state for it"));
  emulated_->model->SetFaults({});
  ExpectScene(TakeOne(0.003), 0.003, 1.0, 255.0);
}

TEST_F(V4l2CameraTest, ASceneThatGrowsDarkWhileAnExposureWaitsForItsTriggerIsNoContradiction) {
  Plug({});
  Begin();
  TakeOne(0.0004);
  camera_->Prepare({ExposureTime::Seconds(0.0016), GainDb{}});
  std::this_thread::sleep_for(std::chrono::milliseconds(150));  // over thirty frames
  ASSERT_EQ(camera_->counts().prepared, 1U);
  emulated_->model->SetLight(1.0 / 8.0);
  std::this_thread::sleep_for(std::chrono::milliseconds(50));
  const CameraFrame frame = TakeOne(0.0016);
  ASSERT_EQ(frame.status, FrameStatus::kOk) << frame.detail;
  EXPECT_EQ(frame.proof, ExposureProof::kLatency) << frame.detail;
  ExpectScene(frame, 0.0016, 1.0, 255.0);
  EXPECT_EQ(camera_->counts().contradictions, 0U);
}

TEST_F(V4l2CameraTest, APreparedExposureThatDoesNothingIsFoundOutBeforeItsTrigger) {
  Plug({});
  Begin();
  TakeOne(0.0004);
  V4l2CameraModel::Faults faults;
  faults.ignores_exposure = true;
  emulated_->model->SetFaults(faults);
  camera_->Prepare({ExposureTime::Seconds(0.003), GainDb{}});
  const SystemClock clock;
  const HostTime deadline = clock.Now() + std::chrono::seconds(10);
  while (camera_->counts().contradictions == 0 && clock.Now() < deadline) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  EXPECT_EQ(camera_->counts().contradictions, 1U);
  // Its frame is not believed, and the latency is measured anew: it cannot be.
  const CameraFrame frame = TakeOne(0.003);
  EXPECT_EQ(frame.proof, ExposureProof::kNone);
  EXPECT_THAT(frame.detail, HasSubstr("brightness went from"));
  EXPECT_EQ(TakeOne(0.001).proof, ExposureProof::kReadback);
  EXPECT_EQ(camera_->counts().measurements, 1U);
}

TEST_F(V4l2CameraTest, FramesThatAreLostInABurstCostTheirTriggersAndNoPictureHasAnotherExposure) {
  V4l2ModelOptions options;
  options.latency_frames = 3;
  Plug(options);
  v4l2::V4l2CameraOptions wanted = emulated_->CameraOptions();
  wanted.frame_timeout_s = 5.0;
  Begin(wanted);
  std::atomic<bool> ended{false};
  std::thread thief([&] {
    while (!ended) {
      std::this_thread::sleep_for(std::chrono::milliseconds(23));
      V4l2CameraModel::Faults faults;
      faults.lost = 1;
      emulated_->model->SetFaults(faults);
    }
  });
  const Burst burst = Shoot(*camera_, 40, {0.0004, 0.003, 0.001});
  ended = true;
  thief.join();
  ASSERT_EQ(burst.frames.size(), 40U);
  int whole = 0;
  for (const CameraFrame& frame : burst.frames) {
    if (frame.status == FrameStatus::kMissedTrigger) continue;
    ASSERT_EQ(frame.status, FrameStatus::kOk) << frame.detail;
    ++whole;
    ExpectScene(frame, burst.asked[Value(frame.trigger)], 1.0, 255.0);
  }
  EXPECT_GT(whole, 15);
}

TEST_F(V4l2CameraTest, WhatItCountsHasNames) {
  Plug({});
  Begin();
  TakeOne(0.001);
  V4l2CameraModel::Faults faults;
  faults.stale = 2;
  faults.lost = 3;
  emulated_->model->SetFaults(faults);
  TakeOne(0.002);
  std::map<std::string, std::uint64_t> counters;
  for (const CameraCounter& each : camera_->Counters()) counters[each.name] = each.value;
  EXPECT_EQ(counters.at("stale_frames"), 2U);
  EXPECT_EQ(counters.at("sequence_gaps"), 3U);
  EXPECT_EQ(counters.at("damaged_buffers"), 0U);
}

TEST_F(V4l2CameraTest, AutomaticIsOffBeforeTheFirstExposureIsWritten) {
  Plug({});
  Begin();
  const V4l2CameraModel& model = *emulated_->model;
  EXPECT_EQ(model.ControlNow(V4L2_CID_EXPOSURE_AUTO), V4L2_EXPOSURE_MANUAL);
  EXPECT_EQ(model.ControlNow(V4L2_CID_EXPOSURE_AUTO_PRIORITY), 0);
  EXPECT_EQ(model.ControlNow(V4L2_CID_AUTO_WHITE_BALANCE), 0);
  EXPECT_EQ(model.ControlNow(V4L2_CID_POWER_LINE_FREQUENCY), 0);
  EXPECT_THAT(model.writes().front(), ElementsAre(V4L2_CID_EXPOSURE_AUTO));
  // Exposure and gain act together.
  EXPECT_THAT(model.writes().back(), ElementsAre(V4L2_CID_EXPOSURE_ABSOLUTE, V4L2_CID_GAIN));
  EXPECT_THAT(info_.extra_json, HasSubstr("\"Auto Exposure\":1"));
}

TEST_F(V4l2CameraTest, AnAutomaticThatStaysOnIsRefusedByName) {
  Plug({});
  V4l2CameraModel::Faults faults;
  faults.stuck[V4L2_CID_AUTO_WHITE_BALANCE] = 1;
  emulated_->model->SetFaults(faults);
  const Error error = OpenError(emulated_->CameraOptions());
  EXPECT_EQ(error.kind, ErrorKind::kConfig);
  EXPECT_THAT(error.message, HasSubstr("V4L2 camera: /dev/video2: control \"White Balance, "
                                       "Automatic\" (0x0098090c): 1: stays so, expected 0"));
}

TEST_F(V4l2CameraTest, ACameraWithoutManualExposureIsRefused) {
  V4l2ModelOptions options;
  options.has_manual_mode = false;
  Plug(options);
  EXPECT_THAT(OpenError(emulated_->CameraOptions()).message, HasSubstr("has no manual mode"));
}

TEST_F(V4l2CameraTest, ExposureInLinesMakesRoomInTheBlankingFirst) {
  V4l2ModelOptions options;
  options.driver = "imx999";
  options.in_lines = true;
  options.formats = {V4L2_PIX_FMT_SRGGB10};
  options.stamp_flags = V4L2_BUF_FLAG_TIMESTAMP_MONOTONIC | V4L2_BUF_FLAG_TSTAMP_SRC_EOF;
  Plug(options, BayerOrder::kRggb);
  v4l2::V4l2CameraOptions wanted = emulated_->CameraOptions();
  wanted.coding = v4l2::Coding::kAuto;
  wanted.gain_unity = V4l2CameraModel::kUnityGain;
  Begin(wanted);
  EXPECT_EQ(info_.description.bits, 10);
  EXPECT_EQ(info_.description.bayer, "RGGB");
  EXPECT_EQ(info_.proof, ExposureProof::kLatency);
  const double line = 48.0 / 2'400'000.0;  // 32 columns and 16 of blanking
  EXPECT_NEAR(info_.shortest.seconds(), line, 1e-12);
  EXPECT_NEAR(info_.longest.seconds(), (24 + 1000 - 4) * line, 1e-9);
  // 100 lines are more than the 28 that the blanking leaves at first.
  const CameraFrame frame = TakeOne(100 * line, 6.0206);
  ASSERT_TRUE(frame.measured_exposure) << frame.detail;
  EXPECT_NEAR(frame.measured_exposure->time.seconds(), 100 * line, 1e-9);
  EXPECT_NEAR(frame.measured_exposure->gain.value, 6.0206, 0.01);
  EXPECT_EQ(emulated_->model->ControlNow(V4L2_CID_VBLANK), 80);
  ExpectScene(frame, 100 * line, 2.0, 1023.0);
  const CameraFrame shorter = TakeOne(3 * line);
  ExpectScene(shorter, 3 * line, 1.0, 1023.0);
}

TEST_F(V4l2CameraTest, ADamagedOrShortBufferIsDeliveredAndMarked) {
  Plug({});
  Begin();
  TakeOne(0.001);
  V4l2CameraModel::Faults faults;
  faults.damaged = 8;
  emulated_->model->SetFaults(faults);
  const CameraFrame damaged = TakeOne(0.001);
  EXPECT_EQ(damaged.status, FrameStatus::kCorrupt);
  EXPECT_THAT(damaged.detail, HasSubstr("damaged"));
  faults = {};
  faults.cut = 8;
  emulated_->model->SetFaults(faults);
  const CameraFrame cut = TakeOne(0.001);
  EXPECT_EQ(cut.status, FrameStatus::kCorrupt);
  EXPECT_THAT(cut.detail, HasSubstr("GREY frame: 384 bytes: expected 768"));
  emulated_->model->SetFaults({});
  while (TakeOne(0.001).status != FrameStatus::kOk && next_ < 30) {
  }
  EXPECT_LT(next_, 30U);
}

TEST_F(V4l2CameraTest, AGapOfTheSequenceIsLostFrames) {
  V4l2ModelOptions options;
  options.first_sequence = 0xFFFFFFF8;  // it wraps while pictures are taken
  Plug(options);
  Begin();
  const std::uint64_t before = TakeOne(0.001).camera_counter;
  V4l2CameraModel::Faults faults;
  faults.lost = 3;
  emulated_->model->SetFaults(faults);
  const CameraFrame frame = TakeOne(0.001);
  EXPECT_EQ(frame.status, FrameStatus::kOk);
  EXPECT_EQ(frame.camera_counter, before + 4);
  EXPECT_EQ(camera_->counts().lost_frames, 3U);
  EXPECT_EQ(TakeOne(0.002).camera_counter, before + 5);
}

TEST_F(V4l2CameraTest, AStaleBufferIsRejectedAndCounted) {
  Plug({});
  Begin();
  TakeOne(0.001);
  V4l2CameraModel::Faults faults;
  faults.stale = 2;
  emulated_->model->SetFaults(faults);
  const HostTime before = SystemClock().Now();
  const CameraFrame frame = TakeOne(0.002);
  EXPECT_EQ(frame.status, FrameStatus::kOk);
  EXPECT_GE(frame.mid_exposure, before);
  ExpectScene(frame, 0.002, 1.0, 255.0);
  EXPECT_EQ(camera_->counts().stale, 2U);
}

TEST_F(V4l2CameraTest, AnExposureThatActsLaterThanMeasuredIsFoundOutAndMeasuredAnew) {
  V4l2ModelOptions options;
  options.latency_frames = 1;
  Plug(options);
  Begin();
  TakeOne(0.0004);
  emulated_->model->SetLatency(6);
  int unproved = 0;
  for (int i = 0; i < 12; ++i) {
    const double seconds = i % 2 == 0 ? 0.003 : 0.0004;
    const CameraFrame frame = TakeOne(seconds);
    if (frame.proof == ExposureProof::kNone) {
      ++unproved;
      EXPECT_FALSE(frame.measured_exposure);
      EXPECT_THAT(frame.detail, HasSubstr("brightness went from"));
    } else if (i >= 6) {
      ExpectScene(frame, seconds, 1.0, 255.0);
    }
  }
  EXPECT_GE(unproved, 2);
  EXPECT_GE(camera_->counts().measurements, 1U);
  EXPECT_EQ(TakeOne(0.001).proof, ExposureProof::kLatency);
}

TEST_F(V4l2CameraTest, InTheDarkTheLatencyIsAssumedAndTheProofIsThatOfReadBack) {
  Plug({});
  V4l2CameraModel::Faults faults;
  faults.dark = true;
  emulated_->model->SetFaults(faults);
  Begin();
  EXPECT_EQ(info_.proof, ExposureProof::kReadback);
  EXPECT_EQ(info_.exposure_latency_frames, v4l2::kMaxLatency - 1);
  EXPECT_THAT(info_.extra_json, HasSubstr("no exposure shows the scene"));
  EXPECT_EQ(TakeOne(0.001).proof, ExposureProof::kReadback);
}

TEST_F(V4l2CameraTest, AControlThatDoesNothingIsNotBelieved) {
  Plug({});
  V4l2CameraModel::Faults faults;
  faults.ignores_exposure = true;
  emulated_->model->SetFaults(faults);
  Begin();
  EXPECT_EQ(info_.proof, ExposureProof::kReadback);
}

TEST_F(V4l2CameraTest, WhatTheCameraMakesOfASettingIsTold) {
  Plug({});
  Begin();
  V4l2CameraModel::Faults faults;
  faults.stuck[V4L2_CID_EXPOSURE_ABSOLUTE] = 20;
  emulated_->model->SetFaults(faults);
  const CameraFrame frame = TakeOne(0.0023);
  EXPECT_THAT(frame.settings_readback_json, HasSubstr("\"clamped\":true"));
  EXPECT_THAT(frame.settings_readback_json, HasSubstr("\"exposure_s\":0.002,"));
  EXPECT_EQ(camera_->counts().clamped, 1U);
}

TEST_F(V4l2CameraTest, AnExposureOutOfRangeIsRefusedWithTheRange) {
  Plug({});
  Begin();
  ExposureRequest request;
  request.exposure.time = ExposureTime::Seconds(0.1);
  const Status status = camera_->Trigger(request);
  ASSERT_FALSE(status);
  EXPECT_EQ(status.error().kind, ErrorKind::kUsage);
  EXPECT_THAT(status.error().message, HasSubstr("0.1 s: expected 0.0001 to 0.004 s"));
}

TEST_F(V4l2CameraTest, ACameraThatSendsNothingLosesTriggersAndThenCountsAsGone) {
  Plug({});
  v4l2::V4l2CameraOptions options = emulated_->CameraOptions();
  options.frame_timeout_s = 0.05;
  Begin(options);
  TakeOne(0.001);
  V4l2CameraModel::Faults faults;
  faults.silent = true;
  emulated_->model->SetFaults(faults);
  for (int i = 0; i < 3; ++i) {
    EXPECT_FALSE(testing::TakePicture(*camera_, 1, 0.002, 0.0, std::chrono::milliseconds(100)));
  }
  const Result<CameraFrame> gone = camera_->Receive(std::chrono::seconds(1));
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().kind, ErrorKind::kUnavailable);
  EXPECT_THAT(gone.error().message, HasSubstr("no frames"));
}

TEST_F(V4l2CameraTest, IsFoundByPathNameAndSerialAmongOthers) {
  const SystemClock clock;
  V4l2ModelOptions other;
  other.path = "/dev/video0";
  other.name = "usb-Other-video-index0";
  other.serial = "0002";
  Plug({});
  const auto second = std::make_shared<V4l2CameraModel>(other, clock);
  for (const char* device : {"/dev/video0", "usb-Other-video-index0", "0002", "",
                             "/dev/v4l/by-id/usb-Other-video-index0", "0003"}) {
    v4l2::V4l2CameraOptions options = emulated_->CameraOptions();
    options.device = device;
    options.latency_frames = 2;
    v4l2::V4l2Camera camera(options, emulators::MakeEmulatedV4l2({emulated_->model, second}));
    const Result<CameraInfo> info = camera.Open();
    if (options.device.empty()) {
      ASSERT_FALSE(info);
      EXPECT_THAT(info.error().message, HasSubstr("2 cameras and none chosen"));
    } else if (options.device == "0003") {
      ASSERT_FALSE(info);
      EXPECT_EQ(info.error().kind, ErrorKind::kUnavailable);
      EXPECT_THAT(info.error().message, HasSubstr("no camera \"0003\" among: /dev/video2 (serial"));
    } else {
      ASSERT_TRUE(info) << info.error().message;
      EXPECT_EQ(info->description.serial, "0002");
    }
  }
}

TEST_F(V4l2CameraTest, WhatItCannotReadIsRefusedWithWhatTheCameraHas) {
  Plug({});
  v4l2::V4l2CameraOptions options = emulated_->CameraOptions();
  options.coding = v4l2::Coding::kMjpeg;
  EXPECT_THAT(OpenError(options).message,
              HasSubstr("format: \"mjpeg\": the camera has YUYV, GREY: expected one that is grey"));
  V4l2ModelOptions planes;
  planes.multi_planar = true;
  Plug(planes);
  EXPECT_THAT(OpenError(emulated_->CameraOptions()).message, HasSubstr("multi-planar"));
}

TEST_F(V4l2CameraTest, ABusWithoutBandwidthIsCalledSo) {
  Plug({});
  V4l2CameraModel::Faults faults;
  faults.refuse[VIDIOC_STREAMON] = -ENOSPC;
  emulated_->model->SetFaults(faults);
  EXPECT_THAT(OpenError(emulated_->CameraOptions()).message, HasSubstr("not enough bandwidth"));
}

TEST_F(V4l2CameraTest, FinishedColourIsThreeChannels) {
  V4l2ModelOptions options;
  options.width = 48;
  Plug(options);
  v4l2::V4l2CameraOptions wanted = emulated_->CameraOptions();
  wanted.layout = Layout::kPanorama;
  wanted.rig_file.clear();
  wanted.coding = v4l2::Coding::kYuyv;
  Begin(wanted);
  EXPECT_EQ(info_.description.width, 48);
  EXPECT_EQ(info_.description.layout, Layout::kPanorama);
  const CameraFrame frame = TakeOne(0.002);
  const auto& image = std::get<Image<std::uint8_t>>(frame.pixels);
  ASSERT_EQ(image.channels(), 3);
  for (int x = 0; x < image.width(); ++x) {
    const double share = std::min(emulated_->model->Brightness(0.002, 1.0, x, 5), 1.0);
    for (int c = 0; c < 3; ++c) EXPECT_NEAR(image.at(x, 5, c), 255 * share, 1.0);
  }
}

}  // namespace
}  // namespace omnihdr::v4l2_camera_test
