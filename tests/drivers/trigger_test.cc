#include <gtest/gtest.h>
#include <poll.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <thread>
#include <vector>

#include "drivers/sim/sim_vehicle.h"
#include "drivers/trigger/software_trigger.h"
#include "drivers/trigger/timer_trigger.h"

namespace omnihdr::trigger_test {
namespace {

using std::chrono::milliseconds;

class ManualClock final : public Clock {
 public:
  HostTime Now() const override { return HostTime::FromNanoseconds(now_ns.load()); }
  UtcTime NowUtc() const override { return UtcTime::FromNanoseconds(now_ns.load()); }
  void Advance(double seconds) { now_ns += static_cast<std::int64_t>(seconds * 1e9); }
  std::atomic<std::int64_t> now_ns{1'000'000'000};
};

bool Readable(int fd, int timeout_ms) {
  pollfd p{fd, POLLIN, 0};
  return poll(&p, 1, timeout_ms) == 1 && (p.revents & POLLIN) != 0;
}

TEST(DistanceTrigger, AnotherDistanceCountsFromWhereTheVehicleIs) {
  ManualClock clock;
  const auto vehicle = std::make_shared<sim::SimVehicle>(sim::VehicleOptions{1.0, 0.0, 0.0}, clock);
  sim::DistanceTrigger trigger({0.5, 0}, vehicle, clock);
  ASSERT_TRUE(trigger.Start());
  clock.Advance(1.1);
  while (*trigger.Poll()) {
  }
  ASSERT_TRUE(trigger.SetDistance(0.2));
  EXPECT_FALSE(trigger.Poll()->has_value());
  clock.Advance(0.35);  // 1.45 m
  EXPECT_NEAR(*trigger.Poll().value()->odometer_m, 1.2, 1e-9);
  EXPECT_NEAR(*trigger.Poll().value()->odometer_m, 1.4, 1e-9);
  EXPECT_FALSE(trigger.SetDistance(0.0));
}

TEST(TimerTrigger, AnotherIntervalCountsFromTheLastEvent) {
  TimerTrigger trigger({3600.0, 0});
  ASSERT_TRUE(trigger.Start());
  ASSERT_TRUE(Readable(trigger.fd(), 5000));
  const HostTime first = trigger.Poll().value()->time;
  ASSERT_TRUE(trigger.SetInterval(0.05));
  ASSERT_TRUE(Readable(trigger.fd(), 5000));
  const auto second = trigger.Poll().value();
  ASSERT_TRUE(second);
  EXPECT_GE(second->time - first, milliseconds(50));
  EXPECT_LT(second->time - first, std::chrono::seconds(60));
  EXPECT_FALSE(trigger.SetInterval(0.0));
}

TEST(DistanceTrigger, AnEventComesAtEveryMarkWithItsTimeAndPlaceHoweverLateItIsPolled) {
  ManualClock clock;
  const auto vehicle = std::make_shared<sim::SimVehicle>(sim::VehicleOptions{2.0, 0.0, 0.0}, clock);
  sim::DistanceTrigger trigger({0.5, 0}, vehicle, clock);
  EXPECT_FALSE(trigger.Poll()->has_value());
  ASSERT_TRUE(trigger.Start());
  const HostTime start = clock.Now();
  clock.Advance(1.1);  // 2.2 m
  std::vector<double> places;
  while (const auto event = *trigger.Poll()) {
    places.push_back(*event->odometer_m);
    EXPECT_NEAR(static_cast<double>((event->time - start).count()) * 1e-9, *event->odometer_m / 2.0,
                1e-6);
    EXPECT_EQ(event->lost_before, 0U);
  }
  EXPECT_EQ(places, (std::vector<double>{0.0, 0.5, 1.0, 1.5, 2.0}));
  ASSERT_TRUE(trigger.NextDeadline());
  EXPECT_NEAR(static_cast<double>((*trigger.NextDeadline() - start).count()) * 1e-9, 1.25, 1e-6);
}

TEST(DistanceTrigger, TheVehicleStandsWhileTheTriggerIsStoppedAndNoMarkIsTakenTwice) {
  ManualClock clock;
  const auto vehicle = std::make_shared<sim::SimVehicle>(sim::VehicleOptions{1.0, 0.0, 0.0}, clock);
  sim::DistanceTrigger trigger({1.0, 0}, vehicle, clock);
  ASSERT_TRUE(trigger.Start());
  clock.Advance(1.5);
  EXPECT_TRUE(trigger.Poll()->has_value());
  EXPECT_TRUE(trigger.Poll()->has_value());
  trigger.Stop();
  clock.Advance(10.0);
  EXPECT_NEAR(*vehicle->OdometerMetres(clock.Now()), 1.5, 1e-9);
  ASSERT_TRUE(trigger.Start());
  EXPECT_FALSE(trigger.Poll()->has_value());
  clock.Advance(0.6);
  EXPECT_NEAR((*trigger.Poll())->odometer_m.value(), 2.0, 1e-9);
}

TEST(DistanceTrigger, AVehicleThatStartsFurtherOnBeginsAtTheNextMark) {
  ManualClock clock;
  const auto vehicle = std::make_shared<sim::SimVehicle>(sim::VehicleOptions{1.0, 1.4, 0.0}, clock);
  sim::DistanceTrigger trigger({0.5, 0}, vehicle, clock);
  ASSERT_TRUE(trigger.Start());
  clock.Advance(0.2);
  EXPECT_NEAR((*trigger.Poll())->odometer_m.value(), 1.5, 1e-9);
}

TEST(DistanceTrigger, ItIsExhaustedAtItsLimitAndAtTheEndOfTheWay) {
  ManualClock clock;
  const auto endless = std::make_shared<sim::SimVehicle>(sim::VehicleOptions{1.0, 0.0, 0.0}, clock);
  sim::DistanceTrigger limited({1.0, 2}, endless, clock);
  const auto short_way =
      std::make_shared<sim::SimVehicle>(sim::VehicleOptions{1.0, 0.0, 2.5}, clock);
  sim::DistanceTrigger ended({1.0, 0}, short_way, clock);
  ASSERT_TRUE(limited.Start());
  ASSERT_TRUE(ended.Start());
  clock.Advance(100.0);
  int limited_events = 0;
  while (limited.Poll()->has_value()) ++limited_events;
  int ended_events = 0;
  while (ended.Poll()->has_value()) ++ended_events;
  EXPECT_EQ(limited_events, 2);
  EXPECT_EQ(ended_events, 3);
  EXPECT_TRUE(limited.exhausted());
  EXPECT_TRUE(ended.exhausted());
  EXPECT_FALSE(limited.NextDeadline());
  EXPECT_NEAR(*short_way->OdometerMetres(clock.Now()), 2.5, 1e-9);
}

TEST(TimerTrigger, ItFiresAtOnceAndThenAtItsIntervalAndCountsWhatWasMissed) {
  TimerTrigger trigger({0.02, 0});
  ASSERT_TRUE(trigger.Start());
  ASSERT_TRUE(Readable(trigger.fd(), 1000));
  const auto first = *trigger.Poll();
  ASSERT_TRUE(first);
  std::this_thread::sleep_for(milliseconds(90));
  const auto late = *trigger.Poll();
  ASSERT_TRUE(late);
  EXPECT_GE(late->lost_before, 2U);
  // Times lie on the timer's raster, not on that of the polls.
  EXPECT_EQ((late->time - first->time).count(),
            static_cast<std::int64_t>(late->lost_before + 1) * 20'000'000);
  EXPECT_FALSE(trigger.Poll()->has_value());
}

TEST(TimerTrigger, AtItsLimitItIsExhaustedAndItsDescriptorIsGone) {
  TimerTrigger trigger({0.001, 3});
  ASSERT_TRUE(trigger.Start());
  std::uint64_t events = 0;
  for (int i = 0; i < 200 && !trigger.exhausted(); ++i) {
    if (const auto event = *trigger.Poll()) events += 1 + event->lost_before;
    std::this_thread::sleep_for(milliseconds(1));
  }
  EXPECT_EQ(events, 3U);
  EXPECT_TRUE(trigger.exhausted());
  EXPECT_EQ(trigger.fd(), -1);
}

TEST(TimerTrigger, AnIntervalOutOfRangeIsRefused) {
  TimerTrigger trigger({0.0, 0});
  const Status status = trigger.Start();
  ASSERT_FALSE(status);
  EXPECT_EQ(status.error().kind, ErrorKind::kConfig);
}

TEST(SoftwareTrigger, EveryRequestFromAnyThreadComesOutOnce) {
  SoftwareTrigger trigger;
  ASSERT_TRUE(trigger.Start());
  std::atomic<int> fired{0};
  std::vector<std::thread> threads;
  for (int t = 0; t < 3; ++t) {
    threads.emplace_back([&] {
      for (int i = 0; i < 15; ++i) {
        if (trigger.Fire()) ++fired;
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  EXPECT_EQ(fired, 45);
  int polled = 0;
  while (Readable(trigger.fd(), 0)) {
    ASSERT_TRUE(trigger.Poll()->has_value());
    ++polled;
  }
  EXPECT_EQ(polled, 45);
  EXPECT_FALSE(trigger.Poll()->has_value());
}

TEST(SoftwareTrigger, MoreThanMayWaitAreRefusedAndCountedAsLost) {
  SoftwareTrigger trigger;
  ASSERT_TRUE(trigger.Start());
  for (std::size_t i = 0; i < SoftwareTrigger::kMaxWaiting; ++i) ASSERT_TRUE(trigger.Fire());
  EXPECT_EQ(trigger.Fire().error().kind, ErrorKind::kTemporary);
  EXPECT_EQ(trigger.Fire().error().kind, ErrorKind::kTemporary);
  ASSERT_TRUE(trigger.Poll()->has_value());
  ASSERT_TRUE(trigger.Fire());
  std::uint64_t lost = 0;
  while (const auto event = *trigger.Poll()) lost += event->lost_before;
  EXPECT_EQ(lost, 2U);
}

TEST(SoftwareTrigger, ItsLimitCountsAndAStoppedOneRefuses) {
  SoftwareTrigger trigger(1);
  EXPECT_EQ(trigger.Fire().error().kind, ErrorKind::kUnavailable);
  ASSERT_TRUE(trigger.Start());
  ASSERT_TRUE(trigger.Fire());
  EXPECT_EQ(trigger.Fire().error().kind, ErrorKind::kUnavailable);
  EXPECT_FALSE(trigger.exhausted());
  ASSERT_TRUE(trigger.Poll()->has_value());
  EXPECT_TRUE(trigger.exhausted());
  trigger.Stop();
  EXPECT_EQ(trigger.Fire().error().kind, ErrorKind::kUnavailable);
}

}  // namespace
}  // namespace omnihdr::trigger_test
