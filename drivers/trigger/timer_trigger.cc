#include "drivers/trigger/timer_trigger.h"

#include <sys/timerfd.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>

namespace omnihdr {

Status TimerTriggerOptions::Validate() const {
  if (interval_s >= 0.001 && interval_s <= 86400.0) return {};
  return Fail(ErrorKind::kConfig, "interval_s: {}: expected 0.001 to 86400", interval_s);
}

Status TimerTrigger::Arm(int fd, HostTime first, Nanoseconds interval) const {
  const auto to_timespec = [](std::int64_t ns) {
    return timespec{static_cast<time_t>(ns / 1'000'000'000), static_cast<long>(ns % 1'000'000'000)};
  };
  const itimerspec spec{to_timespec(interval.count()), to_timespec(first.ns())};
  if (timerfd_settime(fd, TFD_TIMER_ABSTIME, &spec, nullptr) != 0) {
    return FailErrno(ErrorKind::kSystem, "timer trigger: timerfd_settime", errno);
  }
  return {};
}

Status TimerTrigger::SetInterval(double interval_s) {
  TimerTriggerOptions options = options_;
  options.interval_s = interval_s;
  OMNIHDR_TRY(options.Validate());
  if (fd_.valid()) {
    const Nanoseconds interval(static_cast<std::int64_t>(std::llround(interval_s * 1e9)));
    const HostTime first = std::max(SystemClock().Now(), next_ - interval_ + interval);
    OMNIHDR_TRY(Arm(fd_.get(), first, interval));
    next_ = first;
    interval_ = interval;
  }
  options_ = options;
  return {};
}

Status TimerTrigger::Start() {
  OMNIHDR_TRY(options_.Validate());
  if (fd_.valid() || exhausted()) return {};
  Fd fd(timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC));
  if (!fd.valid()) return FailErrno(ErrorKind::kSystem, "timer trigger: timerfd_create", errno);
  interval_ = Nanoseconds(static_cast<std::int64_t>(std::llround(options_.interval_s * 1e9)));
  next_ = SystemClock().Now();
  OMNIHDR_TRY(Arm(fd.get(), next_, interval_));
  fd_ = std::move(fd);
  return {};
}

void TimerTrigger::Stop() { fd_.Close(); }

Result<std::optional<TriggerEvent>> TimerTrigger::Poll() {
  if (!fd_.valid() || exhausted()) return std::nullopt;
  std::uint64_t expirations = 0;
  const ssize_t got = read(fd_.get(), &expirations, sizeof expirations);
  if (got < 0) {
    if (errno == EAGAIN || errno == EINTR) return std::nullopt;
    return FailErrno(ErrorKind::kSystem, "timer trigger: read", errno);
  }
  if (expirations == 0) return std::nullopt;
  if (options_.limit > 0) expirations = std::min(expirations, options_.limit - events_);
  TriggerEvent event;
  event.lost_before = expirations - 1;
  event.time = next_ + interval_ * static_cast<std::int64_t>(expirations - 1);
  next_ = next_ + interval_ * static_cast<std::int64_t>(expirations);
  events_ += expirations;
  // A timer nobody needs any more must not keep the descriptor readable.
  if (exhausted()) fd_.Close();
  return event;
}

}  // namespace omnihdr
