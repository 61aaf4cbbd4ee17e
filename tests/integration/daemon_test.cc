#include <fmt/format.h>
#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <signal.h>
#include <sys/socket.h>
#include <sys/un.h>

#include <cstring>
#include <fstream>
#include <random>
#include <thread>

#include "core/base/file.h"
#include "core/session/session_reader.h"
#include "daemon/api/client.h"
#include "drivers/sim/simulation.h"
#include "tests/integration/daemon_fixture.h"

namespace omnihdr::daemon_test {
namespace {

// Of a whole session of one chain: four a view, and keyframe.bin of all but the last two.
constexpr std::size_t FilesOfViews(std::size_t positions) { return 4 * positions + positions - 2; }

namespace fs = std::filesystem;
using integration::Eventually;
using integration::FilesBelow;
using integration::Program;
using integration::RunOmnihdr;
using ::testing::HasSubstr;

class Daemon : public integration::DaemonFixture {};

TEST_F(Daemon, ABadConfigurationEndsWith78AndNamesTheLine) {
  WriteConfig(SimCamera(), "[recorder]\nqueue_frames = 0\n");
  const auto daemon = Start();
  EXPECT_EQ(daemon->Wait(), 78);
  EXPECT_THAT(daemon->Log(), HasSubstr("recorder.queue_frames"));
  EXPECT_FALSE(fs::exists(session()));
}

TEST_F(Daemon, CheckStartsNothing) {
  WriteConfig(SimCamera());
  const auto daemon = Start({"--check"});
  EXPECT_EQ(daemon->Wait(), 0);
  EXPECT_FALSE(fs::exists(directory() / "api.sock"));
}

TEST_F(Daemon, AWrongOptionEndsWith64) { EXPECT_EQ(Start({"--no-such-option"})->Wait(), 64); }

TEST_F(Daemon, EveryTriggerHasItsJournalLine) {
  WriteConfig(SimCamera(), "[recorder]\nqueue_frames = 2\n");
  const auto daemon = Start();
  ASSERT_TRUE(Armed());
  // Far faster than the camera can: some are missed, all are accounted for.
  std::uint64_t accepted = 0;
  for (int i = 0; i < 20; ++i) {
    if (Client().Post("/v1/trigger")) ++accepted;
  }
  EXPECT_EQ(accepted, 20U);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["triggers"]["in_flight"] == 0; }));
  const nlohmann::json status = StatusNow();
  EXPECT_EQ(status["positions_triggered"], 20);
  EXPECT_EQ(status["frames_recorded"].get<int>() + status["frames_dropped"].get<int>(), 20);
  EXPECT_GT(status["frames_dropped"].get<int>(), 0);
  EXPECT_EQ(status["state"], "degraded");

  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 20U);
  for (std::size_t i = 0; i < journal.size(); ++i) {
    EXPECT_EQ(Value(journal[i].frame), i);
    EXPECT_EQ(Value(journal[i].position), static_cast<std::int64_t>(i));
    EXPECT_EQ(journal[i].status == FrameStatus::kOk, journal[i].detail.empty());
    EXPECT_EQ(journal[i].status == FrameStatus::kOk,
              fs::exists(session() / fmt::format("raw/{:06}.png", i)));
    if (journal[i].status == FrameStatus::kOk) {
      EXPECT_EQ(journal[i].proof, ExposureProof::kEmbedded);
    }
  }
}

TEST_F(Daemon, TriggersAreIgnoredWhileDisarmedAndRefusedByName) {
  WriteConfig(SimCamera());
  const auto daemon = Start();
  ASSERT_TRUE(Armed());
  EXPECT_EQ(Client().Post("/v1/disarm").value()["state"], "idle");
  const auto refused = Client().Post("/v1/trigger");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().message, "disarmed: arm first");
  EXPECT_EQ(Client().Post("/v1/arm").value()["state"], "armed");
  EXPECT_TRUE(Client().Post("/v1/trigger"));
}

