#include "tests/soak/soak_judge.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace omnihdr::soak_judge_test {
namespace {

using soak::Judge;
using soak::SoakResult;
using ::testing::ElementsAre;
using ::testing::HasSubstr;
using ::testing::IsEmpty;

// A flat day of one trigger every four seconds.
SoakResult FlatDay() {
  SoakResult day;
  day.interval_s = 4.0;
  for (int i = 0; i < 240; ++i) {
    day.samples.push_back({0.1 * i, i < 10 ? 60.0 + i : 80.0, 13.0, 15.0});
    day.latencies.push_back({0.1 * i, 0.5, 2.0});
  }
  for (int i = 0; i < 1000; ++i) {
    FrameRecord record;
    record.frame = FrameId{static_cast<std::uint64_t>(i)};
    record.trigger_time = HostTime::FromNanoseconds(4'000'000'000LL * i);
    day.journal.push_back(record);
  }
  return day;
}

TEST(SoakJudge, AFlatDayIsFineWhateverItsFirstMinutesTake) {
  EXPECT_THAT(Judge(FlatDay()), IsEmpty());
}

TEST(SoakJudge, WhatGrowsIsNamed) {
  SoakResult day = FlatDay();
  for (std::size_t i = 0; i < day.samples.size(); ++i) {
    day.samples[i].memory_mb += 0.2 * static_cast<double>(i);
  }
  EXPECT_THAT(Judge(day), ElementsAre(HasSubstr("memory, MB grows: 98 in the second quarter")));
  day = FlatDay();
  for (std::size_t i = 0; i < day.samples.size(); ++i) {
    day.samples[i].descriptors += static_cast<double>(i / 24);
  }
  EXPECT_THAT(Judge(day), ElementsAre(HasSubstr("descriptors grows")));
  day = FlatDay();
  for (std::size_t i = 120; i < day.latencies.size(); ++i) day.latencies[i].median_ms = 5.0;
  EXPECT_THAT(Judge(day), ElementsAre(HasSubstr("latency, ms grows")));
}

TEST(SoakJudge, ATriggerWithoutALineIsMissed) {
  SoakResult day = FlatDay();
  day.journal.erase(day.journal.begin() + 500);
  for (std::size_t i = 500; i < day.journal.size(); ++i) day.journal[i].frame = FrameId{i};
  EXPECT_THAT(Judge(day), ElementsAre("1000 triggers were due, 999 have a line and 0 are counted"));
  day.unlisted = 1;
  EXPECT_THAT(Judge(day), IsEmpty());
}

TEST(SoakJudge, ALossWithoutItsReasonIsSilent) {
  SoakResult day = FlatDay();
  day.journal[7].status = FrameStatus::kCameraTimeout;
  EXPECT_THAT(Judge(day), ElementsAre("1 frames lost without a reason"));
  day.journal[7].detail = "why";
  EXPECT_THAT(Judge(day), IsEmpty());
}

TEST(SoakJudge, EveryMissHasItsCauseAndOneThatNobodyMadeIsAProblem) {
  SoakResult day = FlatDay();
  const auto miss = [&](int line, const char* detail) {
    day.journal[static_cast<std::size_t>(line)].status = FrameStatus::kMissedTrigger;
    day.journal[static_cast<std::size_t>(line)].detail = detail;
  };
  day.troubles = {{day.journal[100].trigger_time, day.journal[120].trigger_time}};
  const char* full = "no free frame buffer: the storage is slower than the triggers";
  for (const int line : {99, 100, 149, 151}) miss(line, full);
  miss(200, "no camera: simulated camera: not there: vanished at trigger 199");
  miss(201, "simulated camera: busy: 4 pictures are on their way");
  miss(202, "the trigger source lost this event before it was read");
  const soak::MissCauses causes = soak::CausesOf(day);
  EXPECT_EQ(causes.storage, 2) << "the time until what waited is stored belongs to the trouble";
  EXPECT_EQ(causes.unplugged, 1);
  EXPECT_EQ(causes.slow, 4);
  EXPECT_THAT(Judge(day), IsEmpty());
  miss(203, "no reason that is known");
  EXPECT_THAT(Judge(day), ElementsAre("1 triggers missed for a reason that nobody made: no reason "
                                      "that is known"));
}

TEST(SoakJudge, AComputerThatIsTooSlowForTheDayIsTold) {
  SoakResult day = FlatDay();
  for (std::size_t i = 0; i < 201; ++i) {
    day.journal[i].status = FrameStatus::kMissedTrigger;
    day.journal[i].detail = "simulated camera: busy: 4 pictures are on their way";
  }
  EXPECT_THAT(Judge(day), ElementsAre(HasSubstr("201 of 1000 triggers missed because this "
                                                "computer is too slow")));
}

}  // namespace
}  // namespace omnihdr::soak_judge_test
