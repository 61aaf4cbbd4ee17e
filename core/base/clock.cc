#include "core/base/clock.h"

#include <ctime>

namespace omnihdr {
namespace {

std::int64_t ReadClock(clockid_t id) {
  timespec now{};
  clock_gettime(id, &now);
  return static_cast<std::int64_t>(now.tv_sec) * 1'000'000'000 + now.tv_nsec;
}

}  // namespace

HostTime SystemClock::Now() const { return HostTime::FromNanoseconds(ReadClock(CLOCK_MONOTONIC)); }
UtcTime SystemClock::NowUtc() const { return UtcTime::FromNanoseconds(ReadClock(CLOCK_REALTIME)); }

}  // namespace omnihdr
