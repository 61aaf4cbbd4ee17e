#include "tests/unit/daemon/app/app_fixture.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/resource.h>

#include <condition_variable>
#include <deque>
#include <filesystem>
#include <fstream>
#include <map>
#include <thread>

#include "core/session/session_reader.h"
#include "daemon/api/client.h"
#include "daemon/logging.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::app_test {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;
using ::testing::HasSubstr;
using testing_app::FakeVehicle;
using testing_app::ToldSource;

class AppTest : public testing_app::AppFixture {};

TEST_F(AppTest, ALimitedSeriesEndsTheSessionAndTheDaemonServesOn) {
  config_.trigger.limit = 4;
  config_.recorder.queue_frames = 8;
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger(4);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["session"]["ended"] == true; }));
  const nlohmann::json status = Client().Get("/v1/status").value();
  EXPECT_EQ(status["camera"]["counters"]["stale_frames"], 3);
  EXPECT_EQ(status["state"], "idle");
  EXPECT_EQ(status["views"]["finished"], 4);
  EXPECT_EQ(status["views"]["backlog"], 0);
  EXPECT_TRUE(SessionEnded(session()));
  EXPECT_FALSE(Client().Post("/v1/trigger"));
}

TEST_F(AppTest, StoppingLeavesTheSessionOpenAndTheNextRunContinuesIt) {
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger(2);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 2; }));
  EXPECT_TRUE(Join(true));
  EXPECT_FALSE(SessionEnded(session()));
  Start();
  EXPECT_EQ(first_trigger_, 2U);
  ASSERT_TRUE(InState("armed"));
  EXPECT_EQ(Client().Post("/v1/trigger").value()["step"], 2);
  ASSERT_TRUE(Client().Post("/v1/stop"));
  EXPECT_TRUE(Join(false));
  EXPECT_TRUE(SessionEnded(session()));
  EXPECT_EQ(ReadSession(session())->journal.frames.size(), 3U);
}

TEST_F(AppTest, AStopWaitsForFramesOnTheirWay) {
  camera_->SetAnswering(false);
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger(2);
  ASSERT_TRUE(Client().Post("/v1/stop", {{"leave_open", true}}));
  EXPECT_TRUE(Join(false));
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), 2U);
  EXPECT_EQ(frames[0].status, FrameStatus::kCameraTimeout);
  EXPECT_EQ(frames[1].status, FrameStatus::kCameraTimeout);
}

TEST_F(AppTest, AnUnpluggedCameraIsAStateAndComesBack) {
  Start();
  ASSERT_TRUE(InState("armed"));
  camera_->SetAnswering(false);
  Trigger();
  camera_->SetPresent(false);
  ASSERT_TRUE(InState("waiting-for-camera"));
  // The vehicle drives on: what it passes is accounted for.
  Trigger();
  camera_->SetAnswering(true);
  camera_->SetPresent(true);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["ready"] == true; }));
  Trigger();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), 3U);
  EXPECT_EQ(frames[0].status, FrameStatus::kCameraTimeout);
  EXPECT_THAT(frames[0].detail, HasSubstr("unplugged"));
  EXPECT_EQ(frames[1].status, FrameStatus::kMissedTrigger);
  EXPECT_THAT(frames[1].detail, HasSubstr("no camera"));
  EXPECT_EQ(frames[2].status, FrameStatus::kOk);
}

TEST_F(AppTest, ViewsThatCannotBeWrittenAreSaidAndTriedAgain) {
  views_fail_ = true;
  Start();
  ASSERT_TRUE(InState("degraded"));
  Trigger(3);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 3; }));
  EXPECT_THAT(Client().Get("/v1/status").value()["reason"].get<std::string>(),
              HasSubstr("No space left on device"));
  views_fail_ = false;
  ASSERT_TRUE(InState("armed"));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["views"]["finished"] == 1; }));
}

