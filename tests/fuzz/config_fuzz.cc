#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "daemon/config.h"

// Laws: any bytes give a configuration or a list of problems, each with a message; what `config
// show` prints of a good configuration is a good configuration with the same values.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace omnihdr;
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const LoadedConfig loaded = ParseConfig(text, "/etc/omnihdr/omnihdr.toml");
  for (const ConfigProblem& problem : loaded.problems) {
    if (problem.message.empty() || problem.line < 0) std::abort();
  }
  if (FormatConfigJson(loaded).empty()) std::abort();
  const std::string shown = FormatConfig(loaded);
  if (!loaded.ok()) return 0;
  if (loaded.config.bracket.Exposures().empty()) std::abort();
  const LoadedConfig again = ParseConfig(shown, "/etc/omnihdr/again.toml");
  if (!again.ok()) std::abort();
  for (const std::string& key : ConfigKeyNames()) {
    if (*ConfigValueToToml(again.config, key) != *ConfigValueToToml(loaded.config, key)) {
      std::abort();
    }
  }
  return 0;
}
