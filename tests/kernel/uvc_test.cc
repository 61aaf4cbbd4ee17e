// The V4L2 driver with an emulated camera of the video class that hangs on the kernel's USB,
// through the kernel's own uvcvideo.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>
#include <memory>
#include <nlohmann/json.hpp>
#include <thread>
#include <variant>

#include "drivers/v4l2/kernel_device.h"
#include "drivers/v4l2/v4l2_camera.h"
#include "tests/emulators/iidc_link.h"
#include "tests/emulators/uvc_usb_function.h"
#include "tests/emulators/vhci_usb.h"
#include "tests/integration/programs.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::uvc_test {
namespace {

using emulators::UvcDevice;
using emulators::UvcDeviceOptions;
using integration::Eventually;
using std::chrono::seconds;
using ::testing::HasSubstr;

class CameraOfTheKernelsUvcvideo : public ::testing::Test {
 protected:
  void PlugIn(const UvcDeviceOptions& options = {}) {
    device_ = std::make_shared<UvcDevice>(options, clock_);
    plug_ =
        std::make_unique<emulators::VhciUsb>(std::make_shared<emulators::UvcUsbFunction>(device_));
    std::ofstream(rig()) << emulators::EmulatedRig(1, options.width, options.height,
                                                   BayerOrder::kNone);
  }
  std::string rig() const { return (folder_.path() / "head.toml").string(); }
  // With patience: the machine is emulated, too.
  v4l2::V4l2CameraOptions Options() const {
    v4l2::V4l2CameraOptions options;
    options.device = device_->options().serial;
    options.rig_file = rig();
    options.coding = v4l2::Coding::kGrey;
    options.gain_unity = static_cast<int>(device_->options().unity_gain);
    options.frame_timeout_s = 10.0;
    return options;
  }
  // The latency given, so that opening takes no measurement.
  v4l2::V4l2CameraOptions Quick() const {
    v4l2::V4l2CameraOptions options = Options();
    options.latency_frames = device_->options().latency_frames + 2;
    return options;
  }
  static void SetNoDrop(bool on) {
    std::ofstream("/sys/module/uvcvideo/parameters/nodrop") << (on ? '1' : '0') << std::flush;
  }
  std::unique_ptr<v4l2::V4l2Camera> OpenCamera() { return OpenCamera(Options()); }
  // Waits until the kernel has found out.
  std::unique_ptr<v4l2::V4l2Camera> OpenCamera(const v4l2::V4l2CameraOptions& options) {
    auto camera = std::make_unique<v4l2::V4l2Camera>(options, v4l2::MakeKernelSystem());
    EXPECT_TRUE(Opens(*camera));
    return camera;
  }
  bool Opens(Camera& camera) {
    std::string why;
    const bool opens = Eventually([&] {
      Result<CameraInfo> opened = camera.Open();
      if (!opened) {
        why = opened.error().message;
        return false;
      }
      info_ = *std::move(opened);
      return true;
    });
    EXPECT_TRUE(opens) << why;
    return opens;
  }
  Result<CameraFrame> Take(Camera& camera, std::uint64_t number, double exposure_s,
                           double gain_db = 0.0, seconds patience = seconds(20)) const {
    ExposureRequest request;
    request.trigger = TriggerId{number};
    request.exposure = {ExposureTime::Seconds(exposure_s), GainDb{gain_db}};
    Status triggered;
    Eventually([&] {
      request.trigger_time = clock_.Now();
      triggered = camera.Trigger(request);
      return triggered || triggered.error().kind != ErrorKind::kTemporary;
    });
    if (!triggered) return Forward(std::move(triggered).error());
    return camera.Receive(patience);
  }
  // That it was measured: a setting that comes while a frame is exposed acts so many frames later.
  void ExpectLatency(int frames) const {
    const auto told = nlohmann::json::parse(info_.extra_json)["v4l2"];
    EXPECT_EQ(told["latency_measured"], true) << told;
    EXPECT_GE(told["latency_frames"].get<int>(), frames + 1);
    EXPECT_LE(told["latency_frames"].get<int>(), frames + 2);
  }
  // The exposure that a frame says it has, and pixels of that exposure.
  void ExpectFrame(const Result<CameraFrame>& frame, double exposure_s, ExposureProof proof,
                   double gain = 1.0) const {
    ASSERT_TRUE(frame) << frame.error().message;
    ASSERT_EQ(frame->status, FrameStatus::kOk) << frame->detail;
    EXPECT_EQ(frame->proof, proof) << frame->detail;
    ASSERT_TRUE(frame->measured_exposure);
    EXPECT_NEAR(frame->measured_exposure->time.seconds(), exposure_s, 1e-9);
    const auto& pixels = std::get<Image<std::uint8_t>>(frame->pixels);
    for (int y = 0; y < pixels.height(); y += 7) {
      for (const int x : {0, 20, pixels.width() - 1}) {
        EXPECT_EQ(pixels.at(x, y), device_->PixelAt(x, y, exposure_s, gain)) << x << ' ' << y;
      }
    }
  }

