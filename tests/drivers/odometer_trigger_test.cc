#include "drivers/trigger/odometer_trigger.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>
#include <poll.h>

#include <chrono>
#include <cmath>
#include <memory>
#include <vector>

#include "core/capture/motion_track.h"

namespace omnihdr::odometer_trigger_test {
namespace {

using std::chrono::milliseconds;
using ::testing::HasSubstr;

class ManualClock final : public Clock {
 public:
  HostTime Now() const override { return now; }
  UtcTime NowUtc() const override { return UtcTime::FromNanoseconds(now.ns()); }
  void Set(double seconds) { now = At(seconds); }
  static HostTime At(double seconds) {
    return HostTime::FromNanoseconds(static_cast<std::int64_t>(std::llround(seconds * 1e9)));
  }
  HostTime now = At(100.0);
};

class ToldOdometer final : public Odometer {
 public:
  void Tell(double seconds, double metres) {
    track.Add(ManualClock::At(seconds), metres);
    if (listener) listener();
  }
  std::optional<double> OdometerMetres(HostTime at) const override { return track.At(at); }
  std::optional<HostTime> TimeAt(double metres) const override { return track.TimeAt(metres); }
  void Listen(std::function<void()> to) override { listener = std::move(to); }
  std::uint64_t lost() const override { return lost_readings; }