TEST_F(AppTest, ABracketTheCameraCannotTakeIsAFaultWithItsReason) {
  camera_->SetLongest(ExposureTime::Seconds(0.002));
  Start();
  ASSERT_TRUE(InState("fault"));
  EXPECT_THAT(Client().Get("/v1/status").value()["reason"].get<std::string>(),
              HasSubstr("the camera's longest is 0.002 s"));
}

TEST_F(AppTest, FinishEndsTheSessionAndKeepsServing) {
  Start();
  EXPECT_TRUE(InState("armed"));
  Trigger(3);
  EXPECT_TRUE(Client().Post("/v1/finish"));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["session"]["ended"] == true; }));
  EXPECT_EQ(Client().Get("/v1/status").value()["views"]["finished"], 3);
  ASSERT_TRUE(Client().Post("/v1/stop"));
  EXPECT_TRUE(Join(false));
}

TEST_F(AppTest, TheEventsTellTheWholeStory) {
  config_.trigger.armed_at_start = false;
  Start();
  std::vector<std::string> kinds;
  std::thread listener([&] {
    EXPECT_TRUE(Client().Events([&](const std::string& line) {
      const nlohmann::json event = nlohmann::json::parse(line);
      if (event["event"] == "status") {
        EXPECT_TRUE(Client().Post("/v1/arm"));
        Trigger();
        EXPECT_TRUE(
            Eventually([&] { return Client().Get("/v1/status").value()["frames_recorded"] == 1; }));
        EXPECT_TRUE(Client().Post("/v1/stop"));
      }
      kinds.push_back(event["event"]);
      return true;
    }));
  });
  listener.join();
  EXPECT_TRUE(Join(false));
  for (const char* kind : {"status", "trigger", "frame", "state", "session"}) {
    EXPECT_NE(std::find(kinds.begin(), kinds.end(), kind), kinds.end()) << kind;
  }
}

TEST_F(AppTest, ViewsAreMadeAtTheLowestPriorityAndCaptureIsNot) {
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  std::map<std::string, std::pair<int, int>> threads;  // name: nice value, policy
  for (const auto& task : std::filesystem::directory_iterator("/proc/self/task")) {
    std::string name;
    std::getline(std::ifstream(task.path() / "comm"), name);
    const int id = std::stoi(task.path().filename().string());
    threads[name] = {::getpriority(PRIO_PROCESS, static_cast<id_t>(id)), ::sched_getscheduler(id)};
  }
  const int usual = ::getpriority(PRIO_PROCESS, 0);
  ASSERT_TRUE(threads.contains("pipeline") && threads.contains("camera") &&
              threads.contains("recorder"));
  EXPECT_EQ(threads["pipeline"], (std::pair{19, SCHED_BATCH}));
  EXPECT_EQ(threads["camera"], (std::pair{usual, SCHED_OTHER}));
  EXPECT_EQ(threads["recorder"], (std::pair{usual, SCHED_OTHER}));
}

TEST_F(AppTest, LampsAndFieldBusShowWhatTheApplianceDoes) {
  vehicle_ = std::make_shared<FakeVehicle>();
  vehicle_->Report(true, "");
  Start();
  EXPECT_TRUE(vehicle_->started);
  ASSERT_TRUE(Eventually([&] { return vehicle_->shown().state == CaptureState::kArmed; }));
  EXPECT_TRUE(vehicle_->shown().armed);
  EXPECT_TRUE(vehicle_->shown().gnss_fix);
  camera_->SetAnswering(false);
  Trigger();
  ASSERT_TRUE(Eventually([&] { return vehicle_->shown().busy; }));
  EXPECT_EQ(vehicle_->pulses, 1) << "a pulse with every picture that is commanded";
  ASSERT_TRUE(Eventually([&] { return !vehicle_->shown().busy; }));
  ASSERT_TRUE(Eventually([&] { return vehicle_->shown().frames_lost == 1; }));
  ASSERT_TRUE(Eventually([&] { return vehicle_->shown().state == CaptureState::kDegraded; }));
  EXPECT_THAT(vehicle_->shown().last_fault, HasSubstr("camera-timeout"));
  camera_->SetAnswering(true);
  Trigger();
  ASSERT_TRUE(Eventually([&] { return vehicle_->shown().frames_recorded == 1; }));
  EXPECT_TRUE(Join(true));
  EXPECT_EQ(vehicle_->shown().state, CaptureState::kStopping);
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), 2U);
  for (const FrameRecord& frame : frames) {
    EXPECT_EQ(frame.gnss->lat_deg, 52.5);
    EXPECT_EQ(frame.gnss->fix, 4);
    EXPECT_EQ(frame.heading_deg, 12.5);
  }
}

