#include "drivers/gpio/wheel_odometer.h"

#include <gtest/gtest.h>

namespace omnihdr::wheel_odometer_test {
namespace {

using gpio::WheelOdometer;

HostTime At(int milliseconds) { return HostTime::FromNanoseconds(milliseconds * 1'000'000LL); }

TEST(WheelOdometer, ItsListenerHearsOfTheFirstReadingBeforeAnyPulse) {
  WheelOdometer odometer(64.0, 2.5);
  int news = 0;
  odometer.Listen([&] { ++news; });
  EXPECT_FALSE(odometer.OdometerMetres(At(10)));
  odometer.Begin(At(10));
  EXPECT_EQ(news, 1);
  EXPECT_EQ(odometer.OdometerMetres(At(10)), 2.5);
  odometer.Pulse(At(20), 0, false);
  EXPECT_EQ(news, 2);
  EXPECT_EQ(odometer.OdometerMetres(At(20)), 2.5 + 1.0 / 64.0);
}

}  // namespace
}  // namespace omnihdr::wheel_odometer_test
