#pragma once

#include <sys/socket.h>
#include <sys/un.h>

#include <deque>
#include <mutex>
#include <optional>
#include <string>
#include <string_view>

#include "core/base/clock.h"
#include "core/base/file.h"

namespace omnihdr {

// Tells the service manager how we are: datagrams to NOTIFY_SOCKET, as sd_notify(3) has them. Does
// nothing when there is none. Nothing here waits for the manager: what it has no room for is kept
// (of the status only the newest text) and sent by a later call, a message to the watchdog is left
// out. Any thread.
class ServiceNotifier {
 public:
  ServiceNotifier();  // reads NOTIFY_SOCKET

  void Ready();
  // The configuration is being read again; Ready() ends it.
  void Reloading(HostTime now);
  void Stopping();
  void StatusText(std::string_view text);
  void FeedWatchdog();
  // Sends what was kept, as far as there is room. FeedWatchdog does it, too.
  void Retry();
  // How often the manager wants to be fed at the latest; nothing when it does not watch us.
  std::optional<Nanoseconds> WatchdogInterval() const;

 private:
  void Tell(std::string message);
  void SendKept();
  bool Send(std::string_view message) const;

  Fd socket_;
  sockaddr_un address_{};
  socklen_t address_length_ = 0;
  std::mutex mutex_;
  std::deque<std::string> kept_;  // in their order
  std::optional<std::string> kept_status_;
};

}  // namespace omnihdr
