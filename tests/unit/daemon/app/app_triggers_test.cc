// Every trigger and what becomes of it, through the whole daemon.
#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <thread>

#include "core/session/session_reader.h"
#include "drivers/trigger/timer_trigger.h"
#include "tests/unit/daemon/app/app_fixture.h"

namespace omnihdr::app_triggers_test {
namespace {

using std::chrono::milliseconds;
using ::testing::HasSubstr;
using testing_app::ToldSource;

class AppTriggers : public testing_app::AppFixture {};

TEST_F(AppTriggers, EdgesBeforeThereCanBeASessionAreCountedAndJournaledAsMissedOnceItBegins) {
  const auto source = std::make_shared<ToldSource>();
  triggers_ = source;
  camera_->SetPresent(false);
  Start();
  ASSERT_TRUE(InState("waiting-for-camera"));
  source->Tell(3);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["triggers"]["without_session"] == 3; }));
  EXPECT_EQ(Client().Get("/v1/status").value()["triggers"]["missed"]["no-camera"], 3);
  EXPECT_FALSE(std::filesystem::exists(session()));
  camera_->SetPresent(true);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["ready"] == true; }));
  source->Tell(1);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  EXPECT_EQ(Client().Get("/v1/status").value()["triggers"]["without_session"], 0);
  EXPECT_TRUE(Join(true));
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), 4U);
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(frames[i].status, FrameStatus::kMissedTrigger);
    EXPECT_THAT(frames[i].detail, HasSubstr("no camera"));
  }
  EXPECT_EQ(frames[3].status, FrameStatus::kOk);
  EXPECT_EQ(Value(frames[3].frame), 3U);
}

TEST_F(AppTriggers, AMarkWhereTheVehicleStandsWaitsForTheCameraAndMarksThatArePassedDoNot) {
  const auto source = std::make_shared<ToldSource>();
  triggers_ = source;
  camera_->SetPresent(false);
  Start();
  ASSERT_TRUE(InState("waiting-for-camera"));
  TriggerEvent standing;
  standing.time = SystemClock().Now();
  standing.standing = true;
  source->Tell(standing);
  std::this_thread::sleep_for(milliseconds(100));
  EXPECT_EQ(Client().Get("/v1/status").value()["triggers"]["accepted"], 0);
  const HostTime before = SystemClock().Now();
  camera_->SetPresent(true);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  EXPECT_EQ(Client().Get("/v1/status").value()["frames_dropped"], 0);
  EXPECT_TRUE(Join(true));
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), 1U);
  EXPECT_GE(frames[0].trigger_time, before) << "when it was taken";
}

TEST_F(AppTriggers, AMarkOfStandingThatIsLeftBeforeThereIsACameraIsNoTrigger) {
  const auto source = std::make_shared<ToldSource>();
  triggers_ = source;
  camera_->SetPresent(false);
  Start();
  ASSERT_TRUE(InState("waiting-for-camera"));
  TriggerEvent standing;
  standing.time = SystemClock().Now();
  standing.standing = true;
  source->Tell(standing);
  source->Tell(1);  // a mark that was driven to
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["triggers"]["missed"]["no-camera"] == 1; }));
  camera_->SetPresent(true);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["ready"] == true; }));
  std::this_thread::sleep_for(milliseconds(100));
  EXPECT_EQ(Client().Get("/v1/status").value()["triggers"]["accepted"], 1);
  EXPECT_TRUE(Join(true));
}

TEST_F(AppTriggers, MoreEdgesThanMayWaitForASessionAreCountedAndTheStorageIsNotBlamed) {
  const auto source = std::make_shared<ToldSource>();
  triggers_ = source;
  camera_->SetPresent(false);
  Start();
  source->Tell(5000);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["triggers"]["refused"] == 5000 - 4096; }));
  EXPECT_TRUE(InState("waiting-for-camera"));
  EXPECT_TRUE(Join(true)) << "a stop does not wait for a session that never begins";
}

TEST_F(AppTriggers, InAContinuedSessionEdgesAreJournaledBeforeTheCameraComes) {
  const auto source = std::make_shared<ToldSource>();
  triggers_ = source;
  Start();
  ASSERT_TRUE(InState("armed"));
  source->Tell(1);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  EXPECT_TRUE(Join(true));
  camera_->SetPresent(false);
  Start();
  source->Tell(2);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["drops"]["missed-trigger"] == 2; }));
  EXPECT_TRUE(InState("waiting-for-camera"));
  EXPECT_EQ(ReadSession(session())->journal.frames.size(), 3U);
  camera_->SetPresent(true);
  ASSERT_TRUE(InState("degraded")) << "of the last triggers some were lost";
  source->Tell(1);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 2; }));
}

