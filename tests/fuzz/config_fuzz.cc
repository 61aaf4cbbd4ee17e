#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string_view>

#include "daemon/config.h"

// A configuration file: any bytes give a configuration or a list of problems, each with a message.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const omnihdr::LoadedConfig loaded = omnihdr::ParseConfig(text, "omnihdr.toml");
  for (const omnihdr::ConfigProblem& problem : loaded.problems) {
    if (problem.ToString().empty()) std::abort();
  }
  if (omnihdr::FormatConfig(loaded).empty() || omnihdr::FormatConfigJson(loaded).empty())
    std::abort();
  return 0;
}