TEST_F(Daemon, TheCommandLineControlsIt) {
  WriteConfig(SimCamera());
  const std::string socket = (directory() / "api.sock").string();
  EXPECT_EQ(RunOmnihdr({"status", "--socket", socket}, directory()).first, 69);
  const auto daemon = Start();
  ASSERT_TRUE(Armed());
  const auto [trigger_code, trigger] = RunOmnihdr({"trigger", "--socket", socket}, directory());
  EXPECT_EQ(trigger_code, 0);
  EXPECT_EQ(trigger, "trigger 0: position 0, 0.004 s\n");
  const auto [status_code, status] = RunOmnihdr({"status", "--socket", socket}, directory());
  EXPECT_EQ(status_code, 0);
  EXPECT_THAT(status, HasSubstr("positions   1 triggered by software"));
  const auto [json_code, json] = RunOmnihdr({"status", "--socket", socket, "--json"}, directory());
  EXPECT_EQ(json_code, 0);
  EXPECT_EQ(nlohmann::json::parse(json)["positions_triggered"], 1);
  EXPECT_EQ(RunOmnihdr({"disarm", "--socket", socket}, directory()).second, "idle\n");
  EXPECT_EQ(RunOmnihdr({"arm", "--socket", socket}, directory()).second, "armed\n");

  Program watch("omnihdr", {"watch", "--socket", socket, "--json"}, directory() / "events");
  ASSERT_TRUE(
      Eventually([&] { return watch.Log().find("\"event\":\"status\"") != std::string::npos; }));
  EXPECT_EQ(RunOmnihdr({"stop", "--socket", socket, "--timeout", "60"}, directory()).first, 0);
  EXPECT_EQ(daemon->Wait(), 0);
  EXPECT_EQ(watch.Wait(), 0);
  EXPECT_THAT(watch.Log(), HasSubstr("\"what\":\"ended\""));
  EXPECT_TRUE(fs::exists(session() / "ended.json"));
  EXPECT_TRUE(fs::exists(session() / "views/000000/view.json"));
  EXPECT_FALSE(fs::exists(socket));
  EXPECT_EQ(RunOmnihdr({"no-such-command"}, directory()).first, 64);
}

TEST_F(Daemon, ACameraOnTheTriggersWireIsObservedAndItsBracketIsSetInAdvance) {
  WriteConfig(
      "[camera]\ndriver = \"sim\"\n[camera.sim]\nscene = \"tunnel\"\nwidth = 128\n"
      "[trigger]\nsource = \"timer\"\ninterval_s = 0.4\nwired = true\nlimit = 6\n"
      "armed_at_start = true\n[pipeline]\nenabled = false\n");
  const auto daemon = Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["session"]["ended"] == true; }))
      << daemon->Log();
  const nlohmann::json status = StatusNow();
  EXPECT_EQ(status["trigger_wired"], true);
  EXPECT_EQ(status["triggers"]["frames_without_edge"], 0);
  EXPECT_EQ(status["triggers"]["accepted"], 6);
  const auto contents = ReadSession(session());
  ASSERT_TRUE(contents);
  ASSERT_TRUE(contents->info.bracket);
  int good = 0;
  for (const FrameRecord& record : contents->journal.frames) {
    if (record.status != FrameStatus::kOk) continue;
    ++good;
    ASSERT_TRUE(record.step);
    EXPECT_EQ(record.exposure.time,
              contents->info.bracket->exposures[static_cast<std::size_t>(*record.step)]);
    EXPECT_TRUE(record.timestamp_error) << "paired with its edge";
  }
  EXPECT_GT(good, 0) << daemon->Log();
}

TEST_F(Daemon, ALookAtTheSceneBeforeTheFirstPictureBecomesTheBracketOfTheSession) {
  WriteConfig(
      "[camera]\ndriver = \"sim\"\nframe_timeout_s = 10.0\n[camera.sim]\nscene = \"tunnel\"\n"
      "width = 128\n[bracket]\nmeter = \"adopt\"\n[trigger]\narmed_at_start = true\n"
      "[pipeline]\nenabled = false\n");
  const auto daemon = Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["metering"].is_object(); }))
      << daemon->Log();
  const nlohmann::json metering = StatusNow()["metering"];
  EXPECT_EQ(metering["adopted"], true) << metering;
  EXPECT_GT(metering["exposures_s"].size(), 3U) << metering;
  const auto [code, text] =
      RunOmnihdr({"status", "--socket", (directory() / "api.sock").string()}, directory());
  EXPECT_EQ(code, 0);
  EXPECT_THAT(text, HasSubstr(", adopted"));
  ASSERT_TRUE(Trigger());
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  const auto contents = ReadSession(session());
  ASSERT_TRUE(contents) << contents.error().message;
  ASSERT_TRUE(contents->info.bracket);
  EXPECT_TRUE(contents->info.bracket->metered);
  ASSERT_EQ(contents->info.bracket->exposures.size(), metering["exposures_s"].size());
  EXPECT_EQ(contents->journal.frames.at(0).exposure.time, contents->info.bracket->exposures[0]);
}

