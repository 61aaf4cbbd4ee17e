#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/result.h"
#include "daemon/config.h"

namespace omnihdr {

// What becomes of a configuration that is read again while the daemon runs.

// When a key's new value takes effect.
enum class Applies {
  kLive,     // at once
  kRestart,  // when the daemon is started again
};
// "at once", "at restart".
std::string_view ToString(Applies applies);
Applies ConfigKeyApplies(std::string_view key);

struct ConfigChange {
  std::string key;
  std::string old_value;  // as TOML text
  std::string new_value;
  Applies applies = Applies::kRestart;
};

// The keys in which two configurations differ, in the order of config/omnihdr.toml.
std::vector<ConfigChange> CompareConfig(const DaemonConfig& before, const DaemonConfig& after);

// Gives one key of `config` the value that it has in `from`. Law: afterwards both show the same
// value for the key, and every other key of `config` is as before.
Status AdoptConfigKey(DaemonConfig& config, const DaemonConfig& from, std::string_view key);

// Reads and checks the configuration again; any thread but the main loop's.
using ReadConfig = std::function<Result<DaemonConfig>()>;

}  // namespace omnihdr
