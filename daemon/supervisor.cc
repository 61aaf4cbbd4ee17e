#include "daemon/supervisor.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace omnihdr {

void Supervisor::Watch(std::string name, std::function<std::uint64_t()> progress,
                       Nanoseconds patience, HostTime now, std::function<Nanoseconds()> waited) {
  const std::uint64_t last = progress();
  const Nanoseconds waited_before = waited ? waited() : Nanoseconds(0);
  watched_.push_back({std::move(name), std::move(progress), patience, std::move(waited), last, now,
                      waited_before});
}

void Supervisor::Unwatch(const std::string& name) {
  std::erase_if(watched_, [&](const Watched& watched) { return watched.name == name; });
}

std::optional<std::string> Supervisor::Stalled(HostTime now) {
  std::optional<std::string> stalled;
  for (Watched& watched : watched_) {
    const std::uint64_t progress = watched.progress();
    if (progress != watched.last) {
      watched.last = progress;
      watched.since = now;
      if (watched.waited) watched.waited_before = watched.waited();
    } else if (now - watched.since > watched.patience && !stalled) {
      const Nanoseconds waited =
          watched.waited ? std::max(watched.waited() - watched.waited_before, Nanoseconds(0))
                         : Nanoseconds(0);
      if (now - watched.since - waited <= watched.patience) continue;
      stalled = fmt::format("{} has made no progress for {} s", watched.name,
                            (now - watched.since).count() / 1'000'000'000);
    }
  }
  return stalled;
}

}  // namespace omnihdr