TEST_F(Daemon, TheServiceManagerHearsThatItServesAndThatItLives) {
  WriteConfig(SimCamera());
  const Fd manager(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC, 0));
  sockaddr_un address{};
  address.sun_family = AF_UNIX;
  std::strncpy(address.sun_path, (directory() / "notify").c_str(), sizeof(address.sun_path) - 1);
  ASSERT_EQ(::bind(manager.get(), reinterpret_cast<const sockaddr*>(&address), sizeof(address)), 0);
  timeval timeout{};
  timeout.tv_sec = 30;
  ASSERT_EQ(::setsockopt(manager.get(), SOL_SOCKET, SO_RCVTIMEO, &timeout, sizeof(timeout)), 0);
  const auto daemon =
      Start({}, {"NOTIFY_SOCKET=" + (directory() / "notify").string(), "WATCHDOG_USEC=500000"});
  std::string heard;
  const auto hear = [&](const std::string& wanted) {
    char buffer[1024];
    while (heard.find(wanted) == std::string::npos) {
      const ssize_t n = ::recv(manager.get(), buffer, sizeof(buffer), 0);
      if (n <= 0) return false;
      heard.append(buffer, static_cast<std::size_t>(n)).append("\n");
    }
    return true;
  };
  ASSERT_TRUE(hear("READY=1")) << heard;
  // Ready means served: at this moment, not soon.
  EXPECT_TRUE(Client().Get("/v1/status"));
  EXPECT_TRUE(hear("WATCHDOG=1")) << heard;
  EXPECT_TRUE(hear("STATUS=armed")) << heard;
  daemon->Signal(SIGTERM);
  EXPECT_TRUE(hear("STOPPING=1")) << heard;
  EXPECT_EQ(daemon->Wait(), 0);
}

TEST_F(Daemon, ASecondDaemonIsRefused) {
  WriteConfig(SimCamera());
  const auto first = Start();
  ASSERT_TRUE(Armed());
  // The same socket, and the same session under another socket.
  EXPECT_EQ(Start({"--session", "other"})->Wait(), 75);
  std::ofstream(directory() / "d.toml") << fmt::format(
      "[session]\ndirectory = \"sessions\"\nname = \"s\"\n"
      "[api]\nsocket = \"other.sock\"\n{}{}",
      SimCamera(), integration::kAnyStorage);
  Program second("omnihdrd", {"--config", (directory() / "d.toml").string()}, directory() / "log2");
  EXPECT_EQ(second.Wait(), 75);
  EXPECT_THAT(second.Log(), HasSubstr("another process is writing this session"));
  ASSERT_TRUE(Trigger());
  EXPECT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
}

TEST_F(Daemon, AMissingCameraIsWaitedFor) {
  RecordSource(3);
  fs::rename(directory() / "source", directory() / "away");
  WriteConfig(ReplayCamera("software"));
  const auto daemon = Start();
  // Not at once: before the first attempt has failed it is "opening the camera".
  EXPECT_TRUE(StatusHolds([](const auto& s) {
    return s["state"] == "waiting-for-camera" &&
           s["reason"].template get<std::string>().find("source") != std::string::npos;
  })) << StatusNow().dump();
  const auto refused = Client().Post("/v1/trigger");
  ASSERT_FALSE(refused);
  EXPECT_THAT(refused.error().message, HasSubstr("no session yet"));
  fs::rename(directory() / "away", directory() / "source");
  ASSERT_TRUE(Armed());
  EXPECT_TRUE(Trigger());
  EXPECT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
}

TEST_F(Daemon, AReplayGivesTheBytesOfTheBatchTool) {
  RecordSource(5, true);
  WriteConfig(ReplayCamera("replay"));
  const auto reference = ProcessedSource();
  ASSERT_EQ(reference.size(), FilesOfViews(5));
  const auto daemon = Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s.is_object(); }));
  EXPECT_EQ(RunOmnihdr({"watch", "--socket", (directory() / "api.sock").string(), "--until-done",
                        "--timeout", "100"},
                       directory())
                .first,
            0);
  EXPECT_EQ(Journal().size(), 5U);
  EXPECT_TRUE(FilesBelow(session() / "views") == reference);
  // The session has ended, the daemon serves on, and takes no more.
  EXPECT_EQ(StatusNow()["session"]["ended"], true);
  const auto refused = Client().Post("/v1/arm");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().message, "the session has ended");
  daemon->Signal(SIGTERM);
  EXPECT_EQ(daemon->Wait(), 0);

  // And stays ended after a restart.
  const auto again = Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["views"]["finished"] == 5; }));
  EXPECT_EQ(StatusNow()["session"]["ended"], true);
  EXPECT_FALSE(Client().Post("/v1/arm"));
}

