#pragma once

#include <optional>
#include <string>
#include <string_view>

#include "core/base/clock.h"

namespace omnihdr {

// Tells the service manager how we are (sd_notify). Does nothing when there is none. Any thread.
class ServiceNotifier {
 public:
  void Ready();
  // The configuration is being read again; Ready() ends it.
  void Reloading(HostTime now);
  void Stopping();
  void StatusText(std::string_view text);
  void FeedWatchdog();
  // How often the manager wants to be fed at the latest; nothing when it does not watch us.
  std::optional<Nanoseconds> WatchdogInterval() const;
};

}  // namespace omnihdr
