#include "daemon/watchdog.h"

#include <fmt/format.h>
#include <systemd/sd-daemon.h>

namespace omnihdr {

void ServiceNotifier::Ready() { sd_notify(0, "READY=1"); }

void ServiceNotifier::Reloading(HostTime now) {
  sd_notify(0, fmt::format("RELOADING=1\nMONOTONIC_USEC={}", now.ns() / 1000).c_str());
}

void ServiceNotifier::Stopping() { sd_notify(0, "STOPPING=1"); }

void ServiceNotifier::StatusText(std::string_view text) {
  sd_notify(0, fmt::format("STATUS={}", text).c_str());
}

void ServiceNotifier::FeedWatchdog() { sd_notify(0, "WATCHDOG=1"); }

std::optional<Nanoseconds> ServiceNotifier::WatchdogInterval() const {
  std::uint64_t interval_us = 0;
  if (sd_watchdog_enabled(0, &interval_us) <= 0 || interval_us == 0) return std::nullopt;
  return std::chrono::microseconds(interval_us);
}

}  // namespace omnihdr