TEST_F(AppTriggers, ATimersRasterHasNoHoleWhileTheCameraIsAway) {
  triggers_ = std::make_shared<TimerTrigger>(TimerTriggerOptions{0.02, 0});
  camera_->SetPresent(false);
  Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["triggers"]["without_session"] > 3; }));
  camera_->SetPresent(true);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] > 3; }));
  camera_->SetPresent(false);
  ASSERT_TRUE(InState("waiting-for-camera"));
  const int recorded = Client().Get("/v1/status").value()["frames_recorded"];
  std::this_thread::sleep_for(milliseconds(100));
  camera_->SetPresent(true);
  ASSERT_TRUE(StatusHolds([&](const auto& s) { return s["frames_recorded"] > recorded + 3; }));
  EXPECT_TRUE(Join(true));
  const auto frames = ReadSession(session())->journal.frames;
  for (std::size_t i = 1; i < frames.size(); ++i) {
    // Expirations that were polled late have the time of the one that tells of them.
    const std::int64_t step = (frames[i].trigger_time - frames[0].trigger_time).count();
    EXPECT_EQ(step % 20'000'000, 0) << i;
    EXPECT_GE(step / 20'000'000, static_cast<std::int64_t>(i)) << i;
    EXPECT_LT(step / 20'000'000, static_cast<std::int64_t>(i) + 50) << i;
  }
  const std::int64_t way = (frames.back().trigger_time - frames[0].trigger_time).count();
  EXPECT_EQ(way / 20'000'000, static_cast<std::int64_t>(frames.size()) - 1);
}

TEST_F(AppTriggers, WhatCameBeforeItWasDisarmedHasItsLine) {
  const auto source = std::make_shared<ToldSource>();
  triggers_ = source;
  camera_->SetPresent(false);
  Start();
  // Nothing but the disarming looks at them, or the loop did just before: either way they count.
  source->Tell(100);
  source->Lose(2, "the kernel's buffer was full");
  ASSERT_TRUE(Client().Post("/v1/disarm"));
  const nlohmann::json status = Client().Get("/v1/status").value();
  EXPECT_EQ(status["triggers"]["accepted"], 102);
  EXPECT_EQ(status["triggers"]["missed"]["source-lost"], 2);
  EXPECT_EQ(status["triggers"]["missed"]["no-camera"], 100);
}

// A camera on the trigger's wire: it exposes at every pulse with what was prepared.
class WiredCamera final : public Camera {
 public:
  Result<CameraInfo> Open() override {
    CameraInfo info;
    info.description.model = "wired";
    info.description.width = 128;
    info.description.height = 64;
    info.shortest = ExposureTime::Seconds(1e-6);
    info.longest = ExposureTime::Seconds(10.0);
    info.proof = ExposureProof::kEmbedded;
    info.wired = true;
    return info;
  }
  void Close() override {}
  Status Start() override { return {}; }
  void Stop() override {}
  Status Trigger(const ExposureRequest&) override {
    ++edges;
    return {};
  }
  void Prepare(const Exposure& next) override {
    std::lock_guard lock(mutex_);
    prepared_ = next;
  }
  Result<CameraFrame> Receive(Nanoseconds timeout) override {
    std::unique_lock lock(mutex_);
    changed_.wait_for(lock, timeout, [this] { return !frames_.empty(); });
    if (frames_.empty()) return Fail(ErrorKind::kTemporary, "nothing yet");
    CameraFrame frame = std::move(frames_.front());
    frames_.pop_front();
    return frame;
  }
  HostTime Pulse() {
    CameraFrame frame;
    frame.wired = WiredStart{SystemClock().Now(), Nanoseconds(0)};
    frame.mid_exposure = frame.wired->at;
    frame.camera_counter = counter_++;
    frame.proof = ExposureProof::kEmbedded;
    frame.pixels = Image<std::uint8_t>(128, 64, 3, 100);
    std::lock_guard lock(mutex_);
    frame.measured_exposure = prepared_;
    const HostTime at = frame.wired->at;
    frames_.push_back(std::move(frame));
    changed_.notify_all();
    return at;
  }
  std::atomic<int> edges = 0;

