#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <mutex>

#include "tests/unit/daemon/app/app_fixture.h"

namespace omnihdr::reload_test {
namespace {

using ::testing::HasSubstr;

class Reload : public testing_app::AppFixture {
 protected:
  Reload() {
    next_ = config_;
    read_config_ = [this]() -> Result<DaemonConfig> {
      std::lock_guard lock(mutex_);
      if (!problem_.empty()) return Fail(ErrorKind::kConfig, "{}", problem_);
      return next_;
    };
  }
  void FileHas(const std::function<void(DaemonConfig&)>& change) {
    std::lock_guard lock(mutex_);
    change(next_);
  }
  void FileIsWrong(const std::string& problem) {
    std::lock_guard lock(mutex_);
    problem_ = problem;
  }
  double NextExposure() const {
    return Client().Get("/v1/status").value()["bracket"]["exposure_s"].get<double>();
  }

 private:
  std::mutex mutex_;
  DaemonConfig next_;
  std::string problem_;
};

TEST_F(Reload, WhatAppliesAtOnceIsInForceWithTheNextTriggerAndIsTold) {
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger();
  FileHas([](DaemonConfig& c) {
    c.bracket.exposures_s = {0.002, 0.008};
    c.log.level = LogLevel::kDebug;
  });
  const nlohmann::json answer = Client().Post("/v1/reload").value();
  ASSERT_EQ(answer["changes"].size(), 2U) << answer;
  EXPECT_EQ(answer["changes"][0]["key"], "bracket.exposures_s");
  EXPECT_EQ(answer["changes"][0]["old"], "[0.001, 0.004, 0.016]");
  EXPECT_EQ(answer["changes"][0]["new"], "[0.002, 0.008]");
  EXPECT_EQ(answer["changes"][0]["applies"], "at once");
  EXPECT_TRUE(answer["restart_needed"].empty());
  InitLogging(LogLevel::kError);
  Trigger(2);
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["frames_recorded"] == 3; }));
  EXPECT_EQ(Client().Get("/v1/status").value()["config"]["reloads"], 1);
  const auto frames = ReadSession(session())->journal.frames;
  EXPECT_DOUBLE_EQ(frames[0].exposure.time.seconds(), 0.001);
  EXPECT_DOUBLE_EQ(frames[1].exposure.time.seconds(), 0.008);
  EXPECT_DOUBLE_EQ(frames[2].exposure.time.seconds(), 0.002);
  // The phase follows from the trigger's number, as it will after a restart.
  EXPECT_DOUBLE_EQ(NextExposure(), 0.008);
}

TEST_F(Reload, AWrongConfigurationIsRefusedWholeAndTheOldOneStays) {
  Start();
  ASSERT_TRUE(InState("armed"));
  FileHas([](DaemonConfig& c) {
    // The camera's longest is 10 s: only it can say so.
    c.bracket.exposures_s = {20.0};
    c.trigger.limit = 1;
  });
  const auto refused = Client().Post("/v1/reload");
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kConfig);
  EXPECT_THAT(refused.error().message, HasSubstr("the camera's longest is 10 s"));
  EXPECT_DOUBLE_EQ(NextExposure(), 0.001);
  // trigger.limit came with it and is not in force either.
  Trigger(2);
  FileIsWrong("omnihdr.toml:3: log.level: 7, expected one of those\nomnihdr.toml:4: no TOML");
  EXPECT_THAT(Client().Post("/v1/reload").error().message, HasSubstr("log.level: 7"));
  const nlohmann::json config = Client().Get("/v1/status").value()["config"];
  EXPECT_EQ(config["reloads"], 0);
  EXPECT_EQ(config["reloads_refused"], 2);
  EXPECT_THAT(config["error"].get<std::string>(), HasSubstr("one of those; omnihdr.toml:4"));
}

TEST_F(Reload, KeysThatNeedARestartAreNamedUntilTheFileHasTheirOldValue) {
  Start();
  ASSERT_TRUE(InState("armed"));
  FileHas([](DaemonConfig& c) { c.recorder.queue_frames = 99; });
  EXPECT_EQ(Client().Post("/v1/reload").value()["restart_needed"],
            nlohmann::json::array({"recorder.queue_frames"}));
  const nlohmann::json status = Client().Get("/v1/status").value();
  EXPECT_EQ(status["buffers"]["of"], 8);
  EXPECT_EQ(status["config"]["restart_needed"].size(), 1U);
  EXPECT_THAT(StatusForPeople(status), HasSubstr("needed for recorder.queue_frames"));
  FileHas([](DaemonConfig& c) { c.recorder.queue_frames = 8; });
  EXPECT_TRUE(Client().Post("/v1/reload").value()["restart_needed"].empty());
}

TEST_F(Reload, ALimitThatIsReachedAlreadyEndsTheSeries) {
  Start();
  ASSERT_TRUE(InState("armed"));
  Trigger(2);
  FileHas([](DaemonConfig& c) { c.trigger.limit = 2; });
  EXPECT_TRUE(Client().Post("/v1/reload"));
  ASSERT_TRUE(StatusHolds([](const auto& s) { return s["session"]["ended"] == true; }));
}

TEST_F(Reload, WithoutAFileThereIsNothingToReload) {
  read_config_ = {};
  Start();
  EXPECT_THAT(Client().Post("/v1/reload").error().message, HasSubstr("no file"));
}

}  // namespace
}  // namespace omnihdr::reload_test
