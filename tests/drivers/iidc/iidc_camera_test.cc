// The camera over the emulated device: what the compliance suite does not know, faults above all.

#include "drivers/iidc/iidc_camera.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include "tests/drivers/iidc/emulated.h"

namespace omnihdr::iidc_camera_test {
namespace {

using emulators::IidcDevice;
using std::chrono::milliseconds;
using testing::EmulatedIidc;
using ::testing::HasSubstr;
using testing::Take;

const Image<std::uint8_t>& Pixels(const CameraFrame& frame) {
  return std::get<Image<std::uint8_t>>(frame.pixels);
}

class IidcCameraTest : public ::testing::Test {
 protected:
  void Begin(emulators::IidcDeviceOptions options = {}) {
    emulated_ = std::make_unique<EmulatedIidc>(options);
    Begin(emulated_->CameraOptions());
  }
  // Gives a frame up soon.
  void BeginImpatient() {
    emulated_ = std::make_unique<EmulatedIidc>();
    iidc::IidcCameraOptions options = emulated_->CameraOptions();
    options.frame_timeout_s = 0.5;
    Begin(options);
  }
  void Begin(const iidc::IidcCameraOptions& options) {
    camera_ = emulated_->MakeCamera(options);
    const Result<CameraInfo> info = camera_->Open();
    ASSERT_TRUE(info) << info.error().message;
    info_ = info->description;
    const Status started = camera_->Start();
    ASSERT_TRUE(started) << started.error().message;
  }
  CameraFrame TakeOne(double seconds, double gain_db = 0.0) {
    Result<CameraFrame> frame = Take(*camera_, next_++, seconds, gain_db);
    EXPECT_TRUE(frame) << frame.error().message;
    return frame ? std::move(*frame) : CameraFrame{};
  }
  std::unique_ptr<EmulatedIidc> emulated_;
  std::unique_ptr<iidc::IidcCamera> camera_;
  CameraDescription info_;
  std::uint64_t next_ = 0;
};

TEST_F(IidcCameraTest, EveryPixelIsTheScenesAtTheExposureThatTheFrameProves) {
  Begin();
  EXPECT_EQ(info_.model, "Six-Eyed Test Head");
  EXPECT_EQ(info_.serial, "12648430");
  EXPECT_EQ(info_.bayer, "BGGR");
  for (const double seconds : {0.0005, 0.01, 0.06}) {
    for (const double gain : {0.0, 6.0}) {
      const CameraFrame frame = TakeOne(seconds, gain);
      ASSERT_EQ(frame.status, FrameStatus::kOk) << frame.detail;
      EXPECT_EQ(frame.proof, ExposureProof::kEmbedded);
      ASSERT_TRUE(frame.measured_exposure);
      EXPECT_NEAR(frame.measured_exposure->gain.value, gain, 0.03);
      const Image<std::uint8_t>& pixels = Pixels(frame);
      for (int y = 1; y < pixels.height(); y += 7) {
        for (int x = 0; x < pixels.width(); ++x) {
          ASSERT_EQ(pixels.at(x, y),
                    emulated_->device->PixelAt(x, y, frame.measured_exposure->time.seconds(),
                                               frame.measured_exposure->gain.value))
              << x << " " << y;
        }
      }
    }
  }
}

emulators::IidcDeviceOptions OneDeepSensor() {
  emulators::IidcDeviceOptions options;
  options.rows_per_sensor = options.max_height;
  return options;
}

TEST_F(IidcCameraTest, ValuesOfTwelveBitsComeAsSixteenWithTheHighByteFirst) {
  for (const iidc::Coding coding : {iidc::Coding::kRaw16, iidc::Coding::kMono16}) {
    emulated_ = std::make_unique<EmulatedIidc>(OneDeepSensor());
    iidc::IidcCameraOptions options = emulated_->CameraOptions();
    options.coding = coding;
    Begin(options);
    EXPECT_EQ(info_.bits, 16);
    for (const double seconds : {0.0005, 0.03}) {
      const CameraFrame frame = TakeOne(seconds);
      ASSERT_EQ(frame.status, FrameStatus::kOk) << frame.detail;
      ASSERT_TRUE(frame.measured_exposure);
      const double had = frame.measured_exposure->time.seconds();
      EXPECT_NEAR(had / seconds, 1.0, 0.02);
      const auto& pixels = std::get<Image<std::uint16_t>>(frame.pixels);
      for (int y = 1; y < pixels.height(); y += 7) {
        for (int x = 0; x < pixels.width(); ++x) {
          ASSERT_EQ(pixels.at(x, y), emulated_->device->DeepPixelAt(x, y, had, 0.0));
        }
      }
      // Twenty values are covered by the camera's words.
      for (int x = 0; x < 20; ++x) EXPECT_EQ(pixels.at(x, 0), pixels.at(x, 2));
    }
  }
}

TEST_F(IidcCameraTest, ValuesInAnotherOrderOfBytesAreFoundOutAndNotDelivered) {
  emulators::IidcDeviceOptions device = OneDeepSensor();
  device.low_byte_first = true;
  emulated_ = std::make_unique<EmulatedIidc>(device);
  iidc::IidcCameraOptions options = emulated_->CameraOptions();
  options.coding = iidc::Coding::kRaw16;
  Begin(options);
  const CameraFrame frame = TakeOne(0.01);
  EXPECT_EQ(frame.status, FrameStatus::kCorrupt);
  EXPECT_THAT(frame.detail, HasSubstr("expected only the upper 12, as DATA_DEPTH (0x054) says"));
}

TEST_F(IidcCameraTest, SixteenBitsOfAHeadOfSixSensorsAreRefused) {
  emulated_ = std::make_unique<EmulatedIidc>();
  iidc::IidcCameraOptions options = emulated_->CameraOptions();
  options.coding = iidc::Coding::kRaw16;
  const auto camera = emulated_->MakeCamera(options);
  const Result<CameraInfo> info = camera->Open();
  ASSERT_FALSE(info);
  EXPECT_EQ(info.error().kind, ErrorKind::kConfig);
  EXPECT_THAT(info.error().message, HasSubstr("coding: \"raw16\": expected 8 bits"));
}

TEST_F(IidcCameraTest, TheCamerasWordsInTheFirstRowAreCoveredByThePixelsTwoRowsBelow) {
  Begin();
  const CameraFrame frame = TakeOne(0.01);
  for (int x = 0; x < 40; ++x) EXPECT_EQ(Pixels(frame).at(x, 0), Pixels(frame).at(x, 2));
}

TEST_F(IidcCameraTest, AFrameThatHadAnotherExposureSaysWhich) {
  Begin();
  TakeOne(0.02);
  TakeOne(0.01);
  emulated_->device->Set({.wrong_exposures = 1});
  CameraFrame frame = TakeOne(0.01);
  ASSERT_TRUE(frame.measured_exposure);
  EXPECT_NEAR(frame.measured_exposure->time.seconds(), 0.02, 1e-4);
  emulated_->device->Set({.wrong_exposures = 1});
  frame = TakeOne(0.02);  // 0.04 was never set: its register value stands for nothing known
  EXPECT_FALSE(frame.measured_exposure);
  EXPECT_EQ(frame.proof, ExposureProof::kNone);
  EXPECT_THAT(frame.detail, HasSubstr("shutter word"));
}

TEST_F(IidcCameraTest, ALostFrameIsAGapInTheCounterAndTheNextTriggerHasItsOwnFrame) {
  BeginImpatient();
  const std::uint64_t first = TakeOne(0.001).camera_counter;
  emulated_->device->Set({.lose_frames = 1});
  ExposureRequest request;
  request.trigger = TriggerId{next_++};
  request.exposure.time = ExposureTime::Seconds(0.001);
  ASSERT_TRUE(camera_->Trigger(request));
  EXPECT_EQ(camera_->Receive(milliseconds(100)).error().kind, ErrorKind::kTemporary);
  const CameraFrame next = TakeOne(0.004);
  EXPECT_EQ(Value(next.trigger), 2U);
  EXPECT_EQ(next.camera_counter, first + 2);
  EXPECT_NEAR(next.measured_exposure->time.seconds(), 0.004, 1e-4);
  EXPECT_EQ(camera_->counts().lost, 1U);
}

TEST_F(IidcCameraTest, AFrameThatComesAfterItWasGivenUpIsNotTakenForTheNextTriggers) {
  BeginImpatient();
  TakeOne(0.001);
  emulated_->device->Set({.late_frames = 1, .late_s = 0.75});
  ExposureRequest request;
  request.trigger = TriggerId{next_++};
  request.exposure.time = ExposureTime::Seconds(0.001);
  ASSERT_TRUE(camera_->Trigger(request));
  // Given up after 0.5 s; the next one exposes while the late one arrives.
  const CameraFrame next = TakeOne(0.4);
  EXPECT_EQ(Value(next.trigger), 2U);
  EXPECT_NEAR(next.measured_exposure->time.seconds(), 0.4, 2e-3);
  EXPECT_EQ(camera_->counts().strays, 1U);
}

TEST_F(IidcCameraTest, ATornFrameIsDeliveredAsCorruptAndTheNextIsWhole) {
  Begin();
  TakeOne(0.01);
  emulated_->device->Set({.short_frames = 1});
  const CameraFrame torn = TakeOne(0.01);
  EXPECT_EQ(torn.status, FrameStatus::kCorrupt);
  EXPECT_THAT(torn.detail, HasSubstr("700 of"));
  EXPECT_TRUE(torn.measured_exposure);  // its words had arrived
  EXPECT_EQ(Pixels(torn).height(), 288);
  EXPECT_EQ(Pixels(torn).at(0, 200), 0);
  const CameraFrame good = TakeOne(0.01);
  EXPECT_EQ(good.status, FrameStatus::kOk) << good.detail;
  EXPECT_EQ(good.camera_counter, torn.camera_counter + 1);
  EXPECT_EQ(camera_->counts().torn, 1U);
}

TEST_F(IidcCameraTest, WhatItCountsIsToldByTheSameNamesBeforeAndAfterItIsOpen) {
  emulated_ = std::make_unique<EmulatedIidc>();
  const auto closed = emulated_->MakeCamera();
  const std::vector<CameraCounter> before = closed->Counters();
  ASSERT_EQ(before.size(), 6U);
  Begin();
  emulated_->device->Set({.short_frames = 1});
  EXPECT_EQ(TakeOne(0.01).status, FrameStatus::kCorrupt);
  const std::vector<CameraCounter> after = camera_->Counters();
  ASSERT_EQ(after.size(), before.size());
  for (std::size_t i = 0; i < after.size(); ++i) {
    EXPECT_EQ(after[i].name, before[i].name);
    EXPECT_EQ(before[i].value, 0U) << before[i].name;
    EXPECT_EQ(after[i].value, after[i].name == "torn_frames" ? 1U : 0U) << after[i].name;
  }
}

TEST_F(IidcCameraTest, ALossInTheMiddleTearsItsFrameAndNeverShiftsTheNext) {
  Begin();
  TakeOne(0.01);
  emulated_->device->Set({.unmarked_losses = 1});
  EXPECT_EQ(TakeOne(0.01).status, FrameStatus::kCorrupt);
  const CameraFrame good = TakeOne(0.01);
  ASSERT_EQ(good.status, FrameStatus::kOk) << good.detail;
  EXPECT_EQ(Pixels(good).at(33, 100),
            emulated_->device->PixelAt(33, 100, good.measured_exposure->time.seconds(), 0.0));
}

TEST_F(IidcCameraTest, ARegisterThatRefusesCostsOneTriggerAndSaysWhich) {
  Begin();
  TakeOne(0.01);
  emulated_->device->Set({.stall_registers = 1});
  const CameraFrame missed = TakeOne(0.02);
  EXPECT_EQ(missed.status, FrameStatus::kMissedTrigger);
  EXPECT_THAT(missed.detail, HasSubstr("SHUTTER"));
  EXPECT_EQ(TakeOne(0.02).status, FrameStatus::kOk);
}

TEST_F(IidcCameraTest, ACameraThatAnswersNoRegisterAnyMoreIsGivenUp) {
  Begin();
  TakeOne(0.01);
  emulated_->device->Set({.nak_registers = 1'000'000});
  for (int i = 0; i < 2; ++i) EXPECT_EQ(TakeOne(0.02).status, FrameStatus::kMissedTrigger);
  const Result<CameraFrame> last = Take(*camera_, next_++, 0.02);
  ASSERT_FALSE(last);
  EXPECT_EQ(last.error().kind, ErrorKind::kUnavailable);
  EXPECT_THAT(last.error().message, HasSubstr("no answer in"));
  emulated_->device->Set({});
  camera_->Stop();
  camera_->Close();
  ASSERT_TRUE(camera_->Open());
  ASSERT_TRUE(camera_->Start());
  EXPECT_EQ(TakeOne(0.02).status, FrameStatus::kOk);
}

TEST_F(IidcCameraTest, SettlingPicturesAbsorbALatencyAndAreNoGaps) {
  emulators::IidcDeviceOptions device;
  device.exposure_latency = 2;
  emulated_ = std::make_unique<EmulatedIidc>(device);
  iidc::IidcCameraOptions options = emulated_->CameraOptions();
  options.settle_frames = 2;
  Begin(options);
  std::uint64_t counter = 0;
  for (const double seconds : {0.001, 0.004, 0.004, 0.016, 0.001}) {
    const CameraFrame frame = TakeOne(seconds);
    ASSERT_TRUE(frame.measured_exposure) << frame.detail;
    EXPECT_NEAR(frame.measured_exposure->time.seconds() / seconds, 1.0, 0.01);
    EXPECT_TRUE(counter == 0 || frame.camera_counter == counter + 1);
    counter = frame.camera_counter;
  }
}

TEST_F(IidcCameraTest, AnExposureThatWasPreparedIsSetBeforeItsTriggerComes) {
  Begin();
  TakeOne(0.001);
  // Every register access of the next picture but the ready flag and the trigger itself.
  const std::uint64_t before = emulated_->device->requests();
  camera_->Prepare({ExposureTime::Seconds(0.004), GainDb{3.0}});
  const HostTime deadline = emulated_->clock.Now() + std::chrono::seconds(10);
  while (emulated_->device->requests() < before + 8 && emulated_->clock.Now() < deadline) {
    std::this_thread::sleep_for(std::chrono::milliseconds(1));
  }
  std::this_thread::sleep_for(std::chrono::milliseconds(20));
  const std::uint64_t prepared = emulated_->device->requests();
  ASSERT_GE(prepared, before + 8);
  const CameraFrame frame = TakeOne(0.004, 3.0);
  EXPECT_EQ(emulated_->device->requests(), prepared + 2);
  EXPECT_EQ(frame.proof, ExposureProof::kEmbedded);
  ASSERT_TRUE(frame.measured_exposure) << frame.detail;
  EXPECT_NEAR(frame.measured_exposure->time.seconds(), 0.004, 1e-4);
  EXPECT_NEAR(frame.measured_exposure->gain.value, 3.0, 0.05);
  // And a hint that was wrong costs nothing but itself.
  camera_->Prepare({ExposureTime::Seconds(0.016), GainDb{0.0}});
  const CameraFrame other = TakeOne(0.001);
  ASSERT_TRUE(other.measured_exposure) << other.detail;
  EXPECT_NEAR(other.measured_exposure->time.seconds(), 0.001, 1e-4);
}

TEST_F(IidcCameraTest, AnExposureThatWasPreparedSettlesAllTheSame) {
  emulators::IidcDeviceOptions device;
  device.exposure_latency = 2;
  emulated_ = std::make_unique<EmulatedIidc>(device);
  iidc::IidcCameraOptions options = emulated_->CameraOptions();
  options.settle_frames = 2;
  Begin(options);
  for (const double seconds : {0.001, 0.004, 0.016, 0.001}) {
    const std::uint64_t before = emulated_->device->requests();
    camera_->Prepare({ExposureTime::Seconds(seconds), GainDb{0.0}});
    const HostTime deadline = emulated_->clock.Now() + std::chrono::seconds(10);
    while (emulated_->device->requests() < before + 8 && emulated_->clock.Now() < deadline) {
      std::this_thread::sleep_for(std::chrono::milliseconds(1));
    }
    const CameraFrame frame = TakeOne(seconds);
    ASSERT_TRUE(frame.measured_exposure) << frame.detail;
    EXPECT_NEAR(frame.measured_exposure->time.seconds() / seconds, 1.0, 0.01);
  }
}

TEST_F(IidcCameraTest, ALatencyThatNobodyKnowsOfIsSeenInTheProof) {
  emulators::IidcDeviceOptions device;
  device.exposure_latency = 1;
  Begin(device);
  TakeOne(0.001);
  TakeOne(0.001);
  const CameraFrame frame = TakeOne(0.016);
  ASSERT_TRUE(frame.measured_exposure);
  EXPECT_NEAR(frame.measured_exposure->time.seconds(), 0.001, 1e-5);
}

TEST_F(IidcCameraTest, WithoutEmbeddedInformationTheRegistersReadBackAreTheProof) {
  emulators::IidcDeviceOptions device;
  device.embedded_info = false;
  Begin(device);
  const CameraFrame first = TakeOne(0.01);
  EXPECT_EQ(first.proof, ExposureProof::kReadback);
  ASSERT_TRUE(first.measured_exposure);
  EXPECT_NEAR(first.measured_exposure->time.seconds(), 0.01, 1e-4);
  EXPECT_EQ(Pixels(first).at(5, 0),
            emulated_->device->PixelAt(5, 0, first.measured_exposure->time.seconds(), 0.0));
  EXPECT_EQ(TakeOne(0.01).camera_counter, first.camera_counter + 1);
}

TEST_F(IidcCameraTest, SettingsThatShareARegisterValueAreProvedByWhatWasReadBack) {
  emulators::IidcDeviceOptions device;
  device.coarse_words = true;
  Begin(device);
  const double shorter = IidcDevice::ShutterSeconds(1920);
  const double longer = IidcDevice::ShutterSeconds(1930);
  EXPECT_EQ(TakeOne(shorter).proof, ExposureProof::kEmbedded);
  for (const double seconds : {longer, shorter}) {
    const CameraFrame frame = TakeOne(seconds);
    EXPECT_EQ(frame.proof, ExposureProof::kReadback);
    ASSERT_TRUE(frame.measured_exposure);
    EXPECT_NEAR(frame.measured_exposure->time.seconds() / seconds, 1.0, 1e-4);
  }
  // Another setting's value is no proof of this one.
  TakeOne(2 * shorter);
  emulated_->device->Set({.wrong_exposures = 1});
  EXPECT_NEAR(TakeOne(shorter).measured_exposure.value_or(Exposure{}).time.seconds(), 2 * shorter,
              1e-4);
}

TEST_F(IidcCameraTest, CameraTimeGoesOnWhereTheCyclesWrap) {
  emulators::IidcDeviceOptions device;
  device.first_cycle_s = 127;  // wraps within a second
  Begin(device);
  std::optional<CameraTime> before;
  HostTime before_host;
  for (int i = 0; i < 8; ++i) {
    const CameraFrame frame = TakeOne(0.001);
    ASSERT_TRUE(frame.camera_time);
    if (before) {
      const Nanoseconds camera_step = *frame.camera_time - *before;
      const Nanoseconds host_step = frame.mid_exposure - before_host;
      EXPECT_GT(camera_step.count(), 0);
      EXPECT_LT(std::abs((camera_step - host_step).count()), 500'000'000);
    }
    before = frame.camera_time;
    before_host = frame.mid_exposure;
    std::this_thread::sleep_for(milliseconds(200));
  }
}

TEST_F(IidcCameraTest, AfterAPowerCutEverySettingIsMadeAgain) {
  Begin();
  TakeOne(0.01);
  emulated_->device->Unplug();
  EXPECT_EQ(camera_->Receive(milliseconds(5000)).error().kind, ErrorKind::kUnavailable);
  emulated_->device->PlugIn();
  EXPECT_NE(emulated_->device->Register(iidc::kGamma) & iidc::Bit(25), 0U);  // as it comes
  camera_->Stop();
  camera_->Close();
  ASSERT_TRUE(camera_->Open());
  EXPECT_EQ(emulated_->device->Register(iidc::kGamma) & iidc::Bit(25), 0U);
  ASSERT_TRUE(camera_->Start());
  EXPECT_EQ(TakeOne(0.01).status, FrameStatus::kOk);
}

TEST_F(IidcCameraTest, StopLeavesTheCameraQuietAndStartBeginsAgain) {
  Begin();
  for (int i = 0; i < 3; ++i) {
    TakeOne(0.001);
    camera_->Stop();
    EXPECT_EQ(emulated_->device->Register(iidc::kIsoEnable), 0U);
    ASSERT_TRUE(camera_->Start());
    EXPECT_EQ(emulated_->device->Register(iidc::kIsoEnable), iidc::Bit(31));
  }
  EXPECT_EQ(emulated_->device->triggers_refused(), 0);
}

TEST_F(IidcCameraTest, ExposuresAndGainsOutOfRangeAreRefusedWithTheRange) {
  Begin();
  EXPECT_EQ(Take(*camera_, 0, 100.0).error().kind, ErrorKind::kUsage);
  const Result<CameraFrame> gain = Take(*camera_, 0, 0.01, 99.0);
  ASSERT_FALSE(gain);
  EXPECT_THAT(gain.error().message, HasSubstr("expected -6 to 24 dB"));
}

TEST_F(IidcCameraTest, CompressedFramesBringTheSamePicturesWithTheSameProof) {
  emulated_ = std::make_unique<EmulatedIidc>();
  iidc::IidcCameraOptions options = emulated_->CameraOptions();
  options.format = iidc::PictureFormat::kJpeg;
  options.mode = 7;
  Begin(options);
  EXPECT_EQ(emulated_->device->Register(iidc::kJpegControl) & 0x010000FF, 90U);
  const CameraFrame first = TakeOne(0.01);
  ASSERT_EQ(first.status, FrameStatus::kOk) << first.detail;
  EXPECT_EQ(first.proof, ExposureProof::kEmbedded);
  ASSERT_TRUE(first.measured_exposure);
  EXPECT_NEAR(first.measured_exposure->time.seconds(), 0.01, 1e-4);
  EXPECT_TRUE(first.camera_time);
  const Image<std::uint8_t>& pixels = Pixels(first);
  ASSERT_EQ(pixels.height(), 288);
  for (int y = 0; y < pixels.height(); y += 5) {
    for (int x = 0; x < pixels.width(); ++x) {
      ASSERT_NEAR(pixels.at(x, y),
                  emulated_->device->PixelAt(x, y, first.measured_exposure->time.seconds(), 0.0),
                  4);
    }
  }
  emulated_->device->Set({.damaged_headers = 1});
  const CameraFrame damaged = TakeOne(0.01);
  EXPECT_EQ(damaged.status, FrameStatus::kCorrupt);
  EXPECT_THAT(damaged.detail, HasSubstr("fingerprint"));
  EXPECT_EQ(Pixels(damaged).height(), 288);
  emulated_->device->Set({.short_frames = 1, .short_bytes = 9001});
  EXPECT_EQ(TakeOne(0.01).status, FrameStatus::kCorrupt);
  const CameraFrame last = TakeOne(0.02);
  EXPECT_EQ(last.status, FrameStatus::kOk) << last.detail;
  EXPECT_EQ(last.camera_counter, first.camera_counter + 3);
}

TEST(IidcCameraOpen, OfSeveralCamerasTheOneConfiguredIsTaken) {
  EmulatedIidc one;
  emulators::IidcDeviceOptions second;
  second.guid = 0x00B09D0100000007;
  second.serial = 7;
  auto other = std::make_shared<IidcDevice>(second, one.clock);
  const auto open = [&](const std::string& id) {
    iidc::IidcCameraOptions options = one.CameraOptions();
    options.id = id;
    iidc::IidcCamera camera(options, emulators::MakeEmulatedFinder({one.device, other}),
                            EmulatedIidc::Timeouts());
    return camera.Open();
  };
  EXPECT_EQ(open("7")->description.serial, "7");
  EXPECT_EQ(open("00B09D0100000007")->description.serial, "7");
  EXPECT_EQ(open("12648430")->description.serial, "12648430");
  Result<CameraInfo> none = open("");
  ASSERT_FALSE(none);
  EXPECT_EQ(none.error().kind, ErrorKind::kUnavailable);
  EXPECT_THAT(none.error().message, HasSubstr("00b09d0100000007 (serial 7)"));
  none = open("8");
  ASSERT_FALSE(none);
  EXPECT_THAT(none.error().message, HasSubstr("no camera \"8\" among"));
}

TEST(IidcCameraOpen, NothingPluggedInIsUnavailable) {
  EmulatedIidc emulated;
  emulated.device->Unplug();
  auto camera = emulated.MakeCamera();
  const Result<CameraInfo> info = camera->Open();
  ASSERT_FALSE(info);
  EXPECT_EQ(info.error().kind, ErrorKind::kUnavailable);
}

TEST(IidcCameraOpen, ColoursThatAreNotTheRigFilesAreRefused) {
  EmulatedIidc emulated;
  std::ofstream(emulated.rig()) << emulators::EmulatedRig(6, 64, 48, BayerOrder::kRggb);
  const Result<CameraInfo> info = emulated.MakeCamera()->Open();
  ASSERT_FALSE(info);
  EXPECT_EQ(info.error().kind, ErrorKind::kConfig);
  EXPECT_THAT(info.error().message, HasSubstr("BGGR, the rig file says RGGB"));
}

TEST(IidcCameraOpen, AnyRegisterThatFailsIsAnErrorAndNeverMore) {
  // One after the other, each request of Open is refused once.
  EmulatedIidc emulated;
  int failures = 0;
  for (int at = 0;; ++at) {
    emulated.device->Set({.stall_after = at});
    auto camera = emulated.MakeCamera();
    const Result<CameraInfo> info = camera->Open();
    if (!info) ++failures;
    if (emulated.device->stall_pending()) break;
    ASSERT_LT(at, 1000);
  }
  EXPECT_GT(failures, 50);
}

TEST(IidcCameraOpen, OptionsOutOfRangeAreNamed) {
  iidc::IidcCameraOptions options;
  EXPECT_THAT(options.Validate().error().message, HasSubstr("rig"));
  options.rig_file = "x.toml";
  EXPECT_TRUE(options.Validate());
  options.id = "no number";
  EXPECT_THAT(options.Validate().error().message, HasSubstr("id: \"no number\""));
  options.id = "";
  options.trigger_mode = 3;
  EXPECT_THAT(options.Validate().error().message, HasSubstr("trigger_mode: 3"));
}

}  // namespace
}  // namespace omnihdr::iidc_camera_test
