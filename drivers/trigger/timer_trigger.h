#pragma once

#include <cstdint>

#include "core/base/clock.h"
#include "core/base/file.h"
#include "core/ports/trigger.h"

namespace omnihdr {

struct TimerTriggerOptions {
  double interval_s = 1.0;  // 0.001 to 86400
  std::uint64_t limit = 0;  // events before it is exhausted; 0 = none
  Status Validate() const;  // kConfig error naming the option and its range
};

// An event at every multiple of an interval, the first at once, on a timerfd. Expirations that were
// not polled in time come as lost_before of the next event.
class TimerTrigger final : public TriggerSource {
 public:
  explicit TimerTrigger(const TimerTriggerOptions& options) : options_(options) {}
  std::string_view kind() const override { return "timer"; }
  Status Start() override;
  void Stop() override;
  Result<std::optional<TriggerEvent>> Poll() override;
  int fd() const override { return fd_.get(); }
  // The time from the last event to the next, and between those after it. A running timer keeps
  // its old interval when this fails.
  Status SetInterval(double interval_s);
  bool exhausted() const override { return options_.limit > 0 && events_ >= options_.limit; }

 private:
  Status Arm(int fd, HostTime first, Nanoseconds interval) const;

  TimerTriggerOptions options_;
  Fd fd_;
  HostTime next_;  // when the oldest expiration not yet read was due
  Nanoseconds interval_{0};
  std::uint64_t events_ = 0;  // delivered, lost ones included
};

}  // namespace omnihdr
