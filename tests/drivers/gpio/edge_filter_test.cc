#include "drivers/gpio/edge_filter.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <vector>

namespace omnihdr::edge_filter_test {
namespace {

using namespace omnihdr::gpio;  // NOLINT(google-build-using-namespace)
using std::chrono::milliseconds;

HostTime AtMs(std::int64_t ms) { return HostTime::FromNanoseconds(ms * 1'000'000); }

EdgeEvent Event(std::int64_t ms, bool rising, std::uint64_t lost = 0, bool full = false) {
  return {AtMs(ms), rising, lost, full};
}

struct Total {
  std::vector<std::int64_t> times_ms;
  std::uint64_t lost = 0;
  int doubtful = 0;
};

Total Filtered(EdgeFilter& filter, const std::vector<EdgeEvent>& events) {
  Total total;
  for (const EdgeEvent& event : events) {
    if (const auto counted = filter.Take(event)) {
      total.times_ms.push_back(counted->time.ns() / 1'000'000);
      total.lost += counted->lost_before;
      total.doubtful += counted->doubtful ? 1 : 0;
    }
  }
  return total;
}

using Times = std::vector<std::int64_t>;

TEST(GpioEdgeFilter, WithoutDebouncingEveryEdgeAskedForCounts) {
  EdgeFilter filter({Edge::kBoth, Nanoseconds(0)}, false);
  const Total total = Filtered(filter, {Event(1, true), Event(1, false), Event(2, true)});
  EXPECT_EQ(total.times_ms, (Times{1, 1, 2}));
  EXPECT_EQ(EdgeFilter::RequestFor({Edge::kRising, Nanoseconds(0)}), Edge::kRising);
}

TEST(GpioEdgeFilter, APressCountsAtItsFirstEdgeAndNeitherItsBouncesNorThoseOfItsReleaseDo) {
  const EdgeFilterOptions options{Edge::kRising, milliseconds(20)};
  EXPECT_EQ(EdgeFilter::RequestFor(options), Edge::kBoth);
  EdgeFilter filter(options, false);
  const Total total =
      Filtered(filter, {Event(100, true), Event(101, false), Event(103, true), Event(104, false),
                        Event(107, true),                                        // pressed
                        Event(300, false), Event(302, true), Event(305, false),  // released
                        Event(500, true)});                                      // pressed again
  EXPECT_EQ(total.times_ms, (Times{100, 500}));
  EXPECT_EQ(total.lost, 0U);
  EXPECT_EQ(filter.bounces(), 6U);
}

TEST(GpioEdgeFilter, AFallingEdgeCountsWhenItIsTheOneAskedFor) {
  EdgeFilter filter({Edge::kFalling, milliseconds(10)}, false);
  EXPECT_EQ(
      Filtered(filter, {Event(1, true), Event(50, false), Event(100, true), Event(150, false)})
          .times_ms,
      (Times{50, 150}));
}

TEST(GpioEdgeFilter, TwoReleasesInARowTellThatAPressWasLost) {
  EdgeFilter filter({Edge::kRising, milliseconds(10)}, false);
  const Total total =
      Filtered(filter, {Event(100, true), Event(200, false), Event(400, false), Event(500, true)});
  EXPECT_EQ(total.times_ms, (Times{100, 500}));
  EXPECT_EQ(total.lost, 1U);
}

TEST(GpioEdgeFilter, TwoPressesInARowLoseOnlyAReleaseWhichNobodyCounts) {
  EdgeFilter filter({Edge::kRising, milliseconds(10)}, false);
  EXPECT_EQ(Filtered(filter, {Event(100, true), Event(300, true)}).lost, 0U);
}

TEST(GpioEdgeFilter, WhatTheKernelCountsAsLostIsLost) {
  EdgeFilter one_edge({Edge::kRising, milliseconds(10)}, true);
  EXPECT_EQ(Filtered(one_edge, {Event(1, true), Event(2, true, 3), Event(3, true, 2)}).lost, 5U);
  EdgeFilter both_asked({Edge::kRising, milliseconds(10)}, false);
  EXPECT_EQ(Filtered(both_asked, {Event(100, true), Event(900, true, 5)}).lost, 3U);
}

TEST(GpioEdgeFilter, AFullBufferPutsTheNextCountedEdgeInDoubtAndOnlyThat) {
  EdgeFilter filter({Edge::kRising, milliseconds(10)}, false);
  const Total total = Filtered(filter, {Event(100, true, 0, true), Event(200, false),
                                        Event(300, true), Event(400, false), Event(500, true)});
  EXPECT_EQ(total.doubtful, 1);
}

RC_GTEST_PROP(GpioEdgeFilterProperty, EveryPressOfABouncingContactCountsOnceAndAtItsBeginning, ()) {
  const auto debounce = *rc::gen::inRange(5, 30);
  EdgeFilter filter({Edge::kRising, milliseconds(debounce)}, false);
  Times presses;
  Times counted;
  std::int64_t now = 1000;
  const int count = *rc::gen::inRange(1, 20);
  for (int i = 0; i < count; ++i) {
    for (const bool pressed : {true, false}) {
      now += debounce + *rc::gen::inRange(1, 200);
      if (pressed) presses.push_back(now);
      std::int64_t at = now;
      const int edges = 1 + 2 * *rc::gen::inRange(0, 4);
      for (int edge = 0; edge < edges; ++edge) {
        if (const auto out = filter.Take(Event(at, pressed == (edge % 2 == 0)))) {
          counted.push_back(out->time.ns() / 1'000'000);
          RC_ASSERT(out->lost_before == 0U);
        }
        at += *rc::gen::inRange<std::int64_t>(0, debounce);
        now = std::max(now, at);
      }
    }
  }
  RC_ASSERT(counted == presses);
}

TEST(GpioPulseTrain, AGapInAnEvenTrainTellsHowManyPulsesAreMissing) {
  PulseTrain train;
  EXPECT_EQ(train.MissingBefore(AtMs(50)), 0U);
  for (int i = 0; i < 16; ++i) train.Add(AtMs(100 + 10 * i + (i == 8 ? 3 : 0)));
  EXPECT_EQ(train.MissingBefore(AtMs(261)), 0U);
  EXPECT_EQ(train.MissingBefore(AtMs(331)), 7U);
  EXPECT_EQ(train.MissingBefore(AtMs(100'000'000)), 0U);
}

}  // namespace
}  // namespace omnihdr::edge_filter_test
