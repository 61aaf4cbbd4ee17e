// One suite for every camera: what core/ports/camera.h promises. tests/kernel runs it on a real
// kernel's cameras, too.

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <chrono>
#include <ostream>
#include <thread>
#include <variant>

#include "tests/compliance/camera_suite.h"

namespace omnihdr::compliance::camera_compliance_test {
namespace {

using std::chrono::milliseconds;

class CameraCompliance : public ::testing::TestWithParam<RigFactory> {
 protected:
  void SetUp() override {
    rig_ = GetParam().make();
    camera_ = rig_.camera.get();
  }
  void OpenAndStart() {
    const Result<CameraInfo> info = camera_->Open();
    ASSERT_TRUE(info) << info.error().message;
    const Status started = camera_->Start();
    ASSERT_TRUE(started) << started.error().message;
  }
  ExposureRequest NextRequest(ExposureTime time) {
    ExposureRequest request;
    request.trigger = TriggerId{next_++};
    request.exposure.time = time;
    request.trigger_time = SystemClock().Now();
    return request;
  }
  // Triggers again and again while the camera is busy, up to the frame timeout.
  Status TriggerWhenReady(const ExposureRequest& request) {
    const HostTime deadline = SystemClock().Now() + rig_.frame_timeout;
    while (true) {
      Status status = camera_->Trigger(request);
      if (status || status.error().kind != ErrorKind::kTemporary ||
          SystemClock().Now() > deadline) {
        return status;
      }
      std::this_thread::sleep_for(milliseconds(1));
    }
  }

