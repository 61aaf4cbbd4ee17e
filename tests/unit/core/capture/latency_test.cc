#include "core/capture/latency.h"

#include <gtest/gtest.h>

#include <numeric>

namespace omnihdr::latency_test {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

HostTime At(Nanoseconds time) { return HostTime::FromNanoseconds(time.count()); }

const LatencyCounts& Of(const CaptureLatencies& all, CaptureLatency latency) {
  return all[static_cast<std::size_t>(latency)];
}

TEST(LatencyTracker, EachStageOfATriggerIsCountedOnce) {
  LatencyTracker tracker;
  EXPECT_FALSE(tracker.last_frame());
  tracker.Commanded(TriggerId{3}, At(milliseconds(1000)), At(milliseconds(1002)));
  tracker.FrameArrived(TriggerId{3}, At(milliseconds(1022)));
  tracker.FrameArrived(TriggerId{3}, At(milliseconds(1500)));  // the same again
  tracker.Durable(TriggerId{3}, PositionId{1}, true, At(milliseconds(1042)));
  tracker.Durable(TriggerId{3}, PositionId{1}, true, At(milliseconds(2000)));
  tracker.ViewDone(PositionId{1}, At(milliseconds(3000)));
  tracker.ViewDone(PositionId{1}, At(milliseconds(9000)));
  const CaptureLatencies counts = tracker.counts();
  EXPECT_EQ(Of(counts, CaptureLatency::kEdgeToCommand).total, 1U);
  EXPECT_NEAR(Of(counts, CaptureLatency::kEdgeToCommand).sum_s, 0.002, 1e-9);
  EXPECT_EQ(Of(counts, CaptureLatency::kCommandToFrame).total, 1U);
  EXPECT_NEAR(Of(counts, CaptureLatency::kCommandToFrame).sum_s, 0.020, 1e-9);
  EXPECT_EQ(Of(counts, CaptureLatency::kFrameToDurable).total, 1U);
  EXPECT_NEAR(Of(counts, CaptureLatency::kFrameToDurable).sum_s, 0.020, 1e-9);
  EXPECT_EQ(Of(counts, CaptureLatency::kTriggerToView).total, 1U);
  EXPECT_NEAR(Of(counts, CaptureLatency::kTriggerToView).sum_s, 2.0, 1e-9);
  EXPECT_EQ(tracker.last_frame(), At(milliseconds(1500)));
}

TEST(LatencyTracker, AFrameThatIsThereBeforeItsCommandReturnsCounts) {
  LatencyTracker tracker;
  tracker.FrameArrived(TriggerId{7}, At(milliseconds(1001)));
  tracker.Commanded(TriggerId{7}, At(milliseconds(1000)), At(milliseconds(1002)));
  tracker.Durable(TriggerId{7}, PositionId{0}, true, At(milliseconds(1011)));
  const CaptureLatencies counts = tracker.counts();
  EXPECT_EQ(Of(counts, CaptureLatency::kEdgeToCommand).total, 1U);
  EXPECT_EQ(Of(counts, CaptureLatency::kCommandToFrame).total, 1U);
  EXPECT_EQ(Of(counts, CaptureLatency::kCommandToFrame).sum_s, 0.0);
  EXPECT_NEAR(Of(counts, CaptureLatency::kFrameToDurable).sum_s, 0.010, 1e-9);
}

TEST(LatencyTracker, ThePartsOfAViewsWorkAreCountedEachByItself) {
  LatencyTracker tracker;
  tracker.Took(CaptureLatency::kViewStereo, 0.3);
  tracker.Took(CaptureLatency::kViewStereo, 0.5);
  tracker.Took(CaptureLatency::kViewWrite, 0.02);
  const CaptureLatencies counts = tracker.counts();
  EXPECT_EQ(Of(counts, CaptureLatency::kViewStereo).total, 2U);
  EXPECT_NEAR(Of(counts, CaptureLatency::kViewStereo).sum_s, 0.8, 1e-9);
  EXPECT_EQ(Of(counts, CaptureLatency::kViewWrite).total, 1U);
  EXPECT_EQ(Of(counts, CaptureLatency::kViewPose).total, 0U);
}

TEST(LatencyTracker, ALostFrameCountsAsCommandedOnly) {
  LatencyTracker tracker;
  tracker.Commanded(TriggerId{0}, At(seconds(1)), At(seconds(1)));
  tracker.Durable(TriggerId{0}, PositionId{0}, false, At(seconds(3)));
  tracker.ViewDone(PositionId{0}, At(seconds(4)));
  const CaptureLatencies counts = tracker.counts();
  EXPECT_EQ(Of(counts, CaptureLatency::kEdgeToCommand).total, 1U);
  EXPECT_EQ(Of(counts, CaptureLatency::kFrameToDurable).total, 0U);
  EXPECT_EQ(Of(counts, CaptureLatency::kTriggerToView).total, 0U);
}

TEST(LatencyTracker, AViewThatIsDoneBeforeItsLineIsToldOfCounts) {
  LatencyTracker tracker;
  tracker.Commanded(TriggerId{5}, At(seconds(1)), At(seconds(1)));
  tracker.ViewDone(PositionId{2}, At(seconds(4)));
  tracker.Durable(TriggerId{5}, PositionId{2}, true, At(seconds(5)));
  const LatencyCounts views = Of(tracker.counts(), CaptureLatency::kTriggerToView);
  EXPECT_EQ(views.total, 1U);
  EXPECT_NEAR(views.sum_s, 3.0, 1e-9);
}

TEST(LatencyTracker, AViewIsTimedFromTheFirstTriggerOfItsPosition) {
  LatencyTracker tracker;
  for (std::uint64_t i = 0; i < 3; ++i) {
    const HostTime time = At(seconds(1 + static_cast<int>(i)));
    tracker.Commanded(TriggerId{i}, time, time);
    tracker.Durable(TriggerId{i}, PositionId{0}, true, time);
  }
  tracker.ViewDone(PositionId{0}, At(seconds(11)));
  EXPECT_NEAR(Of(tracker.counts(), CaptureLatency::kTriggerToView).sum_s, 10.0, 1e-9);
}

TEST(LatencyTracker, WhatNeverEndsIsForgotten) {
  LatencyTracker tracker;
  for (std::uint64_t i = 0; i <= LatencyTracker::kMaxTriggers; ++i) {
    tracker.Commanded(TriggerId{i}, At(seconds(1)), At(seconds(1)));
  }
  tracker.FrameArrived(TriggerId{0}, At(seconds(2)));
  tracker.FrameArrived(TriggerId{1}, At(seconds(2)));
  EXPECT_EQ(Of(tracker.counts(), CaptureLatency::kCommandToFrame).total, 1U);
}

TEST(LatencyCounts, ADurationIsCountedUnderTheFirstBoundThatHoldsIt) {
  LatencyCounts counts;
  counts.Add(Nanoseconds(100'000));  // exactly the first bound
  counts.Add(Nanoseconds(100'001));
  counts.Add(Nanoseconds(-5));
  counts.Add(std::chrono::hours(1));
  EXPECT_EQ(counts.counts[0], 2U);
  EXPECT_EQ(counts.counts[1], 1U);
  EXPECT_EQ(counts.counts.back(), 1U);
  EXPECT_EQ(std::accumulate(counts.counts.begin(), counts.counts.end(), std::uint64_t{0}),
            counts.total);
}

}  // namespace
}  // namespace omnihdr::latency_test
