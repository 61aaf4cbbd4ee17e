// One suite for every camera: what core/ports/camera.h promises.

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <ostream>
#include <thread>

#include "drivers/all_drivers.h"
#include "drivers/iidc/firewire_link.h"
#include "drivers/sim/simulation.h"
#include "drivers/sim/world.h"
#include "drivers/v4l2/rig_camera.h"
#include "tests/compliance/camera_suite.h"
#include "tests/emulators/iidc_firewire.h"
#include "tests/emulators/iidc_link.h"
#include "tests/emulators/umockdev_usb.h"
#include "tests/emulators/v4l2_camera_model.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::compliance::camera_compliance_test {
namespace {

using std::chrono::milliseconds;

constexpr int kWidth = 128;

std::shared_ptr<const sim::World> SharedWorld() {
  static const auto world = sim::World::Create(sim::SceneKind::kTunnel, 1);
  return world;
}

Rig MakeSimRig(Layout layout) {
  sim::SimCameraOptions options;
  options.simulation.layout = layout;
  options.simulation.sensor_width = 64;
  options.simulation.scene = sim::SceneKind::kTunnel;
  options.simulation.width = kWidth;
  options.simulation.samples = 1;
  options.readout_s = 0.002;
  auto camera = std::make_unique<sim::SimCamera>(options, SharedWorld());
  Rig rig;
  sim::SimCamera* raw = camera.get();
  rig.unplug = [raw] { raw->Unplug(); };
  rig.plug_in = [raw] { raw->PlugIn(); };
  rig.camera = std::move(camera);
  for (const double t : {0.0001, 0.001, 0.004, 0.016, 0.05}) {
    rig.ladder.push_back(ExposureTime::Seconds(t));
  }
  return rig;
}

// A recorded session, made once for the process and removed at its end.
class RecordedSession {
 public:
  static constexpr int kFrames = 120;
  static const RecordedSession& Get(Layout layout) {
    static const RecordedSession panoramas(Layout::kPanorama);
    static const RecordedSession stacks(Layout::kRig);
    return layout == Layout::kRig ? stacks : panoramas;
  }
  const std::filesystem::path& path() const { return path_; }
  ~RecordedSession() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  RecordedSession(const RecordedSession&) = delete;
  RecordedSession& operator=(const RecordedSession&) = delete;

 private:
  explicit RecordedSession(Layout layout)
      : path_(std::filesystem::temp_directory_path() /
              fmt::format("omnihdr-compliance-{}-{}", ToString(layout), getpid())) {
    sim::SimulateOptions options;
    options.simulation.layout = layout;
    options.simulation.sensor_width = 64;
    options.simulation.scene = sim::SceneKind::kTunnel;
    options.simulation.width = kWidth;
    options.simulation.samples = 1;
    options.positions = kFrames / 3;
    options.bracket.frames_per_position = 3;
    const Status made = sim::WriteSimulatedSession(path_, options, {});
    if (!made) ADD_FAILURE() << made.error().message;
  }
  std::filesystem::path path_;
};

Rig MakeReplayRig(Layout layout) {
  ReplayOptions options;
  options.session = RecordedSession::Get(layout).path();
  options.interval_s = 0.0;
  auto camera = std::make_unique<ReplayCamera>(options);
  const ReplayCamera* raw = camera.get();
  Rig rig;
  rig.camera = std::move(camera);
  rig.ladder = {ExposureTime::Seconds(0.0005), ExposureTime::Seconds(0.002)};
  rig.triggers = RecordedSession::kFrames;
  rig.fixed_exposure = [raw](std::uint64_t trigger) -> std::optional<Exposure> {
    const auto line = raw->Line(trigger);
    if (!line) return std::nullopt;
    return line->exposure;
  };
  return rig;
}

// An emulated IIDC camera: in this process, or as a USB device that the real libusb talks to.
enum class Carrier { kInProcess, kUsb, kFirewire };

struct EmulatedCamera {
  explicit EmulatedCamera(Carrier carrier)
      : device(std::make_shared<emulators::IidcDevice>(MakeOptions(carrier), clock)) {
    const emulators::IidcDeviceOptions& options = device->options();
    std::ofstream(rig()) << emulators::EmulatedRig(6, options.max_width, options.rows_per_sensor,
                                                   options.bayer);
  }
  static emulators::IidcDeviceOptions MakeOptions(Carrier carrier) {
    emulators::IidcDeviceOptions options;
    options.readout_s = 0.004;
    if (carrier == Carrier::kFirewire) {
      options.link_packet_bytes = emulators::IidcFirewire::kFrameEnds;
    }
    return options;
  }
  std::filesystem::path rig() const { return folder.path() / "head.toml"; }