  MotionTrack track{
      MotionTrackOptions{512, std::chrono::seconds(1), true, std::chrono::seconds(1)}};
  std::function<void()> listener;
  std::uint64_t lost_readings = 0;
};

struct Bench {
  explicit Bench(double distance_m) {
    options.distance_m = distance_m;
    trigger = std::make_unique<OdometerTrigger>(options, odometer, clock);
  }
  std::vector<TriggerEvent> Events() {
    std::vector<TriggerEvent> events;
    while (const auto event = *trigger->Poll()) events.push_back(*event);
    return events;
  }
  ManualClock clock;
  std::shared_ptr<ToldOdometer> odometer = std::make_shared<ToldOdometer>();
  OdometerTriggerOptions options;
  std::unique_ptr<OdometerTrigger> trigger;
};

TEST(OdometerTrigger, EveryMarkThatIsPassedIsAnEventWithItsOwnTimeAndPlace) {
  Bench bench(0.5);
  bench.odometer->Tell(100.0, 10.2);
  ASSERT_TRUE(bench.trigger->Start());
  EXPECT_TRUE(bench.Events().empty());
  bench.clock.Set(100.5);
  bench.odometer->Tell(100.5, 11.2);
  pollfd ready{bench.trigger->fd(), POLLIN, 0};
  EXPECT_EQ(poll(&ready, 1, 0), 1);
  const std::vector<TriggerEvent> events = bench.Events();
  ASSERT_EQ(events.size(), 2U);
  EXPECT_EQ(*events[0].odometer_m, 10.5);
  EXPECT_EQ(*events[1].odometer_m, 11.0);
  EXPECT_NEAR(static_cast<double>((events[0].time - ManualClock::At(100.15)).count()), 0.0, 1e3);
  EXPECT_EQ(poll(&ready, 1, 0), 0);
}

TEST(OdometerTrigger, APulseThatLiesOnAMarkPassesItHoweverTheMarkIsRounded) {
  constexpr double kDistance = 0.05;
  Bench bench(kDistance);
  bench.odometer->track =
      MotionTrack(MotionTrackOptions{512, std::chrono::seconds(1), false, std::chrono::seconds(1)});
  bench.odometer->Tell(100.0, 0.02);
  ASSERT_TRUE(bench.trigger->Start());
  for (int pulse = 3; pulse <= 5000; ++pulse) {
    const double seconds = 100.0 + 0.01 * pulse;
    bench.clock.Set(seconds);
    bench.odometer->Tell(seconds, pulse / 100.0);
    ASSERT_EQ(bench.Events().size(), pulse % 5 == 0 ? 1U : 0U) << "pulse " << pulse;
  }
}

TEST(OdometerTrigger, AMarkAheadHasADeadlineAtThePresentSpeed) {
  Bench bench(1.0);
  bench.odometer->Tell(99.9, 10.0);
  bench.odometer->Tell(100.0, 10.2);
  ASSERT_TRUE(bench.trigger->Start());
  ASSERT_TRUE(bench.trigger->NextDeadline());
  EXPECT_NEAR(
      static_cast<double>((*bench.trigger->NextDeadline() - bench.clock.now).count()) * 1e-9, 0.4,
      1e-6);
  bench.clock.Set(100.41);
  ASSERT_EQ(bench.Events().size(), 1U);
}

TEST(OdometerTrigger, TheStartingPlaceCountsWhenItIsAMarkHoweverLongTheVehicleHasStoodThere) {
  Bench bench(1.0);
  for (int i = 0; i < 100; ++i) bench.odometer->Tell(50.0 + 0.5 * i, 3.0);
  bench.clock.Set(99.6);
  ASSERT_TRUE(bench.trigger->Start());
  const std::vector<TriggerEvent> events = bench.Events();
  ASSERT_EQ(events.size(), 1U);
  EXPECT_EQ(events[0].time, bench.clock.now);
  EXPECT_EQ(events[0].lost_before, 0U);
  EXPECT_TRUE(events[0].standing);
  bench.clock.Set(100.2);
  bench.odometer->Tell(100.2, 4.1);
  const std::vector<TriggerEvent> driven = bench.Events();
  ASSERT_EQ(driven.size(), 1U);
  EXPECT_FALSE(driven[0].standing) << "a mark that was driven to";
}

TEST(OdometerTrigger, AStartBetweenTwoMarksIsNoMarkOfStanding) {
  Bench bench(1.0);
  bench.odometer->Tell(100.0, 0.5);
  ASSERT_TRUE(bench.trigger->Start());
  bench.clock.Set(100.5);
  bench.odometer->Tell(100.5, 1.2);
  const std::vector<TriggerEvent> events = bench.Events();
  ASSERT_EQ(events.size(), 1U);
  EXPECT_FALSE(events[0].standing);
}

TEST(OdometerTrigger, AMarkThatIsDrivenOverToAndFroCountsOnce) {
  Bench bench(1.0);
  bench.odometer->Tell(100.0, 0.5);
  ASSERT_TRUE(bench.trigger->Start());
  int events = 0;
  double time = 100.0;
  for (const double place : {1.2, 0.7, 1.3, 0.2, 1.4, 2.1}) {
    time += 0.3;
    bench.clock.Set(time);
    bench.odometer->Tell(time, place);
    events += static_cast<int>(bench.Events().size());
  }
  EXPECT_EQ(events, 2);
}

TEST(OdometerTrigger, MarksToldOfTooLateAreLostWithTheReasonAndTheNextOneIsTaken) {
  Bench bench(1.0);
  bench.odometer->Tell(100.0, 0.5);
  ASSERT_TRUE(bench.trigger->Start());
  EXPECT_TRUE(bench.Events().empty());
  bench.clock.Set(110.0);  // ten metres while nothing was heard
  bench.odometer->lost_readings = 3;
  bench.odometer->Tell(110.0, 10.5);
  const std::vector<TriggerEvent> events = bench.Events();
  ASSERT_EQ(events.size(), 1U);
  EXPECT_EQ(*events[0].odometer_m, 10.0);
  EXPECT_EQ(events[0].lost_before, 9U);
  EXPECT_THAT(events[0].lost_reason, HasSubstr("more than 1000 ms after it was passed"));
  EXPECT_THAT(events[0].lost_reason, HasSubstr("readings lost: 3"));
}

TEST(OdometerTrigger, MarksThatAreTooLateAreOwedUntilTheyAreTakenOrTold) {
  Bench bench(1.0);
  bench.odometer->Tell(100.0, 0.5);
  ASSERT_TRUE(bench.trigger->Start());
  EXPECT_TRUE(bench.Events().empty());
  bench.odometer->Tell(102.0, 3.5);
  bench.odometer->Tell(102.6, 3.5);
  bench.clock.Set(103.2);  // marks 1, 2 and 3 were passed before 102, where it has stood since
  EXPECT_TRUE(bench.Events().empty());
  const LostEvents lost = bench.trigger->TakeLost();
  EXPECT_EQ(lost.count, 3U);
  EXPECT_THAT(lost.reason, HasSubstr("more than 1000 ms"));
  EXPECT_EQ(bench.trigger->TakeLost().count, 0U);
}

TEST(OdometerTrigger, AnOdometerThatJumpsFarCostsNoTimeAndEveryMarkIsAccountedFor) {
  Bench bench(0.001);
  bench.odometer->Tell(100.0, 0.0);
  ASSERT_TRUE(bench.trigger->Start());
  EXPECT_EQ(bench.Events().size(), 1U);
  bench.clock.Set(100.5);
  bench.odometer->Tell(100.5, 1e6);
  std::uint64_t accounted = 0;
  for (const TriggerEvent& event : bench.Events()) accounted += 1 + event.lost_before;
  EXPECT_EQ(accounted, 1'000'000'000U);
}

TEST(OdometerTrigger, ItWaitsForTheFirstReadingAndMarksPassedWhileStoppedAreNotCounted) {
  Bench bench(1.0);
  ASSERT_TRUE(bench.trigger->Start());
  EXPECT_TRUE(bench.Events().empty());
  EXPECT_FALSE(bench.trigger->NextDeadline());
  bench.odometer->Tell(100.0, 5.0);
  EXPECT_EQ(bench.Events().size(), 1U);
  bench.trigger->Stop();
  EXPECT_FALSE(bench.odometer->listener);
  bench.clock.Set(100.9);
  bench.odometer->Tell(100.9, 8.5);
  ASSERT_TRUE(bench.trigger->Start());
  EXPECT_TRUE(bench.Events().empty());
  bench.clock.Set(101.1);
  bench.odometer->Tell(101.1, 9.1);
  ASSERT_EQ(bench.Events().size(), 1U);
}

TEST(OdometerTrigger, ADistanceOutOfRangeIsRefused) {
  Bench bench(0.0);
  const Status started = bench.trigger->Start();
  ASSERT_FALSE(started);
  EXPECT_THAT(started.error().message, HasSubstr("distance_m: 0: expected 0.001 to 10000"));
}

}  // namespace
}  // namespace omnihdr::odometer_trigger_test