TEST_F(Daemon, OverloadedItReducesViewsAndAnUpgradeGivesTheBytesOfTheBatchTool) {
  constexpr int kPositions = 10;
  RecordSource(kPositions, true);
  // A replay comes as fast as the disk takes it: much faster than views are made.
  WriteConfig(ReplayCamera("replay"),
              "[pipeline]\noverload = \"degrade\"\nbacklog_limit = 2\n"
              "[output]\nwidth = 2560\n");
  const auto reference = ProcessedSource();
  ASSERT_EQ(reference.size(), FilesOfViews(kPositions));
  {
    const auto daemon = Start();
    ASSERT_TRUE(
        StatusHolds([](const auto& s) { return s.is_object() && s["session"]["ended"] == true; }));
    const nlohmann::json views = StatusNow()["views"];
    EXPECT_GT(views["reduced"], 0);
    EXPECT_EQ(views["quality_level"], 0) << "nothing waits any more";
    const auto [code, text] =
        RunOmnihdr({"status", "--socket", (directory() / "api.sock").string()}, directory());
    EXPECT_EQ(code, 0);
    EXPECT_THAT(text, HasSubstr("of reduced quality"));
    daemon->Signal(SIGTERM);
    EXPECT_EQ(daemon->Wait(), 0);
  }
  EXPECT_FALSE(FilesBelow(session() / "views") == reference);
  const auto [code, output] =
      RunOmnihdr({"process", session().string(), "--upgrade", "--config", Config()}, directory());
  EXPECT_EQ(code, 0) << output;
  EXPECT_TRUE(FilesBelow(session() / "views") == reference);
}

TEST_F(Daemon, ACleanStopLeavesTheSessionOpenAndTheNextStartGoesOn) {
  RecordSource(6);
  WriteConfig(ReplayCamera("software"));
  const auto reference = ProcessedSource();
  {
    const auto daemon = Start();
    ASSERT_TRUE(Armed());
    for (int i = 0; i < 4; ++i) {
      ASSERT_TRUE(Trigger());
      ASSERT_TRUE(StatusHolds([i](const auto& s) { return s["frames_recorded"] == i + 1; }));
    }
    daemon->Signal(SIGTERM);
    EXPECT_EQ(daemon->Wait(), 0);
    EXPECT_EQ(Journal().size(), 4U);
    // Views 2 and 3 wait for neighbours that will still come.
    EXPECT_FALSE(fs::exists(session() / "views/000002"));
    EXPECT_FALSE(fs::exists(session() / "ended.json"));
  }
  const auto daemon = Start();
  ASSERT_TRUE(Armed());
  EXPECT_EQ(StatusNow()["session"]["resumed"], true);
  EXPECT_EQ(StatusNow()["frames_recorded"], 4);
  for (int i = 4; i < 6; ++i) {
    EXPECT_EQ(StatusNow()["bracket"]["step"], i % 3);
    ASSERT_TRUE(Trigger());
    ASSERT_TRUE(StatusHolds([i](const auto& s) { return s["frames_recorded"] == i + 1; }));
  }
  ASSERT_TRUE(Client().Post("/v1/stop"));
  EXPECT_EQ(daemon->Wait(), 0);
  EXPECT_TRUE(FilesBelow(session() / "views") == reference);
}

TEST_F(Daemon, KilledAtAnyMomentItEndsWithTheSameBytes) {
  RecordSource(7, true);
  WriteConfig(ReplayCamera("replay"));
  const auto reference = ProcessedSource();
  ASSERT_EQ(reference.size(), FilesOfViews(7));
  std::mt19937 random(20260101);
  std::uniform_int_distribution<int> moment_ms(60, 900);
  for (int kill = 0; kill < 5; ++kill) {
    const auto daemon = Start();
    std::this_thread::sleep_for(std::chrono::milliseconds(moment_ms(random)));
    daemon->Signal(SIGKILL);
    daemon->Wait();
    // Whatever is there is whole: every line's pixels, every visible view.
    if (fs::exists(session() / "session.json")) {
      for (const FrameRecord& record : Journal()) {
        EXPECT_TRUE(record.file.empty() || fs::exists(session() / record.file)) << record.file;
      }
    }
    for (const auto& [name, bytes] : FilesBelow(session() / "views")) {
      if (name[0] == '.') continue;  // what an interrupted writer left; removed by the next start
      ASSERT_TRUE(reference.contains(name)) << name;
      EXPECT_TRUE(reference.at(name) == bytes) << name;
    }
  }
  const auto daemon = Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["session"]["ended"] == true; }));
  EXPECT_EQ(Journal().size(), 7U);
  EXPECT_TRUE(FilesBelow(session() / "views") == reference);
}

