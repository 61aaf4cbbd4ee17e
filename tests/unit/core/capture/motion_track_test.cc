#include "core/capture/motion_track.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <chrono>
#include <cmath>

namespace omnihdr::motion_track_test {
namespace {

using std::chrono::milliseconds;

HostTime At(double seconds) {
  return HostTime::FromNanoseconds(static_cast<std::int64_t>(std::llround(seconds * 1e9)));
}

double Seconds(HostTime time) { return static_cast<double>(time.ns()) * 1e-9; }

TEST(MotionTrack, BetweenReadingsTheWayIsStraightAndBeforeTheOldestItIsNotKnown) {
  MotionTrack track;
  EXPECT_FALSE(track.At(At(1.0)));
  EXPECT_FALSE(track.TimeAt(0.0));
  track.Add(At(1.0), 10.0);
  track.Add(At(2.0), 14.0);
  EXPECT_NEAR(*track.At(At(1.25)), 11.0, 1e-9);
  EXPECT_NEAR(Seconds(*track.TimeAt(13.0)), 1.75, 1e-9);
  EXPECT_FALSE(track.At(At(0.999)));
  EXPECT_EQ(*track.TimeAt(5.0), At(1.0));
}

TEST(MotionTrack, AheadItGoesOnAtThePresentSpeedUntilTheReadingIsTooOld) {
  MotionTrackOptions options;
  options.valid = milliseconds(500);
  MotionTrack track(options);
  track.Add(At(1.0), 10.0);
  track.Add(At(1.2), 10.4);
  EXPECT_NEAR(track.speed_m_s(), 2.0, 1e-9);
  EXPECT_NEAR(*track.At(At(1.5)), 11.0, 1e-9);
  EXPECT_NEAR(Seconds(*track.TimeAt(11.0)), 1.5, 1e-6);
  EXPECT_FALSE(track.At(At(1.71)));
  EXPECT_FALSE(track.TimeAt(11.5));
}

TEST(MotionTrack, WhenNoReadingComesItGoesOnNoFurtherThanAsked) {
  MotionTrackOptions options;
  options.ahead = milliseconds(200);
  MotionTrack track(options);
  track.Add(At(1.0), 10.0, 5.0);
  EXPECT_NEAR(*track.At(At(1.1)), 10.5, 1e-9);
  EXPECT_NEAR(*track.At(At(9.0)), 11.0, 1e-9);
  EXPECT_TRUE(track.TimeAt(10.9));
  EXPECT_FALSE(track.TimeAt(11.1));
}

TEST(MotionTrack, ACounterThatTellsOnlyChangesStaysWhereItIs) {
  MotionTrackOptions options;
  options.extrapolate = false;
  MotionTrack track(options);
  track.Add(At(1.0), 1.0);
  track.Add(At(1.1), 2.0);
  EXPECT_EQ(*track.At(At(1000.0)), 2.0);
  EXPECT_FALSE(track.TimeAt(2.1));
}

TEST(MotionTrack, ASpeedThatIsToldIsTakenInsteadOfTheReadings) {
  MotionTrack track;
  track.Add(At(1.0), 0.0, 5.0);
  EXPECT_NEAR(*track.At(At(1.1)), 0.5, 1e-9);
  track.Add(At(1.2), 1.0, 0.0);
  EXPECT_FALSE(track.TimeAt(1.5));
}

TEST(MotionTrack, AMarkThatWasPassedTwiceHasTheTimeOfTheLastPassUpwards) {
  MotionTrack track;
  track.Add(At(1.0), 0.0);
  track.Add(At(2.0), 2.0);
  track.Add(At(3.0), 0.0);
  track.Add(At(4.0), 2.0);
  EXPECT_NEAR(Seconds(*track.TimeAt(1.0)), 3.5, 1e-9);
}

TEST(MotionTrack, ReadingsOutOfOrderAreIgnoredAndNoMoreThanTheCapacityAreKept) {
  MotionTrackOptions options;
  options.capacity = 3;
  MotionTrack track(options);
  for (int i = 0; i < 10; ++i) track.Add(At(i), i);
  track.Add(At(5.0), 1000.0);
  EXPECT_EQ(*track.At(At(9.0)), 9.0);
  EXPECT_FALSE(track.At(At(6.5)));
  EXPECT_TRUE(track.At(At(7.0)));
}

RC_GTEST_PROP(MotionTrackProperty, TheTimeOfAReadingIsWhenItIsReadOnAnyWayThatOnlyGoesForward, ()) {
  MotionTrack track;
  double time = 1.0;
  double metres = 0.0;
  const int steps = *rc::gen::inRange(2, 40);
  for (int i = 0; i < steps; ++i) {
    time += *rc::gen::inRange(1, 1000) * 1e-3;
    metres += *rc::gen::inRange(1, 5000) * 1e-3;
    track.Add(At(time), metres);
  }
  const double first = *track.At(*track.TimeAt(-1.0));
  const double wanted = first + (metres - first) * (*rc::gen::inRange(0, 1001) * 1e-3);
  RC_ASSERT(std::abs(*track.At(*track.TimeAt(wanted)) - wanted) < 1e-5);
}

}  // namespace
}  // namespace omnihdr::motion_track_test
