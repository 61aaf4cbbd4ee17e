#pragma once

#include <cstdint>
#include <optional>

#include "core/base/clock.h"
#include "daemon/config.h"

namespace omnihdr {

// Sends the process's log to standard error: with time and level for people, or, when standard
// error is the system journal, with a priority prefix ("<4>") that journald understands. Call once,
// first.
void InitLogging(LogLevel level);
// The least severity logged from now on. Any thread.
void SetLogLevel(LogLevel level);

// Lets one message a second through and counts the rest, so that a flood of the same complaint
// stays readable. Not thread-safe.
class FloodGate {
 public:
  explicit FloodGate(Nanoseconds interval = std::chrono::seconds(1)) : interval_(interval) {}
  // How many messages (this one included) the one to be written now stands for; nothing = keep
  // quiet.
  std::optional<std::uint64_t> Pass(HostTime now);

 private:
  const Nanoseconds interval_;
  std::optional<HostTime> last_;
  std::uint64_t held_ = 0;
};

}  // namespace omnihdr
