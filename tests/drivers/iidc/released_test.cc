// The camera that is made to expose by pulses of ours on its input.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <chrono>

#include "drivers/iidc/iidc_camera.h"
#include "drivers/iidc/trigger_mode.h"
#include "tests/drivers/iidc/emulated.h"
#include "tests/emulators/pulsed_wire.h"

namespace omnihdr::released_test {
namespace {

using std::chrono::milliseconds;
using testing::EmulatedIidc;
using ::testing::HasSubstr;
using testing::Take;

constexpr std::uint32_t kTriggerMode = 0x830;

class ReleasedIidc : public ::testing::Test {
 protected:
  iidc::IidcCameraOptions Options() {
    iidc::IidcCameraOptions options = emulated_.CameraOptions();
    options.release = wire_;
    return options;
  }
  void Begin() {
    camera_ = emulated_.MakeCamera(Options());
    const Result<CameraInfo> info = camera_->Open();
    ASSERT_TRUE(info) << info.error().message;
    EXPECT_FALSE(info->wired);
    EXPECT_EQ(info->min_trigger_interval, milliseconds(7));
    ASSERT_TRUE(camera_->Start());
  }
  EmulatedIidc emulated_;
  std::shared_ptr<emulators::PulsedWire> wire_ = std::make_shared<emulators::PulsedWire>(
      [this] { emulated_.device->Pulse(); }, milliseconds(7));
  std::unique_ptr<iidc::IidcCamera> camera_;
};

TEST_F(ReleasedIidc, EveryTriggerIsOnePulseWithItsOwnExposureProvedByTheFrame) {
  ASSERT_NO_FATAL_FAILURE(Begin());
  // Hardware trigger, mode 0, input 0.
  EXPECT_EQ(emulated_.device->Register(kTriggerMode) >> 16 & 0xFFU, 0U);
  std::uint64_t number = 0;
  for (const double exposure : {0.001, 0.004, 0.016, 0.001, 0.004, 0.016}) {
    const HostTime before = emulated_.clock.Now();
    const Result<CameraFrame> frame = Take(*camera_, number, exposure);
    ASSERT_TRUE(frame) << frame.error().message;
    ASSERT_EQ(frame->status, FrameStatus::kOk) << frame->detail;
    EXPECT_EQ(frame->trigger, TriggerId{number});
    EXPECT_FALSE(frame->wired);
    EXPECT_EQ(frame->proof, ExposureProof::kEmbedded);
    ASSERT_TRUE(frame->measured_exposure);
    EXPECT_NEAR(frame->measured_exposure->time.seconds() / exposure, 1.0, 0.01);
    EXPECT_EQ(std::get<Image<std::uint8_t>>(frame->pixels).at(20, 100),
              emulated_.device->PixelAt(20, 100, frame->measured_exposure->time.seconds(), 0.0));
    EXPECT_GT(frame->mid_exposure, before);
    ++number;
    EXPECT_EQ(wire_->pulses(), static_cast<int>(number));
    EXPECT_EQ(emulated_.device->trigger_times().size(), number) << "and nothing else exposes";
  }
  EXPECT_EQ(emulated_.device->triggers_refused(), 0);
}

TEST_F(ReleasedIidc, AWireWithoutItsLineIsAMissedTriggerThatSaysSoAndTheCameraStays) {
  ASSERT_NO_FATAL_FAILURE(Begin());
  ASSERT_TRUE(Take(*camera_, 0, 0.001));
  wire_->Cut(true);
  for (std::uint64_t i = 1; i < 6; ++i) {
    const Result<CameraFrame> missed = Take(*camera_, i, 0.001);
    ASSERT_TRUE(missed) << missed.error().message;
    EXPECT_EQ(missed->status, FrameStatus::kMissedTrigger);
    EXPECT_EQ(missed->trigger, TriggerId{i});
    EXPECT_THAT(missed->detail, HasSubstr("the wire is cut"));
  }
  wire_->Cut(false);
  const Result<CameraFrame> frame = Take(*camera_, 6, 0.001);
  ASSERT_TRUE(frame) << frame.error().message;
  EXPECT_EQ(frame->status, FrameStatus::kOk) << frame->detail;
}

TEST_F(ReleasedIidc, APulseThatTheCameraDoesNotSeeEndsInItsDeadlineAndTheNextIsTaken) {
  bool seen = false;
  wire_ = std::make_shared<emulators::PulsedWire>([&] {
    if (seen) emulated_.device->Pulse();
  });
  iidc::IidcCameraOptions options = Options();
  options.frame_timeout_s = 0.1;
  camera_ = emulated_.MakeCamera(options);
  ASSERT_TRUE(camera_->Open());
  ASSERT_TRUE(camera_->Start());
  ExposureRequest request;
  request.exposure = {ExposureTime::Seconds(0.001), GainDb{0.0}};
  request.trigger_time = emulated_.clock.Now();
  ASSERT_TRUE(camera_->Trigger(request));
  EXPECT_EQ(camera_->Receive(milliseconds(300)).error().kind, ErrorKind::kTemporary);
  EXPECT_EQ(camera_->counts().lost, 1U);
  seen = true;
  const Result<CameraFrame> frame = Take(*camera_, 1, 0.001);
  ASSERT_TRUE(frame) << frame.error().message;
  EXPECT_EQ(frame->trigger, TriggerId{1});
  EXPECT_EQ(frame->status, FrameStatus::kOk) << frame->detail;
}

TEST_F(ReleasedIidc, ObservedAndPulsedAtOnceIsRefused) {
  iidc::IidcCameraOptions options = Options();
  options.wired = true;
  EXPECT_THAT(options.Validate().error().message, HasSubstr("either a wire that is observed"));
  options = Options();
  options.trigger_mode = 15;
  EXPECT_THAT(options.Validate().error().message, HasSubstr("trigger_mode: 15"));
}

}  // namespace
}  // namespace omnihdr::released_test
