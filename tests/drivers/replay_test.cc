#include "drivers/replay/replay.h"

#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <cstring>
#include <filesystem>
#include <fstream>

#include "core/base/file.h"
#include "core/image/image_io.h"
#include "core/session/journal.h"
#include "core/session/session_reader.h"
#include "drivers/all_drivers.h"
#include "drivers/sim/simulation.h"

namespace omnihdr::replay_test {
namespace {

namespace fs = std::filesystem;
constexpr std::chrono::seconds kTimeout(5);

class Replay : public testing::Test {
 protected:
  void SetUp() override {
    root_ =
        fs::temp_directory_path() / ("omnihdr-replay-" + std::to_string(getpid()) + "-" +
                                     testing::UnitTest::GetInstance()->current_test_info()->name());
    fs::remove_all(root_);
    options_.session = root_ / "session";
    options_.interval_s = 0.0;
    sim::SimulateOptions simulate;
    simulate.simulation.scene = sim::SceneKind::kTunnel;
    simulate.simulation.width = 128;
    simulate.simulation.samples = 1;
    simulate.positions = 3;
    simulate.spacing_m = 0.37;
    simulate.bracket.exposures = {ExposureTime::Seconds(1.0 / 3000.0),
                                  ExposureTime::Seconds(0.0047)};
    const Status made = sim::WriteSimulatedSession(options_.session, simulate, {});
    ASSERT_TRUE(made) << made.error().message;
  }
  void TearDown() override { fs::remove_all(root_); }

  Result<CameraFrame> Take(ReplayCamera& camera, std::uint64_t trigger) {
    ExposureRequest request;
    request.trigger = TriggerId{trigger};
    request.exposure.time = ExposureTime::Seconds(0.001);
    request.trigger_time = SystemClock().Now();
    OMNIHDR_TRY(camera.Trigger(request));
    return camera.Receive(kTimeout);
  }

