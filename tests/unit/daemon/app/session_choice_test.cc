#include "daemon/session_choice.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <fstream>

#include "tests/support/temporary_directory.h"

namespace omnihdr::session_choice_test {
namespace {

namespace fs = std::filesystem;
using ::testing::HasSubstr;

// 2026-01-02T03:04:05Z
const UtcTime kNow = UtcTime::FromNanoseconds(1'767'323'045'000'000'000);

class Choice : public ::testing::Test {
 protected:
  Choice() { config_.directory = directory_.path().string(); }
  fs::path MakeSession(const std::string& name, bool ended = false) {
    const fs::path path = directory_.path() / name;
    fs::create_directories(path);
    std::ofstream(path / "session.json") << "{}";
    EXPECT_TRUE(!ended || MarkSessionEnded(path, 3, kNow));
    return path;
  }
  testing::TemporaryDirectory directory_;
  SessionConfig config_;
};

TEST_F(Choice, TimesAreUtc) {
  EXPECT_EQ(CompactUtc(kNow), "20260102T030405Z");
  EXPECT_EQ(IsoUtc(kNow), "2026-01-02T03:04:05Z");
}

TEST_F(Choice, WithoutANameANewSessionIsCalledAfterTheTime) {
  const SessionChoice choice = ChooseSession(config_, "", kNow).value();
  EXPECT_EQ(choice.directory, directory_.path() / "20260102T030405Z");
  EXPECT_FALSE(choice.exists);
}

TEST_F(Choice, WithoutANameTheNewestOpenSessionOfOurOwnGoesOn) {
  MakeSession("20250101T000000Z");
  const fs::path newest = MakeSession("20250601T000000Z");
  MakeSession("20251231T000000Z", true);
  MakeSession("zzz-somebody-elses");
  fs::create_directories(directory_.path() / "20259999T000000Z");
  const SessionChoice choice = ChooseSession(config_, "", kNow).value();
  EXPECT_EQ(choice.directory, newest);
  EXPECT_TRUE(choice.exists);
  EXPECT_FALSE(choice.ended);
  config_.on_existing = OnExistingSession::kRefuse;
  EXPECT_EQ(ChooseSession(config_, "", kNow)->directory, directory_.path() / "20260102T030405Z");
}

TEST_F(Choice, TheCommandLineOverridesTheConfiguration) {
  config_.name = "configured";
  EXPECT_EQ(ChooseSession(config_, "", kNow)->directory, directory_.path() / "configured");
  EXPECT_EQ(ChooseSession(config_, "asked", kNow)->directory, directory_.path() / "asked");
  const std::string elsewhere = (directory_.path() / "else" / "where").string();
  EXPECT_EQ(ChooseSession(config_, elsewhere + "/", kNow)->directory, elsewhere);
}

TEST_F(Choice, AnEndedSessionIsKnownAsSuch) {
  MakeSession("done", true);
  const SessionChoice choice = ChooseSession(config_, "done", kNow).value();
  EXPECT_TRUE(choice.exists);
  EXPECT_TRUE(choice.ended);
}

TEST_F(Choice, AnExistingSessionIsRefusedWhenSoConfigured) {
  MakeSession("old");
  config_.on_existing = OnExistingSession::kRefuse;
  const auto refused = ChooseSession(config_, "old", kNow);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kCannotCreate);
  EXPECT_THAT(refused.error().message, HasSubstr("exists already"));
}

TEST_F(Choice, ASessionThatCouldNotBeWrittenIsRefusedAtOnce) {
  std::ofstream(directory_.path() / "file") << "x";
  config_.directory = (directory_.path() / "file" / "sessions").string();
  const auto refused = ChooseSession(config_, "new", kNow);
  ASSERT_FALSE(refused);
  EXPECT_EQ(refused.error().kind, ErrorKind::kCannotCreate);
  EXPECT_THAT(refused.error().message, HasSubstr("file"));
}

}  // namespace
}  // namespace omnihdr::session_choice_test