 private:
  std::mutex mutex_;
  std::condition_variable changed_;
  std::deque<CameraFrame> frames_;
  std::optional<Exposure> prepared_;
  std::uint64_t counter_ = 0;
};

TEST_F(AppTriggers, ACameraOnTheWireIsNotCommandedAndFramesAndEdgesFindEachOther) {
  const auto source = std::make_shared<ToldSource>();
  const auto camera = std::make_shared<WiredCamera>();
  triggers_ = source;
  other_camera_ = camera;
  config_.trigger.wired = true;
  config_.trigger.rearm_after = 0;
  Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["ready"] == true; }));
  EXPECT_EQ(Client().Post("/v1/trigger").error().kind, ErrorKind::kUnavailable)
      << "nobody can command it";
  int recorded = 0;
  const auto next = [&](bool pulse, bool edge) {
    TriggerEvent event;
    event.time = pulse ? camera->Pulse() : SystemClock().Now();
    if (edge) source->Tell(event);
    if (!pulse) return;
    ++recorded;
    ASSERT_TRUE(StatusHolds([&](const auto& s) { return s["frames_recorded"] == recorded; }));
  };
  for (int i = 0; i < 3; ++i) next(true, true);
  next(false, true);  // the pulse does not reach the camera
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["triggers"]["edges_without_frame"] == 1; }));
  next(true, true);
  next(true, false);  // its edge is not seen
  EXPECT_EQ(Client().Get("/v1/status").value()["triggers"]["frames_without_edge"], 1);
  EXPECT_EQ(camera->edges, 5);
  EXPECT_TRUE(Join(true));
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), 6U);
  for (const std::size_t good : {0U, 1U, 2U, 4U, 5U}) {
    EXPECT_EQ(frames[good].status, FrameStatus::kOk) << good << ": " << frames[good].detail;
    EXPECT_EQ(frames[good].proof, ExposureProof::kEmbedded);
  }
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_EQ(frames[i].exposure.time.seconds(), config_.bracket.exposures_s[i]);
  }
  EXPECT_EQ(frames[3].status, FrameStatus::kCameraTimeout);
  EXPECT_THAT(frames[3].detail, HasSubstr("the pulse did not reach the camera"));
  EXPECT_THAT(frames[5].detail, HasSubstr("no edge was seen for this frame"));
}

TEST_F(AppTriggers, ABurstIsTheWholeBracketAtOnePosition) {
  config_.trigger.burst = true;
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 3; }));
  Trigger();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 6; }));
  EXPECT_EQ(Client().Get("/v1/status").value()["positions_triggered"], 2);
  EXPECT_TRUE(Join(true));
  const auto frames = ReadSession(session())->journal.frames;
  ASSERT_EQ(frames.size(), 6U);
  for (std::size_t i = 0; i < 6; ++i) {
    EXPECT_EQ(Value(frames[i].position), static_cast<std::int64_t>(i / 3));
    EXPECT_EQ(frames[i].step, static_cast<int>(i % 3));
    EXPECT_FALSE(frames[i].utc_source.empty());
  }
  EXPECT_EQ(ReadSession(session())->info.bracket->frames_per_position, 3);
  EXPECT_THAT(ReadSession(session())->info.extra_json, HasSubstr("CLOCK_MONOTONIC"));
}

TEST_F(AppTriggers, ACameraThatLeavesTriggersWithoutFramesIsOpenedAnewAndThatIsCounted) {
  config_.trigger.rearm_after = 3;
  config_.camera.frame_timeout_s = 0.05;
  camera_->SetAnswering(false);
  Start();
  ASSERT_TRUE(InState("armed"));
  for (int i = 0; i < 3; ++i) {
    Trigger();
    ASSERT_TRUE(StatusHolds([](const auto& s) { return s["triggers"]["in_flight"] == 0; }));
  }
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["rearmed"] == 1; }));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["ready"] == true; }));
  camera_->SetAnswering(true);
  // On a busy machine a frame may be later than that.
  ASSERT_TRUE(Eventually([&] {
    Trigger();
    return Client().Get("/v1/status").value()["frames_recorded"] > 0;
  }));
}

