#include "daemon/session_rotation.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>

#include "daemon/session_choice.h"
#include "daemon/survey_volume.h"
#include "tests/support/temporary_directory.h"

namespace omnihdr::session_rotation_test {
namespace {

namespace fs = std::filesystem;
using ::testing::ElementsAre;
using ::testing::HasSubstr;

// 2026-01-02T03:04:05Z
const UtcTime kNow = UtcTime::FromNanoseconds(1'767'323'045'000'000'000);

class Series : public ::testing::Test {
 protected:
  // A session that goes on from another one, or from none.
  fs::path MakeSession(const std::string& name, const std::string& from = "", bool ended = false) {
    const fs::path path = root() / name;
    fs::create_directories(path);
    const std::string continues =
        from.empty() ? "" : R"(, "continues": {"session": ")" + from + R"(", "first_frame": 10})";
    std::ofstream(path / "session.json")
        << R"({"format": "omnihdr-session", "version": 1, "created": "2026-01-01T00:00:00Z",
 "camera": {"model": "m", "serial": "s", "bits": 8, "layout": "panorama",
 "projection": "equirectangular", "width": 128, "height": 64},
 "response": {"model": "linear"})"
        << continues << "}";
    EXPECT_TRUE(!ended || MarkSessionEnded(path, 3, kNow));
    return path;
  }
  fs::path root() const { return directory_.path(); }

 private:
  testing::TemporaryDirectory directory_;
};

TEST_F(Series, ASessionEndsWhenAnyLimitIsReachedAndSaysWhich) {
  const HostTime begin = HostTime::FromNanoseconds(0);
  const HostTime later = begin + Nanoseconds(std::chrono::hours(2));
  const SessionExtent extent{1'500'000'000, 40, begin};
  EXPECT_FALSE(WhyRotate({}, extent, later));
  EXPECT_FALSE(WhyRotate({1.6, 41, 2.1}, extent, later));
  EXPECT_THAT(*WhyRotate({1.5, 0, 0.0}, extent, later), HasSubstr("session.rotate_gb is 1.5"));
  EXPECT_THAT(*WhyRotate({0.0, 40, 0.0}, extent, later), HasSubstr("rotate_positions is 40"));
  EXPECT_THAT(*WhyRotate({0.0, 0, 2.0}, extent, later), HasSubstr("session.rotate_hours is 2"));
}

TEST_F(Series, TheNextDirectoryIsNamedAfterTheTimeOrCountedOn) {
  const auto next = [&](const std::string& name) {
    return NextSessionDirectory(root() / name, kNow).value().filename().string();
  };
  EXPECT_EQ(next("20260101T000000Z"), "20260102T030405Z");
  fs::create_directories(root() / "20260102T030405Z");
  EXPECT_EQ(next("20260102T030405Z"), "20260102T030406Z");
  EXPECT_EQ(next("survey"), "survey-2");
  MakeSession("survey-2", "survey");
  EXPECT_EQ(next("survey-2"), "survey-3");
  // Its owner's own number.
  MakeSession("drive-7");
  EXPECT_EQ(next("drive-7"), "drive-7-2");
}

TEST_F(Series, WhatASessionGoesOnFromStandsInItsSessionJson) {
  SessionInfo info;
  info.extra_json = R"({"simulation": {"seed": 1}})";
  EXPECT_FALSE(ContinuationOf(info));
  info.extra_json = WithContinuation(info.extra_json, {"survey", 1234});
  EXPECT_THAT(info.extra_json, HasSubstr("simulation"));
  EXPECT_EQ(ContinuationOf(info)->session, "survey");
  EXPECT_EQ(ContinuationOf(info)->first_frame, 1234U);
  for (const char* wrong : {R"({"continues": {"session": "../x", "first_frame": 1}})",
                            R"({"continues": {"session": "x", "first_frame": -1}})",
                            R"({"continues": 5})", "", "nonsense"}) {
    info.extra_json = wrong;
    EXPECT_FALSE(ContinuationOf(info)) << wrong;
  }
}

TEST_F(Series, TheNewestOfASeriesGoesOnAndTheUnfinishedBeforeItAreFound) {
  MakeSession("s", "", true);
  MakeSession("s-2", "s");
  MakeSession("s-3", "s-2");
  EXPECT_EQ(NewestOfSeries(root() / "s"), root() / "s-3");
  EXPECT_THAT(UnfinishedBefore(root() / "s-3"), ElementsAre(root() / "s-2"));
  EXPECT_THAT(UnfinishedBefore(root() / "s"), ElementsAre());
  SessionConfig config;
  config.directory = root().string();
  config.name = "s";
  EXPECT_EQ(ChooseSession(config, "", kNow)->directory, root() / "s-3");
  // A circle has an end.
  MakeSession("a", "b");
  MakeSession("b", "a");
  EXPECT_THAT(UnfinishedBefore(root() / "a"), ElementsAre(root() / "b"));
}

TEST_F(Series, TheRootFileSystemIsRefusedUnlessAllowed) {
  const Status refused = CheckSurveyVolume("/no/such/directory", false);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kConfig);
  EXPECT_THAT(refused.error().message, HasSubstr("storage.allow_root = true"));
  EXPECT_TRUE(CheckSurveyVolume("/no/such/directory", true));
  // Another file system than that of "/" wherever there is a /proc.
  if (fs::exists("/proc/self")) {
    EXPECT_TRUE(CheckSurveyVolume("/proc/survey", false));
    // Which tells no size: unknown is an error.
    const auto space = ReadVolume("/proc");
    ASSERT_FALSE(space);
    EXPECT_THAT(space.error().message, HasSubstr("/proc: "));
  }
  EXPECT_GT(ReadVolume(root()).value().total_bytes, 0U);
}

}  // namespace
}  // namespace omnihdr::session_rotation_test