  const SystemClock clock;
  const testing::TemporaryDirectory folder;
  std::shared_ptr<emulators::IidcDevice> device;
  std::unique_ptr<emulators::UmockdevUsb> usb;
  emulators::IidcFirewire firewire{device};
};

Rig MakeIidcRig(Carrier carrier, iidc::PictureFormat format = iidc::PictureFormat::kRaw) {
  auto emulated = std::make_shared<EmulatedCamera>(carrier);
  iidc::IidcCameraOptions options;
  options.rig_file = emulated->rig();
  options.format = format;
  if (format == iidc::PictureFormat::kJpeg) options.mode = 7;
  Rig rig;
  rig.surroundings = emulated;
  if (carrier == Carrier::kUsb) {
    emulated->usb = std::make_unique<emulators::UmockdevUsb>(emulated->device);
    rig.camera = MakeCamera(options).value();
    rig.unplug = [emulated] { emulated->usb->Unplug(); };
    rig.plug_in = [emulated] { emulated->usb->PlugIn(); };
  } else {
    rig.camera = std::make_unique<iidc::IidcCamera>(
        options, carrier == Carrier::kFirewire
                     ? iidc::MakeFirewireFinder(emulated->firewire.MakeBus())
                     : emulators::MakeEmulatedFinder({emulated->device}));
    rig.unplug = [emulated] { emulated->device->Unplug(); };
    rig.plug_in = [emulated] { emulated->device->PlugIn(); };
  }
  for (const double t : {0.0001, 0.001, 0.004, 0.016, 0.05}) {
    rig.ladder.push_back(ExposureTime::Seconds(t));
  }
  return rig;
}

// An emulated camera below the kernel's ioctls: of class UVC, or a raw sensor.
struct EmulatedV4l2Camera {
  EmulatedV4l2Camera(const emulators::V4l2ModelOptions& options, BayerOrder bayer)
      : model(std::make_shared<emulators::V4l2CameraModel>(options, clock)) {
    std::ofstream(rig()) << emulators::EmulatedRig(1, options.width, options.height, bayer);
  }
  std::filesystem::path rig() const { return folder.path() / "head.toml"; }

