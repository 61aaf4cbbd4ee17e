#pragma once

#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "core/base/clock.h"

namespace omnihdr {

// Watches that every stage of the daemon makes progress. A stage that waits for something counts as
// progressing (it comes round at each deadline of its wait); one that is stuck in a call does not.
// Not thread-safe.
class Supervisor {
 public:
  // `progress` grows while the stage lives; `patience` is the longest honest piece of work of the
  // stage. `waited`: how long it has been kept from a processor by others, in all, which does not
  // count; null = never.
  void Watch(std::string name, std::function<std::uint64_t()> progress, Nanoseconds patience,
             HostTime now, std::function<Nanoseconds()> waited = {});
  void Unwatch(const std::string& name);
  // Who is stuck, for people, or nothing: then the service manager's watchdog may be fed.
  std::optional<std::string> Stalled(HostTime now);

 private:
  struct Watched {
    std::string name;
    std::function<std::uint64_t()> progress;
    Nanoseconds patience;
    std::function<Nanoseconds()> waited;
    std::uint64_t last = 0;
    HostTime since;
    Nanoseconds waited_before{0};  // then
  };
  std::vector<Watched> watched_;
};

}  // namespace omnihdr