TEST_F(AppTriggers, ALookAtTheSceneGivesTheSessionItsBracketAndAContinuedOneKeepsIt) {
  config_.bracket.meter = Metering::kAdopt;
  Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["metering"].is_object(); }));
  const auto metering = Client().Get("/v1/status").value()["metering"];
  ASSERT_TRUE(metering["adopted"].get<bool>()) << metering;
  // One even grey needs one exposure, which makes it bright: 230 instead of 100.
  ASSERT_EQ(metering["exposures_s"].size(), 1U) << metering;
  const double seconds = metering["exposures_s"][0];
  EXPECT_NEAR(seconds / 0.004, 230.0 / 100.0, 0.1);
  Trigger();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  EXPECT_TRUE(Join(true));
  const auto begun = ReadSession(session());
  ASSERT_TRUE(begun) << begun.error().message;
  ASSERT_TRUE(begun->info.bracket);
  EXPECT_TRUE(begun->info.bracket->metered);
  ASSERT_EQ(begun->info.bracket->exposures.size(), 1U);
  EXPECT_EQ(begun->info.bracket->exposures[0].seconds(), seconds);
  EXPECT_EQ(nlohmann::json::parse(begun->info.extra_json)["metering"]["pictures"], 1);
  EXPECT_EQ(begun->journal.frames.at(0).exposure.time.seconds(), seconds);
  EXPECT_EQ(Value(begun->journal.frames.at(0).frame), 0U) << "no picture of the look is kept";

  Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["ready"] == true; }));
  Trigger();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 2; }));
  EXPECT_TRUE(Client().Get("/v1/status").value()["metering"].is_null());
  EXPECT_TRUE(Join(true));
  EXPECT_EQ(ReadSession(session())->journal.frames.at(1).exposure.time.seconds(), seconds);
}

TEST_F(AppTriggers, ALookThatOnlyReportsLeavesTheBracketAsItIs) {
  config_.bracket.meter = Metering::kReport;
  Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["metering"].is_object(); }));
  EXPECT_FALSE(Client().Get("/v1/status").value()["metering"]["adopted"].get<bool>());
  Trigger();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  EXPECT_TRUE(Join(true));
  const auto contents = ReadSession(session());
  EXPECT_FALSE(contents->info.bracket->metered);
  EXPECT_EQ(contents->journal.frames.at(0).exposure.time.seconds(), config_.bracket.exposures_s[0]);
}

TEST_F(AppTriggers, ATriggerDuringTheLookIsMissedWithTheReasonAndALookThatFailsCostsNothingElse) {
  config_.bracket.meter = Metering::kAdopt;
  config_.camera.frame_timeout_s = 1.0;
  camera_->SetAnswering(false);
  Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["ready"] == true; }));
  Trigger();
  ASSERT_TRUE(
      StatusHolds([](const auto& s) { return s["triggers"]["missed"]["camera-busy"] == 1; }));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["metering"].is_object(); }));
  EXPECT_TRUE(Client().Get("/v1/status").value()["metering"].contains("error"));
  camera_->SetAnswering(true);
  Trigger();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  EXPECT_TRUE(Join(true));
  const auto frames = ReadSession(session())->journal.frames;
  EXPECT_THAT(frames.at(0).detail, HasSubstr("the first look at the scene is being taken"));
  EXPECT_FALSE(ReadSession(session())->info.bracket->metered);
}

TEST_F(AppTriggers, WhatTheMainsChangedInTheBracketIsTold) {
  config_.bracket.exposures_s = {0.001, 0.004, 0.012};
  config_.bracket.flicker_hz = 50;
  Start();
  ASSERT_TRUE(InState("armed"));
  const nlohmann::json status = Client().Get("/v1/status").value();
  EXPECT_THAT(status["bracket"]["changes"][0].get<std::string>(),
              HasSubstr("exposure 2: 0.01 s instead of 0.012 s"));
}

TEST_F(AppTriggers, ABracketThatBlursMoreThanIsAcceptedIsAFaultThatNamesTheStep) {
  config_.bracket.max_blur_px = 0.001;
  config_.bracket.speed_m_s = 10.0;
  Start();
  ASSERT_TRUE(InState("fault"));
  EXPECT_THAT(Client().Get("/v1/status").value()["reason"].get<std::string>(),
              HasSubstr("exposure 0 is 0.001 s: what is 5 m away is blurred"));
}

}  // namespace
}  // namespace omnihdr::app_triggers_test