  const SystemClock clock;
  const testing::TemporaryDirectory folder;
  std::shared_ptr<emulators::V4l2CameraModel> model;
};

Rig MakeV4l2Rig(bool raw_sensor) {
  emulators::V4l2ModelOptions model;
  model.in_lines = raw_sensor;
  if (raw_sensor) {
    model.driver = "imx999";
    model.formats = {V4L2_PIX_FMT_SBGGR12};
  }
  auto emulated = std::make_shared<EmulatedV4l2Camera>(
      model, raw_sensor ? BayerOrder::kBggr : BayerOrder::kNone);
  v4l2::V4l2CameraOptions options;
  options.rig_file = emulated->rig();
  if (!raw_sensor) options.coding = v4l2::Coding::kGrey;
  Rig rig;
  rig.surroundings = emulated;
  rig.camera =
      std::make_unique<v4l2::V4l2Camera>(options, emulators::MakeEmulatedV4l2({emulated->model}));
  rig.unplug = [emulated] { emulated->model->Unplug(); };
  rig.plug_in = [emulated] { emulated->model->PlugIn(); };
  for (const double t : {0.0002, 0.0005, 0.001, 0.002, 0.0039}) {
    rig.ladder.push_back(ExposureTime::Seconds(t));
  }
  return rig;
}

// Three emulated cameras as one rig, each at its own pace.
struct EmulatedV4l2Head {
  EmulatedV4l2Head() {
    emulators::V4l2ModelOptions options;
    for (int i = 0; i < 3; ++i) {
      options.path = fmt::format("/dev/video{}", 2 * i);
      options.serial = fmt::format("S{}", i);
      options.interval_s = 0.004 + 0.001 * i;
      models.push_back(std::make_shared<emulators::V4l2CameraModel>(options, clock));
    }
    std::ofstream(rig()) << emulators::EmulatedRig(3, options.width, options.height,
                                                   BayerOrder::kNone);
  }
  std::filesystem::path rig() const { return folder.path() / "head.toml"; }

  const SystemClock clock;
  const testing::TemporaryDirectory folder;
  std::vector<std::shared_ptr<emulators::V4l2CameraModel>> models;
};

Rig MakeV4l2Head() {
  auto emulated = std::make_shared<EmulatedV4l2Head>();
  v4l2::V4l2CameraOptions options;
  options.rig_file = emulated->rig();
  options.coding = v4l2::Coding::kGrey;
  options.devices = {"S0", "S1", "S2"};
  Rig rig;
  rig.surroundings = emulated;
  rig.camera = std::make_unique<v4l2::V4l2RigCamera>(
      options, [emulated] { return emulators::MakeEmulatedV4l2(emulated->models); });
  rig.unplug = [emulated] {
    for (const auto& model : emulated->models) model->Unplug();
  };
  rig.plug_in = [emulated] {
    for (const auto& model : emulated->models) model->PlugIn();
  };
  for (const double t : {0.0002, 0.0005, 0.001, 0.002, 0.0039}) {
    rig.ladder.push_back(ExposureTime::Seconds(t));
  }
  return rig;
}

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

}  // namespace

std::vector<RigFactory> AllRigs() {
  return {
      {"sim", [] { return MakeSimRig(Layout::kPanorama); }},
      {"sim_rig", [] { return MakeSimRig(Layout::kRig); }},
      {"replay", [] { return MakeReplayRig(Layout::kPanorama); }},
      {"replay_rig", [] { return MakeReplayRig(Layout::kRig); }},
      {"iidc", [] { return MakeIidcRig(Carrier::kUsb); }},
      {"iidc_in_process", [] { return MakeIidcRig(Carrier::kInProcess); }},
      {"iidc_firewire", [] { return MakeIidcRig(Carrier::kFirewire); }},
      {"iidc_jpeg", [] { return MakeIidcRig(Carrier::kInProcess, iidc::PictureFormat::kJpeg); }},
      {"v4l2", [] { return MakeV4l2Rig(false); }},
      {"v4l2_raw_sensor", [] { return MakeV4l2Rig(true); }},
      {"v4l2_head", [] { return MakeV4l2Head(); }}};
}

TEST(CameraComplianceSuite, CoversEveryDriverOfTheBuild) {
  std::vector<std::string> covered;
  for (const RigFactory& rig : AllRigs()) covered.push_back(rig.name);
  for (const CameraDriverEntry& driver : CameraDrivers()) {
    EXPECT_THAT(covered, ::testing::Contains(driver.name));
  }
}

INSTANTIATE_TEST_SUITE_P(AllCameras, CameraCompliance, ::testing::ValuesIn(AllRigs()),
                         [](const auto& parameter) { return parameter.param.name; });

}  // namespace omnihdr::compliance::camera_compliance_test