  Rig rig_;
  Camera* camera_ = nullptr;
  std::uint64_t next_ = 0;
};

TEST_P(CameraCompliance, OpenTellsASizeTheLimitsAndAResponse) {
  const Result<CameraInfo> info = camera_->Open();
  ASSERT_TRUE(info) << info.error().message;
  EXPECT_GT(info->description.width, 0);
  EXPECT_GT(info->description.height, 0);
  EXPECT_GE(info->description.bits, 8);
  EXPECT_FALSE(info->description.model.empty());
  EXPECT_TRUE(info->shortest.IsValid());
  EXPECT_LT(info->shortest, info->longest);
  EXPECT_GE(info->min_trigger_interval.count(), 0);
  EXPECT_NE(info->proof, ExposureProof::kNone);
  EXPECT_NEAR(info->response.ExposureFromValue(1, 128.0), 1.0, 1e-6);
}

TEST_P(CameraCompliance, EveryCallBeforeOpenIsAnErrorOrHarmless) {
  EXPECT_FALSE(camera_->Start());
  EXPECT_FALSE(camera_->Trigger(NextRequest(rig_.ladder.front())));
  EXPECT_FALSE(camera_->Receive(milliseconds(1)));
  camera_->Stop();
  camera_->Close();
  camera_->Close();
}

TEST_P(CameraCompliance, ATriggerBeforeStartIsAnError) {
  ASSERT_TRUE(camera_->Open());
  EXPECT_FALSE(camera_->Trigger(NextRequest(rig_.ladder.front())));
  ASSERT_TRUE(camera_->Start());
  camera_->Stop();
  EXPECT_FALSE(camera_->Trigger(NextRequest(rig_.ladder.front())));
  EXPECT_FALSE(camera_->Receive(milliseconds(1)));
}

TEST_P(CameraCompliance, OpenStartStopAndCloseMayBeRepeatedAnyNumberOfTimes) {
  for (int round = 0; round < 50; ++round) {
    ASSERT_TRUE(camera_->Open()) << round;
    ASSERT_TRUE(camera_->Open()) << round;
    ASSERT_TRUE(camera_->Start()) << round;
    ASSERT_TRUE(camera_->Start()) << round;
    ASSERT_TRUE(TriggerWhenReady(NextRequest(rig_.ladder.front()))) << round;
    if (round % 2 == 0) {
      const Result<CameraFrame> frame = camera_->Receive(rig_.frame_timeout);
      ASSERT_TRUE(frame) << round << ": " << frame.error().message;
      EXPECT_EQ(Value(frame->trigger), next_ - 1);
    }
    camera_->Stop();
    camera_->Stop();
    camera_->Close();
    camera_->Close();
  }
}

TEST_P(CameraCompliance, AfterStopAndStartNoFrameOfBeforeArrives) {
  OpenAndStart();
  ASSERT_TRUE(TriggerWhenReady(NextRequest(rig_.ladder.front())));
  camera_->Stop();
  ASSERT_TRUE(camera_->Start());
  ASSERT_TRUE(TriggerWhenReady(NextRequest(rig_.ladder.front())));
  const Result<CameraFrame> frame = camera_->Receive(rig_.frame_timeout);
  ASSERT_TRUE(frame) << frame.error().message;
  EXPECT_EQ(Value(frame->trigger), 1U);
}

TEST_P(CameraCompliance, EveryStepOfTheExposureLadderComesWithItsProof) {
  OpenAndStart();
  for (int round = 0; round < 2; ++round) {
    for (const ExposureTime time : rig_.ladder) {
      const ExposureRequest request = NextRequest(time);
      ASSERT_TRUE(TriggerWhenReady(request));
      const Result<CameraFrame> frame = camera_->Receive(rig_.frame_timeout);
      ASSERT_TRUE(frame) << frame.error().message;
      ASSERT_EQ(frame->status, FrameStatus::kOk) << frame->detail;
      EXPECT_NE(frame->proof, ExposureProof::kNone);
      ASSERT_TRUE(frame->measured_exposure);
      const Exposure expected = rig_.fixed_exposure
                                    ? rig_.fixed_exposure(Value(request.trigger)).value()
                                    : request.exposure;
      EXPECT_NEAR(frame->measured_exposure->time.seconds() / expected.time.seconds(), 1.0, 0.02);
    }
  }
}

TEST_P(CameraCompliance, FramesHaveTheSizeAndDepthThatOpenTold) {
  const Result<CameraInfo> info = camera_->Open();
  ASSERT_TRUE(info);
  ASSERT_TRUE(camera_->Start());
  ASSERT_TRUE(TriggerWhenReady(NextRequest(rig_.ladder.back())));
  const Result<CameraFrame> frame = camera_->Receive(rig_.frame_timeout);
  ASSERT_TRUE(frame) << frame.error().message;
  if (info->description.layout == Layout::kRig) {
    // Without its calibration a rig's session cannot be used.
    ASSERT_FALSE(info->files.empty());
    EXPECT_EQ(info->files.front().name, "rig.toml");
  }
  EXPECT_EQ(frame->pixels.index(), info->description.bits > 8 ? 1U : 0U);
  std::visit(
      [&](const auto& image) {
        EXPECT_EQ(image.width(), info->description.width);
        EXPECT_EQ(image.height(), info->description.height);
        EXPECT_EQ(image.channels(), info->description.layout == Layout::kRig ? 1 : 3);
      },
      frame->pixels);
}

TEST_P(CameraCompliance, EveryAcceptedTriggerGivesExactlyOneFrameInOrderAndRefusalsAreTemporary) {
  OpenAndStart();
  const std::uint64_t want = std::min<std::uint64_t>(30, rig_.triggers);
  std::vector<std::uint64_t> accepted;
  std::vector<std::uint64_t> received;
  std::vector<std::uint64_t> counters;
  int refused = 0;
  // Triggers without regard for the camera's pace, from a thread of its own as the daemon does.
  std::thread trigger([&] {
    const HostTime deadline = SystemClock().Now() + rig_.frame_timeout * 4;
    while (accepted.size() < want && SystemClock().Now() < deadline) {
      const ExposureRequest request = NextRequest(rig_.ladder[next_ % rig_.ladder.size()]);
      const Status status = camera_->Trigger(request);
      if (status) {
        accepted.push_back(Value(request.trigger));
      } else {
        EXPECT_EQ(status.error().kind, ErrorKind::kTemporary) << status.error().message;
        ++refused;
        --next_;
        std::this_thread::sleep_for(milliseconds(1));
      }
    }
  });
  while (received.size() < want) {
    const Result<CameraFrame> frame = camera_->Receive(rig_.frame_timeout);
    if (!frame) {
      ADD_FAILURE() << frame.error().message;
      break;
    }
    received.push_back(Value(frame->trigger));
    counters.push_back(frame->camera_counter);
  }
  trigger.join();
  EXPECT_EQ(received, accepted);
  for (std::size_t i = 1; i < counters.size(); ++i) EXPECT_EQ(counters[i], counters[i - 1] + 1);
  const Result<CameraFrame> surplus = camera_->Receive(milliseconds(50));
  ASSERT_FALSE(surplus);
  EXPECT_EQ(surplus.error().kind, ErrorKind::kTemporary);
}

TEST_P(CameraCompliance, TriggersThatNobodyReceivesEndInBusyAndNotInMemory) {
  OpenAndStart();
  int accepted = 0;
  for (int i = 0; i < 100; ++i) {
    const Status status = camera_->Trigger(NextRequest(rig_.ladder.front()));
    if (status) {
      ++accepted;
    } else {
      EXPECT_EQ(status.error().kind, ErrorKind::kTemporary) << status.error().message;
      --next_;
    }
    std::this_thread::sleep_for(milliseconds(1));
  }
  EXPECT_GT(accepted, 0);
  EXPECT_LE(accepted, 16);
  for (int i = 0; i < accepted; ++i) {
    const Result<CameraFrame> frame = camera_->Receive(rig_.frame_timeout);
    ASSERT_TRUE(frame) << frame.error().message;
    EXPECT_EQ(Value(frame->trigger), static_cast<std::uint64_t>(i));
  }
}

TEST_P(CameraCompliance, ReceiveReturnsWithinItsTimeout) {
  OpenAndStart();
  for (const int ms : {0, 20, 60}) {
    const HostTime before = SystemClock().Now();
    const Result<CameraFrame> frame = camera_->Receive(milliseconds(ms));
    const Nanoseconds took = SystemClock().Now() - before;
    ASSERT_FALSE(frame);
    EXPECT_EQ(frame.error().kind, ErrorKind::kTemporary);
    EXPECT_GE(took, milliseconds(ms) - milliseconds(1));
    // The machine may be busy with other tests.
    EXPECT_LT(took, milliseconds(ms) + milliseconds(500));
  }
}

TEST_P(CameraCompliance, TheMiddleOfTheExposureLiesBetweenTriggerAndArrival) {
  OpenAndStart();
  const ExposureRequest request = NextRequest(rig_.ladder.front());
  ASSERT_TRUE(TriggerWhenReady(request));
  const Result<CameraFrame> frame = camera_->Receive(rig_.frame_timeout);
  ASSERT_TRUE(frame) << frame.error().message;
  EXPECT_GE(frame->mid_exposure, request.trigger_time);
  EXPECT_LE(frame->mid_exposure, SystemClock().Now() + milliseconds(100));
}

TEST_P(CameraCompliance, AnUnpluggedCameraSaysSoAndWorksAgainAfterReopening) {
  if (!rig_.unplug) GTEST_SKIP() << "this camera cannot be unplugged";
  OpenAndStart();
  for (int round = 0; round < 3; ++round) {
    ASSERT_TRUE(TriggerWhenReady(NextRequest(rig_.ladder.front())));
    rig_.unplug();
    Result<CameraFrame> gone = camera_->Receive(rig_.frame_timeout);
    // Of a head of several cameras some may have given their pictures before they went.
    if (gone && gone->status != FrameStatus::kOk) gone = camera_->Receive(rig_.frame_timeout);
    ASSERT_FALSE(gone) << ToString(gone->status) << ": " << gone->detail;
    EXPECT_EQ(gone.error().kind, ErrorKind::kUnavailable);
    const Status trigger = camera_->Trigger(NextRequest(rig_.ladder.front()));
    ASSERT_FALSE(trigger);
    EXPECT_EQ(trigger.error().kind, ErrorKind::kUnavailable);
    camera_->Stop();
    camera_->Close();
    const Result<CameraInfo> absent = camera_->Open();
    ASSERT_FALSE(absent);
    EXPECT_EQ(absent.error().kind, ErrorKind::kUnavailable);
    rig_.plug_in();
    OpenAndStart();
    ASSERT_TRUE(TriggerWhenReady(NextRequest(rig_.ladder.front())));
    const Result<CameraFrame> frame = camera_->Receive(rig_.frame_timeout);
    ASSERT_TRUE(frame) << frame.error().message;
    EXPECT_EQ(Value(frame->trigger), next_ - 1);
  }
}

INSTANTIATE_TEST_SUITE_P(AllCameras, CameraCompliance, ::testing::ValuesIn(AllRigs()),
                         [](const auto& parameter) { return parameter.param.name; });

}  // namespace
}  // namespace omnihdr::compliance::camera_compliance_test
