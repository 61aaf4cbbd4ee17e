// The camera on the trigger's wire: pulses expose, nothing is commanded.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>
#include <cmath>
#include <thread>

#include "drivers/iidc/iidc_camera.h"
#include "drivers/iidc/trigger_mode.h"
#include "tests/drivers/iidc/emulated.h"

namespace omnihdr::wired_test {
namespace {

using std::chrono::milliseconds;
using testing::EmulatedIidc;
using testing::EmulatedRegisters;
using ::testing::HasSubstr;

constexpr Nanoseconds kLong = std::chrono::seconds(5);

double Milliseconds(Nanoseconds time) { return static_cast<double>(time.count()) * 1e-6; }

class WiredIidc : public ::testing::Test {
 protected:
  void Begin(const emulators::IidcDeviceOptions& options = {}) {
    emulated_ = std::make_unique<EmulatedIidc>(options);
    iidc::IidcCameraOptions wired = emulated_->CameraOptions();
    wired.wired = true;
    camera_ = emulated_->MakeCamera(wired);
    const Result<CameraInfo> info = camera_->Open();
    ASSERT_TRUE(info) << info.error().message;
    EXPECT_TRUE(info->wired);
    ASSERT_TRUE(camera_->Start());
  }
  void Prepare(double seconds) {
    camera_->Prepare({ExposureTime::Seconds(seconds), GainDb{0.0}});
    // The wire is set up, and the exposure is in the register.
    const std::uint32_t raw = emulators::IidcDevice::ShutterRaw(seconds);
    for (int i = 0; i < 3000; ++i) {
      const bool wired = (emulated_->device->Register(0x830) >> 21 & 7U) == 0U;
      if (wired && (emulated_->device->Register(0x81C) & 0xFFFU) == raw) return;
      std::this_thread::sleep_for(milliseconds(1));
    }
    ADD_FAILURE() << "not prepared";
  }
  // A pulse; when `told`, its edge is seen as well.
  HostTime Pulse(bool told = true) {
    ExposureRequest edge;
    edge.trigger_time = clock_.Now();
    emulated_->device->Pulse();
    if (told) {
      EXPECT_TRUE(camera_->Trigger(edge));
    }
    return edge.trigger_time;
  }
  const SystemClock clock_{};
  std::unique_ptr<EmulatedIidc> emulated_;
  std::unique_ptr<iidc::IidcCamera> camera_;
};

TEST_F(WiredIidc, EveryPulseIsAFrameThatSaysWhenItBeganAndHadThePreparedExposure) {
  Begin();
  std::optional<std::uint64_t> counter;
  for (const double exposure : {0.001, 0.004, 0.016, 0.001}) {
    Prepare(exposure);
    const HostTime pulse = Pulse();
    const Result<CameraFrame> frame = camera_->Receive(kLong);
    ASSERT_TRUE(frame) << frame.error().message;
    ASSERT_EQ(frame->status, FrameStatus::kOk) << frame->detail;
    EXPECT_EQ(frame->proof, ExposureProof::kEmbedded);
    EXPECT_NEAR(frame->measured_exposure->time.seconds() / exposure, 1.0, 0.01);
    ASSERT_TRUE(frame->wired);
    EXPECT_LE(std::abs(Milliseconds(frame->wired->at - pulse)),
              Milliseconds(frame->wired->error) + 3.0);
    EXPECT_LT(Milliseconds(frame->wired->error), 20.0);
    EXPECT_EQ(std::get<Image<std::uint8_t>>(frame->pixels).at(20, 100),
              emulated_->device->PixelAt(20, 100, frame->measured_exposure->time.seconds(), 0.0));
    if (counter) {
      EXPECT_EQ(frame->camera_counter, *counter + 1) << "nothing thrown away in between";
    }
    counter = frame->camera_counter;
  }
}

TEST_F(WiredIidc, AnEdgeThatIsToldCommandsNothing) {
  Begin();
  Prepare(0.002);
  const std::size_t before = emulated_->device->trigger_times().size();
  ExposureRequest edge;
  edge.trigger_time = clock_.Now();
  ASSERT_TRUE(camera_->Trigger(edge));
  EXPECT_EQ(camera_->Receive(milliseconds(200)).error().kind, ErrorKind::kTemporary);
  EXPECT_EQ(emulated_->device->trigger_times().size(), before);
}

TEST_F(WiredIidc, AFrameWhoseEdgeNobodyToldComesAllTheSame) {
  Begin();
  Prepare(0.002);
  const HostTime pulse = Pulse(false);
  const Result<CameraFrame> frame = camera_->Receive(kLong);
  ASSERT_TRUE(frame) << frame.error().message;
  EXPECT_LE(std::abs(Milliseconds(frame->wired->at - pulse)),
            Milliseconds(frame->wired->error) + 3.0);
}

TEST_F(WiredIidc, AFrameThatIsLostOnItsWayIsAGapOfTheCounter) {
  Begin();
  Prepare(0.002);
  Pulse();
  const Result<CameraFrame> first = camera_->Receive(kLong);
  ASSERT_TRUE(first);
  emulators::IidcDevice::Faults faults;
  faults.lose_frames = 1;
  emulated_->device->Set(faults);
  Pulse();
  std::this_thread::sleep_for(milliseconds(30));
  Pulse();
  const Result<CameraFrame> next = camera_->Receive(kLong);
  ASSERT_TRUE(next) << next.error().message;
  EXPECT_EQ(next->camera_counter, first->camera_counter + 2);
}

TEST_F(WiredIidc, UnpluggedItGoesAway) {
  Begin();
  Prepare(0.002);
  emulated_->device->Unplug();
  EXPECT_EQ(camera_->Receive(kLong).error().kind, ErrorKind::kUnavailable);
  EXPECT_EQ(camera_->Trigger({}).error().kind, ErrorKind::kUnavailable);
}

TEST(WiredTrigger, AnInputOrModeThatTheCameraLacksIsRefusedByRegister) {
  EmulatedRegisters bench;
  EXPECT_TRUE(iidc::SetUpWiredTrigger(bench.registers, 0, 0, false));
  EXPECT_TRUE(iidc::SetUpWiredTrigger(bench.registers, 14, 0, true));
  const Status input = iidc::SetUpWiredTrigger(bench.registers, 0, 2, false);
  ASSERT_FALSE(input);
  EXPECT_THAT(input.error().message, HasSubstr("no trigger input 2"));
  EXPECT_EQ(iidc::SetUpWiredTrigger(bench.registers, 15, 0, false).error().kind,
            ErrorKind::kConfig);
}

TEST(WiredTrigger, ACameraThatWritesNothingIntoItsFramesCannotBeWired) {
  emulators::IidcDeviceOptions options;
  options.embedded_info = false;
  EmulatedIidc emulated(options);
  iidc::IidcCameraOptions wired = emulated.CameraOptions();
  wired.wired = true;
  const Result<CameraInfo> info = emulated.MakeCamera(wired)->Open();
  ASSERT_FALSE(info);
  EXPECT_THAT(info.error().message, HasSubstr("trigger.wired"));
}

}  // namespace
}  // namespace omnihdr::wired_test