  const SystemClock clock_;
  const testing::TemporaryDirectory folder_;
  std::shared_ptr<UvcDevice> device_;
  std::unique_ptr<emulators::VhciUsb> plug_;
  CameraInfo info_;
};

TEST_F(CameraOfTheKernelsUvcvideo, ItIsFoundByItsSerialNumberAndNothingAutomaticIsLeftOn) {
  PlugIn();
  const auto camera = OpenCamera(Quick());
  EXPECT_EQ(info_.description.serial, "UVC-0001");
  EXPECT_THAT(info_.description.model, HasSubstr("Test UVC Camera"));
  EXPECT_EQ(info_.description.width, 64);
  EXPECT_EQ(info_.description.height, 48);
  EXPECT_NEAR(info_.shortest.seconds(), 1e-4, 1e-9);
  EXPECT_NEAR(info_.longest.seconds(), 0.05, 1e-9);
  // Two nodes of one device: the second is uvcvideo's of metadata, and no camera.
  const auto nodes = v4l2::MakeKernelSystem()->List();
  ASSERT_EQ(nodes.size(), 2U);
  EXPECT_EQ(nodes[1].serial, "UVC-0001");
  // The mode of the exposure before anything else.
  ASSERT_FALSE(device_->writes().empty());
  EXPECT_EQ(device_->writes().front(),
            std::pair(UvcDevice::kCameraTerminal, std::uint8_t{UvcDevice::kAutoMode}));
  EXPECT_EQ(device_->ControlNow(UvcDevice::kCameraTerminal, UvcDevice::kAutoMode), 1U);
  for (const std::uint8_t control :
       {UvcDevice::kBacklight, UvcDevice::kPowerLine, UvcDevice::kAutoTemperature}) {
    EXPECT_EQ(device_->ControlNow(UvcDevice::kProcessingUnit, control), 0U) << int{control};
  }
  EXPECT_EQ(device_->ControlNow(UvcDevice::kCameraTerminal, UvcDevice::kAutoPriority), 0U);
}

TEST_F(CameraOfTheKernelsUvcvideo, TheLatencyMeasuredIsTheCamerasAndTheFrameInProgress) {
  PlugIn({.latency_frames = 4});
  const auto camera = OpenCamera();
  ExpectLatency(4);
}

TEST_F(CameraOfTheKernelsUvcvideo, EveryStepOfALadderComesWithItsProofAndItsPixels) {
  PlugIn();
  const auto camera = OpenCamera();
  ExpectLatency(2);
  ASSERT_TRUE(camera->Start());
  const double ladder[] = {0.002, 0.008, 0.032};
  std::uint64_t first = 0;
  for (std::uint64_t i = 0; i < 9; ++i) {
    const auto frame = Take(*camera, i, ladder[i % 3], i < 6 ? 0.0 : 6.0206);
    ExpectFrame(frame, ladder[i % 3], ExposureProof::kLatency, i < 6 ? 1.0 : 2.0);
    if (i == 0) first = frame->camera_counter;
    EXPECT_EQ(frame->camera_counter, first + i);
  }
  EXPECT_EQ(camera->counts().contradictions, 0U);
  EXPECT_EQ(camera->counts().clamped, 0U);
}

TEST_F(CameraOfTheKernelsUvcvideo, WhatTheCameraMakesOfAnExposureIsReadBackAndTold) {
  PlugIn({.coarse_units = 7});
  const auto camera = OpenCamera(Quick());
  ASSERT_TRUE(camera->Start());
  const auto frame = Take(*camera, 0, 0.01);
  ExpectFrame(frame, 0.0098, ExposureProof::kReadback);
  EXPECT_THAT(frame->settings_readback_json, HasSubstr("\"clamped\":true"));
  EXPECT_EQ(camera->counts().clamped, 1U);
}

// uvcvideo reads a control only once, unless the camera says that it may change by itself: the
// read-back is then what was written. drivers/v4l2/README.md says what follows from it.
TEST_F(CameraOfTheKernelsUvcvideo, ACameraThatDoesNotSayThatItsControlsChangeIsTakenAtItsWord) {
  PlugIn({.coarse_units = 7, .controls_autoupdate = false});
  const auto camera = OpenCamera(Quick());
  ASSERT_TRUE(camera->Start());
  const auto frame = Take(*camera, 0, 0.01);
  ASSERT_TRUE(frame) << frame.error().message;
  EXPECT_NEAR(frame->measured_exposure->time.seconds(), 0.01, 1e-9);
  EXPECT_EQ(std::get<Image<std::uint8_t>>(frame->pixels).at(20, 20),
            device_->PixelAt(20, 20, 0.0098));
  EXPECT_EQ(camera->counts().clamped, 0U);
}

TEST_F(CameraOfTheKernelsUvcvideo, FramesThatTheKernelThrowsAwayAreGapsInTheCounter) {
  PlugIn();
  const auto camera = OpenCamera(Quick());
  ASSERT_TRUE(camera->Start());
  const auto before = Take(*camera, 0, 0.008);
  ExpectFrame(before, 0.008, ExposureProof::kReadback);
  std::uint64_t gaps = 0;
  for (int UvcDevice::Faults::*const fault :
       {&UvcDevice::Faults::torn, &UvcDevice::Faults::marked, &UvcDevice::Faults::overlong}) {
    UvcDevice::Faults faults;
    faults.*fault = 1;
    device_->Set(faults);
    ++gaps;
    ASSERT_TRUE(Eventually([&] { return camera->counts().lost_frames >= gaps; }, seconds(10)));
  }
  const auto after = Take(*camera, 1, 0.002);
  ExpectFrame(after, 0.002, ExposureProof::kReadback);
  EXPECT_EQ(camera->counts().lost_frames, gaps);
  EXPECT_EQ(after->camera_counter, before->camera_counter + gaps + 1);
  EXPECT_EQ(camera->counts().damaged, 0U);
}

// As with the module's parameter nodrop = 1.
TEST_F(CameraOfTheKernelsUvcvideo, FramesThatTheKernelCallsDamagedAreDeliveredAsCorrupt) {
  SetNoDrop(true);
  PlugIn();
  const auto camera = OpenCamera(Quick());
  ASSERT_TRUE(camera->Start());
  UvcDevice::Faults faults;
  faults.torn = 100;
  device_->Set(faults);
  const auto torn = Take(*camera, 0, 0.008);
  device_->Set({});
  SetNoDrop(false);
  ASSERT_TRUE(torn) << torn.error().message;
  EXPECT_EQ(torn->status, FrameStatus::kCorrupt);
  EXPECT_THAT(torn->detail, HasSubstr("damaged"));
  EXPECT_GT(camera->counts().damaged, 0U);
  ExpectFrame(Take(*camera, 1, 0.002), 0.002, ExposureProof::kReadback);
}

TEST_F(CameraOfTheKernelsUvcvideo, AControlThatTheCameraRefusesIsNamedAndTheNextTriggerIsAnswered) {
  PlugIn();
  const auto camera = OpenCamera(Quick());
  ASSERT_TRUE(camera->Start());
  UvcDevice::Faults faults;
  faults.stall_controls = 1;
  device_->Set(faults);
  const auto refused = Take(*camera, 0, 0.008);
  ASSERT_TRUE(refused) << refused.error().message;
  EXPECT_EQ(refused->status, FrameStatus::kMissedTrigger);
  EXPECT_THAT(refused->detail, HasSubstr("control \"Gain\""));  // uvcvideo writes it first
  EXPECT_THAT(refused->detail, HasSubstr("in no state for it"));
  ExpectFrame(Take(*camera, 1, 0.008), 0.008, ExposureProof::kReadback);
}

TEST_F(CameraOfTheKernelsUvcvideo, AStreamThatEndsIsBegunAnew) {
  PlugIn();
  auto options = Quick();
  options.frame_timeout_s = 1.0;
  const auto camera = OpenCamera(options);
  ASSERT_TRUE(camera->Start());
  ExpectFrame(Take(*camera, 0, 0.008), 0.008, ExposureProof::kReadback);
  UvcDevice::Faults faults;
  faults.stall_stream = 5;  // as many transfers as uvcvideo has; none is sent again
  device_->Set(faults);
  const auto lost = Take(*camera, 1, 0.002, 0.0, seconds(4));
  ASSERT_FALSE(lost);
  EXPECT_EQ(lost.error().kind, ErrorKind::kTemporary) << lost.error().message;
  EXPECT_EQ(camera->counts().lost_triggers, 1U);
  ExpectFrame(Take(*camera, 2, 0.008), 0.008, ExposureProof::kReadback);
}

TEST_F(CameraOfTheKernelsUvcvideo, UnpluggedInAnExposureItIsGoneAndWorksAgainWhenItReturns) {
  PlugIn();
  const auto camera = OpenCamera(Quick());
  ASSERT_TRUE(camera->Start());
  ExpectFrame(Take(*camera, 0, 0.008), 0.008, ExposureProof::kReadback);
  std::thread unplug([&] {
    EXPECT_TRUE(Eventually([&] {
      return device_->ControlNow(UvcDevice::kCameraTerminal, UvcDevice::kExposure) == 20;
    }));
    plug_->Unplug();
  });
  const auto gone = Take(*camera, 1, 0.002);
  unplug.join();
  ASSERT_FALSE(gone);
  EXPECT_EQ(gone.error().kind, ErrorKind::kUnavailable) << gone.error().message;
  const auto absent = camera->Open();
  ASSERT_FALSE(absent);
  EXPECT_EQ(absent.error().kind, ErrorKind::kUnavailable) << absent.error().message;
  plug_->PlugIn();
  ASSERT_TRUE(Opens(*camera));
  ASSERT_TRUE(camera->Start());
  ExpectFrame(Take(*camera, 2, 0.004), 0.004, ExposureProof::kReadback);
}

}  // namespace
}  // namespace omnihdr::uvc_test
