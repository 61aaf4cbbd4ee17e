#include "daemon/system_utc.h"

#include <gtest/gtest.h>
#include <sys/timex.h>

namespace omnihdr::system_utc_test {
namespace {

TEST(SystemUtc, AClockThatNobodyKeepsIsFreeAndHasNoBound) {
  const UtcQuality unsynchronised = InterpretAdjtimex(TIME_ERROR, STA_UNSYNC, 16'000'000, 0);
  EXPECT_FALSE(unsynchronised.synchronised);
  EXPECT_FALSE(unsynchronised.error_s);
  EXPECT_FALSE(unsynchronised.tai_offset_s);
  EXPECT_FALSE(InterpretAdjtimex(-1, 0, 0, 0).synchronised) << "the kernel did not answer";
}

TEST(SystemUtc, AKeptClockHasABoundAndPerhapsALeapSecondCount) {
  const UtcQuality kept = InterpretAdjtimex(TIME_OK, STA_PLL, 2500, 37);
  EXPECT_TRUE(kept.synchronised);
  EXPECT_DOUBLE_EQ(*kept.error_s, 0.0025);
  EXPECT_EQ(kept.tai_offset_s, 37);
  // In the second that a leap second is inserted the clock is as good as before.
  EXPECT_TRUE(InterpretAdjtimex(TIME_OOP, STA_PLL | STA_INS, 2500, 37).synchronised);
}

TEST(SystemUtc, ThisMachineAnswers) {
  const SystemUtc utc;
  const UtcQuality quality = utc.Quality();
  EXPECT_EQ(quality.synchronised, quality.error_s.has_value());
}

}  // namespace
}  // namespace omnihdr::system_utc_test
