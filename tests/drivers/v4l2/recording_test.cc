// What passes between driver and kernel recorded, and played back to the same driver without the
// camera.

#include "drivers/v4l2/recording.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <limits>
#include <random>
#include <string>
#include <thread>
#include <variant>
#include <vector>

#include "core/base/file.h"
#include "drivers/v4l2/kernel_call.h"
#include "tests/drivers/v4l2/emulated.h"

namespace omnihdr::recording_test {
namespace {

using emulators::V4l2CameraModel;
using emulators::V4l2ModelOptions;
using testing::EmulatedV4l2;
using ::testing::HasSubstr;

class V4l2Recording : public ::testing::Test {
 protected:
  std::filesystem::path file() const { return emulated_.folder.path() / "camera.v4l2"; }
  std::unique_ptr<Camera> RecordingCamera(std::uint64_t max_bytes = std::uint64_t{1} << 30) {
    auto system = v4l2::MakeRecordingSystem(emulators::MakeEmulatedV4l2({emulated_.model}),
                                            {.file = file(), .max_bytes = max_bytes});
    EXPECT_TRUE(system) << system.error().message;
    return std::make_unique<v4l2::V4l2Camera>(options_, std::move(*system));
  }
  std::unique_ptr<Camera> ReplayedCamera(const std::vector<std::byte>& recording) {
    auto camera = v4l2::MakeReplayedCamera(options_, recording);
    EXPECT_TRUE(camera) << camera.error().message;
    return std::move(*camera);
  }
  std::unique_ptr<Camera> ReplayedCamera() { return ReplayedCamera(ReadFile(file()).value()); }

  // What somebody does with a camera: opens it, takes pictures one by one, two at a time, and after
  // a pause in which the next was prepared, and stops it in between.
  struct Seen {
    std::string info;
    std::vector<CameraFrame> frames;
    std::vector<CameraCounter> counters;
  };
  static Seen Use(Camera& camera) {
    Seen seen;
    const Result<CameraInfo> info = camera.Open();
    EXPECT_TRUE(info) << info.error().message;
    if (!info) return seen;
    seen.info = info->extra_json;
    std::uint64_t number = 0;
    for (const auto& pause : {std::chrono::milliseconds(0), std::chrono::milliseconds(30)}) {
      if (const Status started = camera.Start(); !started) {
        ADD_FAILURE() << started.error().message;
        return seen;
      }
      for (const double seconds : {0.0004, 0.003, 0.003, 0.001}) {
        camera.Prepare({ExposureTime::Seconds(seconds), GainDb{}});
        std::this_thread::sleep_for(pause);
        Result<CameraFrame> frame = testing::TakePicture(camera, number++, seconds);
        EXPECT_TRUE(frame) << frame.error().message;
        if (frame) seen.frames.push_back(std::move(*frame));
      }
      TakeTwoAtATime(camera, number, seen);
      camera.Stop();
    }
    camera.Close();
    seen.counters = camera.Counters();
    return seen;
  }
  static void TakeTwoAtATime(Camera& camera, std::uint64_t& number, Seen& seen) {
    const SystemClock clock;
    const HostTime deadline = clock.Now() + std::chrono::seconds(20);
    const std::size_t want = seen.frames.size() + 6;
    for (std::uint64_t given = 0; seen.frames.size() < want && clock.Now() < deadline;) {
      ExposureRequest request;
      request.trigger = TriggerId{number};
      request.exposure.time = ExposureTime::Seconds(given % 2 == 0 ? 0.0004 : 0.003);
      request.trigger_time = clock.Now();
      if (given < 6 && camera.Trigger(request)) {
        ++given;
        ++number;
      }
      Result<CameraFrame> frame = camera.Receive(std::chrono::milliseconds(1));
      if (frame) {
        seen.frames.push_back(std::move(*frame));
      } else if (frame.error().kind != ErrorKind::kTemporary) {
        ADD_FAILURE() << frame.error().message;
        return;
      }
    }
    EXPECT_EQ(seen.frames.size(), want);
  }
  static void ExpectTheSame(const Seen& played, const Seen& recorded) {
    EXPECT_EQ(played.info, recorded.info);
    ASSERT_EQ(played.frames.size(), recorded.frames.size());
    for (std::size_t i = 0; i < played.frames.size(); ++i) {
      const CameraFrame& a = played.frames[i];
      const CameraFrame& b = recorded.frames[i];
      EXPECT_EQ(a.trigger, b.trigger) << i;
      EXPECT_EQ(a.status, b.status) << i;
      EXPECT_EQ(a.detail, b.detail) << i;
      EXPECT_EQ(a.proof, b.proof) << i;
      EXPECT_EQ(a.measured_exposure, b.measured_exposure) << i;
      EXPECT_EQ(a.camera_counter, b.camera_counter) << i;
      EXPECT_EQ(a.settings_readback_json, b.settings_readback_json) << i;
      const auto& pixels = std::get<Image<std::uint8_t>>(a.pixels);
      const auto& expected = std::get<Image<std::uint8_t>>(b.pixels);
      EXPECT_TRUE(std::equal(pixels.values().begin(), pixels.values().end(),
                             expected.values().begin(), expected.values().end()))
          << i;
    }
    ASSERT_EQ(played.counters.size(), recorded.counters.size());
    for (std::size_t i = 0; i < played.counters.size(); ++i) {
      EXPECT_EQ(played.counters[i].value, recorded.counters[i].value) << played.counters[i].name;
    }
  }

