#pragma once

#include <chrono>
#include <compare>
#include <cstdint>

namespace omnihdr {

using Nanoseconds = std::chrono::nanoseconds;

// A point in time of one clock, in nanoseconds. Points of different clocks do not subtract, compare
// or convert; only a fitted clock model turns one into another.
template <typename ClockTag>
class TimePoint {
 public:
  constexpr TimePoint() = default;
  static constexpr TimePoint FromNanoseconds(std::int64_t ns) { return TimePoint(ns); }
  constexpr std::int64_t ns() const { return ns_; }
  constexpr auto operator<=>(const TimePoint&) const = default;
  constexpr Nanoseconds operator-(TimePoint other) const { return Nanoseconds(ns_ - other.ns_); }
  constexpr TimePoint operator+(Nanoseconds duration) const {
    return TimePoint(ns_ + duration.count());
  }
  constexpr TimePoint operator-(Nanoseconds duration) const {
    return TimePoint(ns_ - duration.count());
  }

 private:
  explicit constexpr TimePoint(std::int64_t ns) : ns_(ns) {}
  std::int64_t ns_ = 0;
};

// CLOCK_MONOTONIC of this machine: intervals, deadlines, kernel event stamps.
using HostTime = TimePoint<struct HostClockTag>;
// The camera's own counter.
using CameraTime = TimePoint<struct CameraClockTag>;
// CLOCK_REALTIME: nanoseconds since 1970-01-01T00:00:00Z, for the record only.
using UtcTime = TimePoint<struct UtcClockTag>;

// Where time comes from. Passed in, so that tests run in simulated time. Thread-safe.
class Clock {
 public:
  virtual ~Clock() = default;
  virtual HostTime Now() const = 0;
  virtual UtcTime NowUtc() const = 0;
};

// The operating system's clocks.
class SystemClock final : public Clock {
 public:
  HostTime Now() const override;
  UtcTime NowUtc() const override;
};

}  // namespace omnihdr
