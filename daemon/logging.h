#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/clock.h"
#include "daemon/config.h"

namespace omnihdr {

// Sends the process's log to the system journal, with fields that can be searched for, when
// standard error is that journal; else to standard error, with time and level for people. Call
// once, first.
void InitLogging(LogLevel level);
// The least severity logged from now on. Any thread.
void SetLogLevel(LogLevel level);

// What a line of the log is about, beside its text. In the system journal: OMNIHDR_SESSION,
// OMNIHDR_TRIGGER, OMNIHDR_POSITION, OMNIHDR_STAGE and OMNIHDR_ERROR.
struct LogFields {
  std::string session = {};  // its directory
  std::optional<std::uint64_t> trigger = std::nullopt;
  std::optional<std::int64_t> position = std::nullopt;
  std::string stage = {};  // of the daemon: "camera", "recorder", "pipeline", ...
  std::string error = {};  // a word for what went wrong, such as the status of a journal line
};

// While it lives, this thread's lines have these fields as well; of those that are set twice the
// newer one counts. Destroyed in the order opposite to construction.
class LogContext {
 public:
  explicit LogContext(LogFields fields);
  ~LogContext();
  LogContext(const LogContext&) = delete;
  LogContext& operator=(const LogContext&) = delete;
  // Of this thread at this moment, with the session of SetLogSession.
  static LogFields Current();

 private:
  LogFields before_;
};
// The session that all lines are about from now on. Any thread.
void SetLogSession(const std::string& directory);

// One entry of the system journal as "NAME=value", a priority of 0 (worst) to 7.
std::vector<std::string> JournalEntry(int priority, std::string_view message,
                                      const LogFields& fields);

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
