#include "daemon/supervisor.h"

#include <fmt/format.h>

#include <utility>

namespace omnihdr {

void Supervisor::Watch(std::string name, std::function<std::uint64_t()> progress,
                       Nanoseconds patience, HostTime now) {
  const std::uint64_t last = progress();
  watched_.push_back({std::move(name), std::move(progress), patience, last, now});
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
    } else if (now - watched.since > watched.patience && !stalled) {
      stalled = fmt::format("{} has made no progress for {} s", watched.name,
                            (now - watched.since).count() / 1'000'000'000);
    }
  }
  return stalled;
}

}  // namespace omnihdr
