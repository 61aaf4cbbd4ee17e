#include "drivers/gpio/wheel_odometer.h"

#include <gtest/gtest.h>

namespace omnihdr::wheel_odometer_test {
namespace {

using gpio::WheelOdometer;
using std::chrono::milliseconds;

TEST(WheelOdometer, ItsListenerHearsOfTheFirstReadingBeforeAnyPulse) {
  WheelOdometer odometer(64.0, 2.5);
  int news = 0;
  odometer.Listen([&] { ++news; });
  EXPECT_FALSE(odometer.OdometerMetres(HostTime(milliseconds(10))));
  odometer.Begin(HostTime(milliseconds(10)));
  EXPECT_EQ(news, 1);
  EXPECT_EQ(odometer.OdometerMetres(HostTime(milliseconds(10))), 2.5);
  odometer.Pulse(HostTime(milliseconds(20)), 0, false);
  EXPECT_EQ(news, 2);
  EXPECT_EQ(odometer.OdometerMetres(HostTime(milliseconds(20))), 2.5 + 1.0 / 64.0);
}

}  // namespace
}  // namespace omnihdr::wheel_odometer_test
