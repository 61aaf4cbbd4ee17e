#include "daemon/config_reload.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <filesystem>

#include "core/session/toml.h"
#include "daemon/config_keys.h"

namespace omnihdr {
namespace {

// The list at the head of config/omnihdr.toml is held against this one by a test.
constexpr std::array<std::string_view, 22> kLiveKeys = {"bracket.order",
                                                        "bracket.exposures_s",
                                                        "bracket.start_s",
                                                        "bracket.step_stops",
                                                        "bracket.count",
                                                        "bracket.gain_db",
                                                        "trigger.interval_s",
                                                        "trigger.distance_m",
                                                        "trigger.limit",
                                                        "log.level",
                                                        "session.rotate_gb",
                                                        "session.rotate_positions",
                                                        "session.rotate_hours",
                                                        "recorder.durability",
                                                        "recorder.sync_interval_s",
                                                        "storage.warn_free_mb",
                                                        "storage.warn_minutes",
                                                        "storage.stop_free_mb",
                                                        "storage.stop_minutes",
                                                        "storage.retention",
                                                        "storage.retention_days",
                                                        "storage.retention_gb"};

}  // namespace

std::string_view ToString(Applies applies) {
  return applies == Applies::kLive ? "at once" : "at restart";
}

Applies ConfigKeyApplies(std::string_view key) {
  return std::find(kLiveKeys.begin(), kLiveKeys.end(), key) != kLiveKeys.end() ? Applies::kLive
                                                                               : Applies::kRestart;
}

std::vector<ConfigChange> CompareConfig(const DaemonConfig& before, const DaemonConfig& after) {
  std::vector<ConfigChange> changes;
  for (const ConfigKey& key : ConfigKeys()) {
    std::string old_value = key.show(before);
    std::string new_value = key.show(after);
    if (old_value == new_value) continue;
    changes.push_back(
        {key.name, std::move(old_value), std::move(new_value), ConfigKeyApplies(key.name)});
  }
  return changes;
}

Status AdoptConfigKey(DaemonConfig& config, const DaemonConfig& from, std::string_view key) {
  const ConfigKey* found = FindConfigKey(key);
  if (found == nullptr) return Fail(ErrorKind::kSoftware, "{}: expected a known key", key);
  const std::string text = found->show(from);
  const TomlDocument document = ParseToml(fmt::format("value = {}\n", text));
  if (!document.error.empty() || document.entries.size() != 1 || !document.entries[0].value) {
    return Fail(ErrorKind::kSoftware, "{}: {}, expected a value of TOML", key, text);
  }
  // Paths of a loaded configuration are resolved already.
  if (!found->set(config, *document.entries[0].value, std::filesystem::path())) {
    return Fail(ErrorKind::kSoftware, "{}: {}, expected {}", key, text, found->expected);
  }
  return {};
}

}  // namespace omnihdr