TEST_F(AppTest, AConnectionThatIsMissingDegradesAndIsToldUntilItWorksAgain) {
  vehicle_ = std::make_shared<FakeVehicle>();
  vehicle_->Report(false, "no answer");
  Start();
  ASSERT_TRUE(InState("degraded"));
  const nlohmann::json status = Client().Get("/v1/status").value();
  EXPECT_THAT(status["reason"].get<std::string>(), HasSubstr("fake vehicle: no answer"));
  EXPECT_EQ(status["links"][0]["up"], false);
  vehicle_->Report(true, "");
  ASSERT_TRUE(InState("armed"));
}

TEST_F(AppTest, AFieldBusArmsDisarmsAndTriggersAndHearsWhyNot) {
  config_.trigger.armed_at_start = false;
  vehicle_ = std::make_shared<FakeVehicle>();
  Start();
  ASSERT_TRUE(InState("idle"));
  const Status refused = command_(ApplianceCommand::kTrigger);
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("disarmed: arm first"));
  EXPECT_TRUE(command_(ApplianceCommand::kArm));
  EXPECT_TRUE(command_(ApplianceCommand::kTrigger));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  EXPECT_TRUE(command_(ApplianceCommand::kDisarm));
  EXPECT_FALSE(command_(ApplianceCommand::kTrigger));
}

TEST_F(AppTest, TriggersLostInTheKernelAreJournalLinesWithTheirReason) {
  const auto source = std::make_shared<ToldSource>();
  triggers_ = source;
  Start();
  ASSERT_TRUE(InState("armed"));
  TriggerEvent event;
  event.time = SystemClock().Now();
  event.odometer_m = 12.5;
  event.lost_before = 2;
  event.lost_reason = "the kernel lost this edge of the trigger line: its buffer was full";
  source->Tell(event);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  EXPECT_TRUE(Join(true));
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), 3U);
  for (std::size_t i = 0; i < 2; ++i) {
    EXPECT_EQ(frames[i].status, FrameStatus::kMissedTrigger);
    EXPECT_EQ(frames[i].detail, event.lost_reason);
  }
  EXPECT_EQ(frames[2].status, FrameStatus::kOk);
  EXPECT_EQ(frames[2].odometer_m, 12.5);
  Start();
  EXPECT_EQ(last_odometer_m_, 12.5) << "a continued session goes on from its last place";
}

TEST_F(AppTest, ManyClientsAtOnceAreServed) {
  Start();
  ASSERT_TRUE(InState("armed"));
  std::vector<std::thread> clients;
  std::atomic<int> accepted = 0;
  for (int c = 0; c < 6; ++c) {
    clients.emplace_back([&] {
      for (int i = 0; i < 20; ++i) {
        if (Client().Post("/v1/trigger")) ++accepted;
        EXPECT_TRUE(Client().Get("/v1/status"));
      }
    });
  }
  for (std::thread& client : clients) client.join();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["triggers"]["in_flight"] == 0; }));
  EXPECT_TRUE(Join(true));
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), static_cast<std::size_t>(accepted.load()));
  for (std::size_t i = 0; i < frames.size(); ++i) EXPECT_EQ(Value(frames[i].frame), i);
}

}  // namespace
}  // namespace omnihdr::app_test
