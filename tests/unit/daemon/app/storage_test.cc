#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "tests/unit/daemon/app/app_fixture.h"

namespace omnihdr::storage_test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

class Storage : public testing_app::AppFixture {
 protected:
  static std::vector<FrameRecord> Journal(const fs::path& session) {
    const auto contents = ReadSession(session);
    EXPECT_TRUE(contents) << (contents ? "" : contents.error().message);
    return contents ? contents->journal.frames : std::vector<FrameRecord>{};
  }
  fs::path Named(const std::string& name) const { return directory_.path() / name; }
};

TEST_F(Storage, UnderTheStopLimitTriggersAreJournaledAsMissedWithTheReason) {
  config_.storage.limits.stop_free_mb = 1e9;
  Start();
  ASSERT_TRUE(InState("storage-full"));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["camera"]["ready"] == true; }));
  Trigger();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["drops"]["missed-trigger"] == 1; }));
  EXPECT_THAT(Journal(session()).at(0).detail, HasSubstr("storage.stop_free_mb is 1e+09"));
  const nlohmann::json status = Client().Get("/v1/status").value();
  EXPECT_THAT(status["storage"]["stop"].get<std::string>(), HasSubstr("MB are free"));
  EXPECT_EQ(status["frames_recorded"], 0);
  EXPECT_THAT(Client().GetText("/metrics").value(), HasSubstr("omnihdr_storage_stop 1"));
  EXPECT_THAT(Client().GetText("/metrics").value(),
              HasSubstr("omnihdr_triggers_missed_total{reason=\"storage-stop\"} 1"));
}

TEST_F(Storage, UnderTheWarningLimitPicturesAreStoredAndTheStateSaysWhy) {
  config_.storage.limits.warn_free_mb = 1e9;
  Start();
  ASSERT_TRUE(InState("degraded"));
  Trigger();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  EXPECT_THAT(Client().Get("/v1/status").value()["reason"].get<std::string>(),
              HasSubstr("storage.warn_free_mb"));
}

TEST_F(Storage, ALimitOfAReloadIsInForceWithinSeconds) {
  DaemonConfig next = config_;
  next.storage.limits.warn_free_mb = 1e9;
  read_config_ = [next] { return next; };
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger();
  EXPECT_TRUE(Client().Post("/v1/reload"));
  EXPECT_TRUE(InState("degraded"));
}

TEST_F(Storage, ASurveyVolumeThatIsRootIsAFaultWhenTheSessionWouldBegin) {
  config_.storage.allow_root = false;
  config_.camera.driver = CameraDriver::kV4l2;  // as configured; the one used is a double
  config_.session.directory = "/no-such-omnihdr-directory";
  // As omnihdrd chooses where nothing stands in the way.
  SessionChoice choice{"/no-such-omnihdr-directory/s", false, false};
  App app(config_, choice, [this](const PartsContext&) -> Result<AppParts> {
    AppParts parts;
    parts.camera = camera_;
    parts.triggers = triggers_;
    return parts;
  });
  std::thread thread([&] {
    EXPECT_TRUE(BlockSignals());
    EXPECT_TRUE(app.Run());
  });
  EXPECT_TRUE(InState("fault"));
  const auto status = Client().Get("/v1/status");
  EXPECT_THAT((*status)["reason"].get<std::string>(), HasSubstr("root file system"));
  EXPECT_TRUE(Client().Post("/v1/stop"));
  thread.join();
  EXPECT_FALSE(fs::exists("/no-such-omnihdr-directory"));
}

