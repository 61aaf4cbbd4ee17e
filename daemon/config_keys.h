#pragma once

#include <filesystem>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "core/session/toml.h"
#include "daemon/config.h"

namespace omnihdr {

// One configuration key: drives reading, checking and showing.
struct ConfigKey {
  std::string name;      // "camera.frame_timeout_s"
  std::string expected;  // "seconds in [0.01, 600]": completes "value, expected ..."
  // Sets the key; false when the value is of the wrong type or out of range, the config unchanged.
  // Relative paths are taken from `directory`.
  std::function<bool(DaemonConfig& config, const TomlValue& value,
                     const std::filesystem::path& directory)>
      set;
  // The value as TOML text, which is JSON text too.
  std::function<std::string(const DaemonConfig& config)> show;
};

// The one list of keys, in the order of config/omnihdr.toml.
const std::vector<ConfigKey>& ConfigKeys();
// Adds those of [gpio], [modbus] and [gnss].
void AddVehicleKeys(std::vector<ConfigKey>& keys);
// nullptr when there is none of that name.
const ConfigKey* FindConfigKey(std::string_view name);

}  // namespace omnihdr
