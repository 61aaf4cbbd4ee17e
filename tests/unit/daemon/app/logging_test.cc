#include "daemon/logging.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <thread>

namespace omnihdr::logging_test {
namespace {

using ::testing::Contains;
using ::testing::ElementsAre;

TEST(JournalEntry, HasTheTextItsPriorityAndTheFieldsThatAreKnown) {
  EXPECT_THAT(JournalEntry(6, "armed", {}),
              ElementsAre("MESSAGE=armed", "PRIORITY=6", "SYSLOG_IDENTIFIER=omnihdrd"));
  LogFields fields;
  fields.session = "/data/s";
  fields.trigger = 7;
  fields.position = 3;
  fields.stage = "recorder";
  fields.error = "disk-full";
  EXPECT_THAT(
      JournalEntry(4, "trigger 7: disk-full: one\ntwo", fields),
      ElementsAre("MESSAGE=trigger 7: disk-full: one\ntwo", "PRIORITY=4",
                  "SYSLOG_IDENTIFIER=omnihdrd", "OMNIHDR_SESSION=/data/s", "OMNIHDR_TRIGGER=7",
                  "OMNIHDR_POSITION=3", "OMNIHDR_STAGE=recorder", "OMNIHDR_ERROR=disk-full"));
}

TEST(LogContext, FieldsHoldInTheirThreadWhileTheContextLives) {
  const LogContext stage({.stage = "recorder"});
  {
    const LogContext about({.trigger = 7, .stage = "sync"});
    EXPECT_EQ(LogContext::Current().stage, "sync");
    EXPECT_EQ(LogContext::Current().trigger, 7U);
    std::thread other([] { EXPECT_EQ(LogContext::Current().stage, ""); });
    other.join();
  }
  EXPECT_EQ(LogContext::Current().stage, "recorder");
  EXPECT_FALSE(LogContext::Current().trigger);
}

TEST(LogContext, EveryLineIsAboutTheSessionAtHand) {
  SetLogSession("/data/s");
  EXPECT_EQ(LogContext::Current().session, "/data/s");
  {
    const LogContext other({.session = "/data/before"});
    EXPECT_EQ(LogContext::Current().session, "/data/before");
  }
  SetLogSession("");
  EXPECT_EQ(LogContext::Current().session, "");
}

}  // namespace
}  // namespace omnihdr::logging_test