TEST_F(Daemon, WhenViewsCannotBeWrittenItSaysSoAndCapturesOn) {
  RecordSource(6);
  WriteConfig(ReplayCamera("software"));
  const auto reference = ProcessedSource();
  std::uint64_t largest_frame = 0;
  for (const auto& [name, bytes] : FilesBelow(directory() / "source" / "raw")) {
    largest_frame = std::max<std::uint64_t>(largest_frame, bytes.size());
  }
  const std::uint64_t limit = largest_frame + 16384;
  ASSERT_GT(reference.at("000001/disparity.exr").size(), limit);

  const auto daemon = Start();
  ASSERT_TRUE(Armed());
  daemon->LimitFileSize(limit);
  for (int i = 0; i < 5; ++i) {
    ASSERT_TRUE(Trigger());
    ASSERT_TRUE(StatusHolds([i](const auto& s) { return s["frames_recorded"] == i + 1; }));
  }
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["state"] == "degraded"; }));
  EXPECT_THAT(StatusNow()["views"]["error"].get<std::string>(), HasSubstr("File too large"));
  EXPECT_EQ(StatusNow()["views"]["finished"], 0);
  EXPECT_TRUE(FilesBelow(session() / "views").empty());
  ASSERT_TRUE(Trigger());
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 6; }));

  daemon->LimitFileSize(0);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["views"]["finished"] == 4; }));
  EXPECT_THAT(StatusNow()["state"].get<std::string>(), ::testing::AnyOf("armed", "capturing"));
  ASSERT_TRUE(Client().Post("/v1/stop"));
  EXPECT_EQ(daemon->Wait(), 0);
  EXPECT_TRUE(FilesBelow(session() / "views") == reference);
}

TEST_F(Daemon, WhenFramesCannotBeStoredTheirLinesSaySoAndItRecovers) {
  RecordSource(4);
  WriteConfig(ReplayCamera("software"));
  const auto daemon = Start();
  ASSERT_TRUE(Armed());
  ASSERT_TRUE(Trigger());
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 1; }));
  daemon->LimitFileSize(8192);
  ASSERT_TRUE(Trigger());
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["drops"]["disk-full"] == 1; }));
  EXPECT_EQ(StatusNow()["state"], "storage-full");
  daemon->LimitFileSize(0);
  ASSERT_TRUE(Trigger());
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 2; }));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["state"] != "storage-full"; }));
  const std::vector<FrameRecord> journal = Journal();
  ASSERT_EQ(journal.size(), 3U);
  EXPECT_EQ(journal[1].status, FrameStatus::kDiskFull);
  EXPECT_TRUE(journal[1].file.empty());
  EXPECT_THAT(journal[1].detail, HasSubstr("File too large"));
}

TEST_F(Daemon, ASessionOfAnotherCameraIsNotContinued) {
  RecordSource(3);
  WriteConfig(ReplayCamera("software"));
  {
    const auto daemon = Start();
    ASSERT_TRUE(Armed());
    ASSERT_TRUE(Client().Post("/v1/stop", {{"leave_open", true}}));
    EXPECT_EQ(daemon->Wait(), 0);
  }
  WriteConfig(SimCamera(320));
  const auto daemon = Start();
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["state"] == "fault"; }));
  EXPECT_THAT(StatusNow()["reason"].get<std::string>(),
              HasSubstr("the session has frames of 256x128"));
}

TEST_F(Daemon, AnExistingSessionIsRefusedWhenSoConfigured) {
  WriteConfig(SimCamera());
  {
    const auto daemon = Start();
    ASSERT_TRUE(Armed());
    daemon->Signal(SIGINT);
    EXPECT_EQ(daemon->Wait(), 0);
  }
  std::ofstream(directory() / "c.toml") << fmt::format(
      "[session]\ndirectory = \"sessions\"\nname = \"s\"\non_existing = \"refuse\"\n"
      "[api]\nsocket = \"api.sock\"\n{}{}",
      SimCamera(), integration::kAnyStorage);
  EXPECT_EQ(Start()->Wait(), 73);
}

}  // namespace
}  // namespace omnihdr::daemon_test
