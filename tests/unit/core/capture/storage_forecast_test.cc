#include "core/capture/storage_forecast.h"

#include <gtest/gtest.h>

namespace omnihdr::storage_forecast_test {
namespace {

HostTime AtSecond(std::int64_t seconds) {
  return HostTime::FromNanoseconds(seconds * 1'000'000'000);
}

TEST(StorageForecast, TheTimeLeftFollowsFromTheRateAtWhichItFills) {
  StorageForecast forecast;
  EXPECT_FALSE(forecast.MinutesLeft());
  for (int s = 0; s <= 60; s += 5) forecast.Add(AtSecond(s), 12'000'000'000U - 10'000'000U * s);
  ASSERT_TRUE(forecast.MinutesLeft());
  EXPECT_NEAR(*forecast.MinutesLeft(), 11'400.0 / 10.0 / 60.0, 1e-6);
}

TEST(StorageForecast, WhileNothingIsWrittenTheLastRateStands) {
  StorageForecast forecast;
  for (int s = 0; s <= 200; s += 5) forecast.Add(AtSecond(s), 1'000'000'000U - 1'000'000U * s);
  for (int s = 205; s <= 1000; s += 5) forecast.Add(AtSecond(s), 800'000'000U);
  EXPECT_NEAR(*forecast.MinutesLeft(), 800.0 / 60.0, 0.3 * 800.0 / 60.0);
  for (int s = 1005; s <= 1010; s += 5)
    forecast.Add(AtSecond(s), 800'000'000U - 2'000'000U * (s - 1000));
  EXPECT_NEAR(*forecast.MinutesLeft(), 780.0 / 2.0 / 60.0, 0.1);
}

TEST(StorageForecast, ARateThatChangesIsFollowedWithinTwoMinutes) {
  StorageForecast forecast;
  std::uint64_t free_bytes = 100'000'000'000U;
  for (int s = 0; s <= 300; s += 5) forecast.Add(AtSecond(s), free_bytes -= 5'000'000U);
  for (int s = 305; s <= 425; s += 5) forecast.Add(AtSecond(s), free_bytes -= 50'000'000U);
  EXPECT_NEAR(*forecast.MinutesLeft(), static_cast<double>(free_bytes) / 1e7 / 60.0, 1.0);
}

TEST(StorageForecast, DeletingSomethingAddsSpaceAndIsNoRate) {
  StorageForecast forecast;
  for (int s = 0; s <= 60; s += 5) forecast.Add(AtSecond(s), 6'000'000'000U - 10'000'000U * s);
  forecast.Add(AtSecond(65), 60'000'000'000U);
  EXPECT_NEAR(*forecast.MinutesLeft(), 60'000.0 / 10.0 / 60.0, 1e-6);
}

TEST(StorageForecast, AStorageThatCannotBeReadIsNotEndless) {
  StorageForecast forecast;
  for (int s = 0; s <= 60; s += 5) forecast.Add(AtSecond(s), 6'000'000'000U - 10'000'000U * s);
  forecast.Unreadable();
  EXPECT_FALSE(forecast.MinutesLeft());
}

}  // namespace
}  // namespace omnihdr::storage_forecast_test
