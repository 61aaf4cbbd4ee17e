#pragma once

#include <cstdint>
#include <deque>
#include <optional>

#include "core/base/clock.h"

namespace omnihdr {

// How long a storage will do, from how fast its free space has shrunk over the last two minutes,
// or, in a pause of half a minute and more, before it. Whoever fills it: all counts. Not
// thread-safe.
class StorageForecast {
 public:
  void Add(HostTime time, std::uint64_t free_bytes);
  // Nothing before anything has been written, or when the storage cannot be read.
  std::optional<double> MinutesLeft() const;
  void Unreadable() { readings_.clear(); }

 private:
  struct Reading {
    HostTime time;
    std::uint64_t free_bytes = 0;
  };
  std::deque<Reading> readings_;
  HostTime shrank_;  // when it last did
  double bytes_per_second_ = 0.0;
};

}  // namespace omnihdr