  EmulatedV4l2 emulated_{V4l2ModelOptions{.latency_frames = 3}};
  v4l2::V4l2CameraOptions options_ = [this] {
    v4l2::V4l2CameraOptions options = emulated_.CameraOptions();
    options.frame_timeout_s = 3.0;  // the machine may be busy
    return options;
  }();
};

TEST_F(V4l2Recording, PlayedBackItGivesTheSameFramesWithTheSameProofAndCounts) {
  const Seen recorded = Use(*RecordingCamera());
  ASSERT_EQ(recorded.frames.size(), 20U);
  EXPECT_THAT(recorded.info, HasSubstr("\"latency_measured\":true"));
  emulated_.model->Unplug();  // nothing of it is asked any more
  for (int round = 0; round < 2; ++round) {
    ExpectTheSame(Use(*ReplayedCamera()), recorded);
  }
}

TEST_F(V4l2Recording, FaultsArePlayedBackAsTheyWere) {
  const auto with_faults = [this](Camera& camera, bool live) {
    Seen seen;
    EXPECT_TRUE(camera.Open());
    EXPECT_TRUE(camera.Start());
    for (std::uint64_t i = 0; i < 12; ++i) {
      if (live) {
        V4l2CameraModel::Faults faults;
        faults.damaged = i == 2 ? 1 : 0;
        faults.lost = i == 4 ? 3 : 0;
        faults.stale = i == 6 ? 1 : 0;
        if (i == 8) faults.refuse[VIDIOC_S_EXT_CTRLS] = -EILSEQ;
        emulated_.model->SetFaults(faults);
      }
      Result<CameraFrame> frame = testing::TakePicture(camera, i,
                                                       i % 3 == 0   ? 0.0004
                                                       : i % 3 == 1 ? 0.003
                                                                    : 0.001);
      EXPECT_TRUE(frame) << frame.error().message;
      if (frame) seen.frames.push_back(std::move(*frame));
    }
    camera.Stop();
    seen.counters = camera.Counters();
    return seen;
  };
  // A refused trigger has no pixels.
  const auto without_missed = [](Seen seen) {
    EXPECT_EQ(std::erase_if(seen.frames,
                            [](const CameraFrame& frame) {
                              return frame.status == FrameStatus::kMissedTrigger;
                            }),
              1U);
    return seen;
  };
  const Seen recorded = without_missed(with_faults(*RecordingCamera(), true));
  ExpectTheSame(without_missed(with_faults(*ReplayedCamera(), false)), recorded);
}

TEST_F(V4l2Recording, ACameraThatIsUnpluggedIsGoneInThePlayingToo) {
  {
    const auto camera = RecordingCamera();
    ASSERT_TRUE(camera->Open());
    ASSERT_TRUE(camera->Start());
    ASSERT_TRUE(testing::TakePicture(*camera, 0, 0.002));
    emulated_.model->Unplug();
    EXPECT_EQ(camera->Receive(std::chrono::seconds(5)).error().kind, ErrorKind::kUnavailable);
  }
  const auto camera = ReplayedCamera();
  ASSERT_TRUE(camera->Open());
  ASSERT_TRUE(camera->Start());
  ASSERT_TRUE(testing::TakePicture(*camera, 0, 0.002));
  EXPECT_EQ(camera->Receive(std::chrono::seconds(5)).error().kind, ErrorKind::kUnavailable);
}

TEST_F(V4l2Recording, WhoAsksSomethingElseIsToldWhat) {
  Use(*RecordingCamera());
  // Another exposure.
  auto camera = ReplayedCamera();
  ASSERT_TRUE(camera->Open());
  ASSERT_TRUE(camera->Start());
  const auto frame = testing::TakePicture(*camera, 0, 0.002);
  ASSERT_FALSE(frame);
  EXPECT_NE(frame.error().kind, ErrorKind::kTemporary);
  EXPECT_THAT(frame.error().message, HasSubstr("recorded was \"trigger with 0.0004 s, 0 dB\", "
                                               "asked is \"trigger with 0.002 s, 0 dB\""));
  // Another setting.
  options_.white_balance = 5000;
  camera = ReplayedCamera();
  const auto info = camera->Open();
  ASSERT_FALSE(info);
  EXPECT_THAT(info.error().message, HasSubstr("recorded was \"VIDIOC_"));
  EXPECT_THAT(info.error().message, HasSubstr("asked is \"VIDIOC_S_EXT_CTRLS 0x0098091a=5000\""));
  // More than there is.
  options_.white_balance = 0;
  camera = ReplayedCamera();
  Use(*camera);
  const auto again = camera->Open();
  ASSERT_FALSE(again);
  EXPECT_EQ(again.error().kind, ErrorKind::kUnavailable);
  EXPECT_THAT(again.error().message, HasSubstr("the recording has ended"));
}

TEST_F(V4l2Recording, CutOffAnywhereItIsPlayedAsFarAsItGoes) {
  options_.latency_frames = 4;  // a short recording
  const auto take = [](Camera& camera) {
    Result<CameraFrame> frame = Fail(ErrorKind::kUnavailable, "not open");
    if (camera.Open() && camera.Start()) frame = testing::TakePicture(camera, 0, 0.001);
    camera.Stop();
    return frame;
  };
  ASSERT_TRUE(take(*RecordingCamera()));
  const std::vector<std::byte> whole = ReadFile(file()).value();
  for (std::size_t length = 0; length < whole.size(); length += 1 + whole.size() / 100) {
    const std::vector<std::byte> cut(whole.begin(),
                                     whole.begin() + static_cast<std::ptrdiff_t>(length));
    if (length < v4l2::kKernelCallMagic.size()) {
      const auto camera = v4l2::MakeReplayedCamera(options_, cut);
      ASSERT_FALSE(camera);
      EXPECT_EQ(camera.error().kind, ErrorKind::kData);
      EXPECT_EQ(camera.error().message, "no recording of V4L2 calls");
      continue;
    }
    const auto frame = take(*ReplayedCamera(cut));
    if (!frame) {
      EXPECT_EQ(frame.error().kind, ErrorKind::kUnavailable) << frame.error().message;
    }
  }
}

TEST_F(V4l2Recording, ItStopsGrowingAtItsLimitAndTheCameraGoesOn) {
  EXPECT_EQ(Use(*RecordingCamera(20'000)).frames.size(), 20U);
  EXPECT_LE(std::filesystem::file_size(file()), 20'000U);
  EXPECT_TRUE(v4l2::MakeReplayedCamera(options_, file()));
}

TEST_F(V4l2Recording, AFileThatCannotBeMadeIsSaid) {
  const auto system =
      v4l2::MakeRecordingSystem(emulators::MakeEmulatedV4l2({emulated_.model}),
                                {.file = emulated_.folder.path() / "none" / "camera.v4l2"});
  ASSERT_FALSE(system);
  EXPECT_EQ(system.error().kind, ErrorKind::kCannotCreate);
}

TEST(V4l2KernelCall, ComesBackAsItWasAndAnyBytesAreACallOrNot) {
  v4l2::KernelCall call;
  call.kind = v4l2::KernelCall::Kind::kIoctl;
  call.device = 3;
  call.request = VIDIOC_S_EXT_CTRLS;
  call.at = HostTime::FromNanoseconds(123456789);
  call.result = -EINVAL;
  call.argument.resize(sizeof(v4l2_ext_controls));
  call.argument_after.resize(sizeof(v4l2_ext_controls));
  v4l2_ext_control control{};
  control.id = V4L2_CID_GAIN;
  control.value = 17;
  const auto bytes_of_control = std::as_bytes(std::span(&control, 1));
  call.controls.assign(bytes_of_control.begin(), bytes_of_control.end());
  call.controls_after = call.controls;
  EXPECT_EQ(call.Request(), "VIDIOC_S_EXT_CTRLS 0x00980913=17");
  const std::vector<std::byte> bytes = v4l2::EncodeCall(call);
  const auto again = v4l2::DecodeCall(bytes);
  ASSERT_TRUE(again);
  EXPECT_EQ(v4l2::EncodeCall(*again), bytes);
  EXPECT_TRUE(again->AsksTheSame(call));
  for (std::size_t length = 0; length < bytes.size(); ++length) {
    EXPECT_FALSE(v4l2::DecodeCall(std::span(bytes).first(length))) << length;
  }
  // No error of a kernel's.
  v4l2::KernelCall odd = call;
  odd.result = std::numeric_limits<std::int32_t>::min();
  EXPECT_FALSE(v4l2::DecodeCall(v4l2::EncodeCall(odd)));
  std::mt19937 random(1);
  for (int round = 0; round < 20000; ++round) {
    std::vector<std::byte> damaged = bytes;
    for (int i = 0; i < 3; ++i)
      damaged[random() % damaged.size()] = static_cast<std::byte>(random());
    const auto decoded = v4l2::DecodeCall(damaged);
    if (decoded) {
      EXPECT_FALSE(decoded->Request().empty());
    }
  }
}

}  // namespace
}  // namespace omnihdr::recording_test