  fs::path root_;
  ReplayOptions options_;
};

TEST_F(Replay, PixelsExposureOdometerAndTruthComeBackExactly) {
  const auto camera = std::make_shared<ReplayCamera>(options_);
  const Result<CameraInfo> info = camera->Open();
  ASSERT_TRUE(info) << info.error().message;
  ASSERT_TRUE(camera->Start());
  const Result<SessionContents> original = ReadSession(options_.session);
  ASSERT_TRUE(original);
  EXPECT_EQ(info->description.width, original->info.camera.width);
  EXPECT_EQ(info->extra_json, original->info.extra_json);
  ReplayTrigger trigger(camera, {});
  ASSERT_TRUE(trigger.Start());
  std::uint64_t number = 0;
  for (const FrameRecord& line : original->journal.frames) {
    const auto event = *trigger.Poll();
    ASSERT_TRUE(event);
    EXPECT_EQ(event->odometer_m, line.odometer_m);
    const Result<CameraFrame> frame = Take(*camera, number++);
    ASSERT_TRUE(frame) << frame.error().message;
    EXPECT_EQ(frame->measured_exposure, line.exposure);
    EXPECT_EQ(frame->proof, ExposureProof::kFile);
    EXPECT_EQ(frame->truth_json, line.truth_json);
    ASSERT_TRUE(frame->recorded);
    EXPECT_EQ(frame->recorded->utc, line.utc);
    EXPECT_EQ(frame->recorded->heading_deg, line.heading_deg);
    const Result<DecodedImage> picture = ReadImage(options_.session / line.file);
    ASSERT_TRUE(picture);
    const auto& a = std::get<0>(picture->pixels);
    const auto& b = std::get<0>(frame->pixels);
    ASSERT_EQ(a.size(), b.size());
    EXPECT_EQ(std::memcmp(a.data(), b.data(), a.size()), 0);
  }
  EXPECT_TRUE(trigger.exhausted());
  EXPECT_FALSE(trigger.Poll()->has_value());
  EXPECT_EQ(Take(*camera, number).error().kind, ErrorKind::kNoInput);
}

TEST_F(Replay, LinesWithoutPixelsKeepTheirStatusAndDamagedFilesAreCorrupt) {
  Result<SessionWriter> writer = SessionWriter::Resume(options_.session);
  ASSERT_TRUE(writer) << writer.error().message;
  FrameRecord missed;
  missed.frame = FrameId{3};
  missed.position = PositionId{3};
  missed.exposure.time = ExposureTime::Seconds(0.001);
  missed.status = FrameStatus::kMissedTrigger;
  missed.detail = "the camera was busy";
  ASSERT_TRUE(writer->Append(missed, {}));
  fs::resize_file(options_.session / "raw/000001.png",
                  fs::file_size(options_.session / "raw/000001.png") / 2);
  fs::remove(options_.session / "raw/000002.png");

  ReplayCamera camera(options_);
  ASSERT_TRUE(camera.Open());
  ASSERT_TRUE(camera.Start());
  EXPECT_EQ(Take(camera, 0)->status, FrameStatus::kOk);
  EXPECT_EQ(Take(camera, 1)->status, FrameStatus::kCorrupt);
  const Result<CameraFrame> absent = Take(camera, 2);
  EXPECT_EQ(absent->status, FrameStatus::kCorrupt);
  EXPECT_NE(absent->detail.find("000002.png"), std::string::npos);
  const Result<CameraFrame> line = Take(camera, 3);
  EXPECT_EQ(line->status, FrameStatus::kMissedTrigger);
  EXPECT_EQ(line->detail, "the camera was busy");
}

TEST_F(Replay, TheTriggerWaitsForTheCameraForRoomAndForItsInterval) {
  options_.interval_s = 0.05;
  const auto camera = std::make_shared<ReplayCamera>(options_);
  bool room = false;
  ReplayTriggerOptions trigger_options;
  trigger_options.room = [&room] { return room; };
  ReplayTrigger trigger(camera, trigger_options);
  ASSERT_TRUE(trigger.Start());
  EXPECT_FALSE(trigger.Poll()->has_value()) << "the camera is not open";
  EXPECT_FALSE(trigger.exhausted());
  ASSERT_TRUE(camera->Open());
  ASSERT_TRUE(camera->Start());
  EXPECT_FALSE(trigger.Poll()->has_value()) << "there is no room";
  room = true;
  const auto first = *trigger.Poll();
  ASSERT_TRUE(first);
  ASSERT_TRUE(Take(*camera, 0));
  EXPECT_FALSE(trigger.Poll()->has_value()) << "the interval has not passed";
  EXPECT_GE(*trigger.NextDeadline() - first->time, std::chrono::milliseconds(50));
}

TEST_F(Replay, ItGoesOnInTheMiddleOfASession) {
  const auto camera = std::make_shared<ReplayCamera>(options_);
  ASSERT_TRUE(camera->Open());
  ASSERT_TRUE(camera->Start());
  ReplayTriggerOptions trigger_options;
  trigger_options.first = 2;
  ReplayTrigger trigger(camera, trigger_options);
  ASSERT_TRUE(trigger.Start());
  const auto event = *trigger.Poll();
  ASSERT_TRUE(event);
  EXPECT_NEAR(*event->odometer_m, 2 * 0.37, 1e-12);
  EXPECT_TRUE(trigger.exhausted());
}

TEST_F(Replay, ASessionThatIsNotThereIsAnUnavailableCamera) {
  options_.session = root_ / "elsewhere";
  ReplayCamera camera(options_);
  const Result<CameraInfo> info = camera.Open();
  ASSERT_FALSE(info);
  EXPECT_EQ(info.error().kind, ErrorKind::kUnavailable);
  EXPECT_NE(info.error().message.find("elsewhere"), std::string::npos);
}

TEST(AllDrivers, EveryListedDriverHasOptionsAndAnUnknownNameIsAnErrorWithTheList) {
  for (const CameraDriverEntry& driver : CameraDrivers()) {
    EXPECT_TRUE(DefaultCameraOptions(driver.name)) << driver.name;
  }
  const auto unknown = DefaultCameraOptions("theta");
  ASSERT_FALSE(unknown);
  EXPECT_NE(unknown.error().message.find("sim, replay"), std::string::npos);
}

TEST(AllDrivers, ACameraIsMadeFromItsOptionsOrTheOptionIsNamed) {
  EXPECT_TRUE(MakeCamera(sim::SimCameraOptions{}));
  const auto bad = MakeCamera(ReplayOptions{});
  ASSERT_FALSE(bad);
  EXPECT_EQ(bad.error().kind, ErrorKind::kConfig);
  EXPECT_NE(bad.error().message.find("session"), std::string::npos);
}

}  // namespace
}  // namespace omnihdr::replay_test
