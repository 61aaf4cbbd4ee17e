#include "core/capture/storage_guard.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

namespace omnihdr::storage_guard_test {
namespace {

using ::testing::HasSubstr;

constexpr std::uint64_t kMb = 1'000'000;

HostTime At(double seconds) {
  return HostTime::FromNanoseconds(static_cast<std::int64_t>(seconds * 1e9));
}

StorageLimits ByFreeSpace() { return {100.0, 0.0, 10.0, 0.0}; }

TEST(StorageGuard, FreeSpaceUnderALimitIsSaidWithBothValues) {
  StorageGuard guard;
  guard.Add(At(0), 500 * kMb, 1000 * kMb);
  StorageReport report = guard.Judge(ByFreeSpace());
  EXPECT_EQ(report.free_bytes, 500 * kMb);
  EXPECT_EQ(report.total_bytes, 1000 * kMb);
  EXPECT_EQ(report.warning + report.stop + report.error, "");
  guard.Add(At(1), 99 * kMb, 1000 * kMb);
  report = guard.Judge(ByFreeSpace());
  EXPECT_EQ(report.warning, "99 MB are free, storage.warn_free_mb is 100");
  EXPECT_EQ(report.stop, "");
  guard.Add(At(2), 9 * kMb, 1000 * kMb);
  report = guard.Judge(ByFreeSpace());
  EXPECT_EQ(report.stop, "9 MB are free, storage.stop_free_mb is 10");
  EXPECT_EQ(report.warning, "");
}

TEST(StorageGuard, ALimitIsLeftWithATenthMoreThanItAsksFor) {
  StorageGuard guard;
  guard.Add(At(0), 9 * kMb, 1000 * kMb);
  EXPECT_NE(guard.Judge(ByFreeSpace()).stop, "");
  guard.Add(At(1), 10 * kMb + kMb / 2, 1000 * kMb);
  EXPECT_NE(guard.Judge(ByFreeSpace()).stop, "");
  guard.Add(At(2), 12 * kMb, 1000 * kMb);
  EXPECT_EQ(guard.Judge(ByFreeSpace()).stop, "");
}

TEST(StorageGuard, MinutesAtTheMeasuredRateCountAsWell) {
  const StorageLimits limits{0.0, 30.0, 0.0, 2.0};
  StorageGuard guard;
  // 1 MB a second.
  for (int second = 0; second <= 60; second += 5) {
    guard.Add(At(second), (1900 - static_cast<std::uint64_t>(second)) * kMb, 4000 * kMb);
  }
  StorageReport report = guard.Judge(limits);
  ASSERT_TRUE(report.minutes_left);
  EXPECT_NEAR(*report.minutes_left, 1840.0 / 60.0, 0.01);
  EXPECT_EQ(report.warning, "");
  for (int second = 65; second <= 300; second += 5) {
    guard.Add(At(second), (1900 - static_cast<std::uint64_t>(second)) * kMb, 4000 * kMb);
  }
  EXPECT_THAT(guard.Judge(limits).warning, HasSubstr("26.7 minutes are left"));
  for (int second = 305; second <= 1800; second += 5) {
    guard.Add(At(second), (1900 - static_cast<std::uint64_t>(second)) * kMb, 4000 * kMb);
  }
  EXPECT_THAT(guard.Judge(limits).stop, HasSubstr("storage.stop_minutes is 2"));
}

TEST(StorageGuard, AnUnreadableStorageIsAnErrorAndNeverEndless) {
  StorageGuard guard;
  guard.Add(At(0), 500 * kMb, 1000 * kMb);
  guard.Unreadable("/data: Input/output error");
  const StorageReport report = guard.Judge(ByFreeSpace());
  EXPECT_EQ(report.error, "/data: Input/output error");
  EXPECT_FALSE(report.free_bytes);
  EXPECT_FALSE(report.minutes_left);
  guard.Add(At(1), 500 * kMb, 1000 * kMb);
  EXPECT_EQ(guard.Judge(ByFreeSpace()).error, "");
}

}  // namespace
}  // namespace omnihdr::storage_guard_test