TEST_F(Storage, ASeriesOfSessionsHasEveryFrameOnceAndTheBracketInPhase) {
  config_.session.rotation.positions = 2;
  config_.bracket.exposures_s = {0.001, 0.004, 0.016};
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger(7);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 7; }));
  nlohmann::json status = Client().Get("/v1/status").value();
  EXPECT_EQ(status["session"]["directory"], Named("s-4").string());
  EXPECT_EQ(status["session"]["first_frame"], 6);
  EXPECT_EQ(status["session"]["rotations"], 3);
  // The views of those before are finished, the newest one waits for its neighbours.
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["views"]["finished"] == 6; }));
  for (const char* closed : {"s", "s-2", "s-3"}) EXPECT_TRUE(SessionEnded(Named(closed))) << closed;
  EXPECT_FALSE(SessionEnded(Named("s-4")));
  std::uint64_t number = 0;
  for (const char* name : {"s", "s-2", "s-3", "s-4"}) {
    for (const FrameRecord& record : Journal(Named(name))) {
      EXPECT_EQ(Value(record.frame), number);
      EXPECT_EQ(Value(record.position), static_cast<std::int64_t>(number));
      EXPECT_DOUBLE_EQ(record.exposure.time.seconds(), config_.bracket.exposures_s[number % 3]);
      EXPECT_TRUE(fs::exists(Named(name) / record.file));
      ++number;
    }
  }
  EXPECT_EQ(number, 7U);

  // The next run goes on with the newest of them, in its number and its phase.
  EXPECT_TRUE(Join(true));
  Start();
  EXPECT_EQ(first_trigger_, 7U);
  ASSERT_TRUE(InState("armed"));
  EXPECT_EQ(Client().Post("/v1/trigger").value()["step"], 1);
  ASSERT_TRUE(Client().Post("/v1/stop"));
  EXPECT_TRUE(Join(false));
  EXPECT_TRUE(SessionEnded(Named("s-4")));
  EXPECT_EQ(Journal(Named("s-4")).size(), 2U);
}

TEST_F(Storage, APositionOfSeveralFramesLiesInOneSession) {
  config_.session.rotation.positions = 1;
  config_.bracket.frames_per_position = 3;
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger(7);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 7; }));
  EXPECT_EQ(Journal(Named("s")).size(), 3U);
  EXPECT_EQ(Journal(Named("s-2")).size(), 3U);
  EXPECT_EQ(Journal(Named("s-3")).size(), 1U);
}

TEST_F(Storage, ANextSessionThatCannotBeBegunLosesNothing) {
  config_.session.rotation.positions = 2;
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger(1);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  // Where its directory would be is a link to nowhere.
  fs::create_symlink("/proc/no-such-place", Named("s-2"));
  Trigger(3);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 4; }));
  const nlohmann::json status = Client().Get("/v1/status").value();
  EXPECT_EQ(status["session"]["directory"], session().string());
  EXPECT_GE(status["storage"]["errors"].get<int>(), 1);
  EXPECT_EQ(Journal(session()).size(), 4U);
}

TEST_F(Storage, ASessionWhoseViewsWereNotFinishedIsFinishedByTheNextRun) {
  config_.session.rotation.positions = 2;
  views_fail_ = true;
  Start();
  Trigger(3);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 3; }));
  EXPECT_TRUE(Join(true));
  EXPECT_FALSE(SessionEnded(Named("s")));
  views_fail_ = false;
  Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["views"]["finished"] == 2; }));
  EXPECT_TRUE(SessionEnded(Named("s")));
  EXPECT_EQ(Client().Get("/v1/status").value()["session"]["directory"], Named("s-2").string());
}

TEST_F(Storage, ByIntervalFramesAreSyncedWithinItAndAtTheEnd) {
  config_.recorder.durability = Durability::kInterval;
  config_.recorder.sync_interval_s = 60.0;
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger(2);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 2; }));
  nlohmann::json status = Client().Get("/v1/status").value();
  EXPECT_EQ(status["storage"]["unsynced_frames"], 2);
  EXPECT_EQ(status["storage"]["max_loss_s"], 60.0);
  EXPECT_TRUE(Join(true));
  config_.recorder.sync_interval_s = 0.2;
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 3; }));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["storage"]["unsynced_frames"] == 0; }));
}

TEST_F(Storage, RetentionDeletesWhatHasEndedAndNeverTheSessionAtHand) {
  const fs::path old = Named("20200101T000000Z");
  fs::create_directories(old / "views" / "000000");
  std::ofstream(old / "session.json") << "{}";
  std::ofstream(old / "views" / "000000" / "preview.jpg") << "x";
  ASSERT_TRUE(MarkSessionEnded(old, 1, SystemClock().NowUtc()));
  fs::last_write_time(old / "ended.json",
                      fs::file_time_type::clock::now() - std::chrono::hours(72));
  config_.storage.retention = {Retention::kViews, 1.0, 0.0};
  Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["storage"]["deleted"] == 1; }));
  EXPECT_FALSE(fs::exists(old / "views"));
  EXPECT_TRUE(fs::exists(old / "session.json"));
  Trigger();
  EXPECT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
}

}  // namespace
}  // namespace omnihdr::storage_test
