#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <vector>

#include "drivers/iidc/config_rom.h"

// Big-endian quadlets of a configuration ROM: any give a camera or an error with a message; names
// are short and printable.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::vector<std::uint32_t> quadlets;
  for (std::size_t i = 0; i + 4 <= size && quadlets.size() < 300; i += 4) {
    quadlets.push_back(std::uint32_t{data[i]} << 24 | std::uint32_t{data[i + 1]} << 16 |
                       std::uint32_t{data[i + 2]} << 8 | data[i + 3]);
  }
  const auto rom = omnihdr::iidc::ParseConfigRom(quadlets);
  if (!rom) {
    if (rom.error().message.empty()) std::abort();
    return 0;
  }
  for (const std::string* text : {&rom->vendor, &rom->model}) {
    if (text->size() > 256) std::abort();
    for (const char c : *text) {
      if (c < 0x20 || c > 0x7E) std::abort();
    }
  }
  return 0;
}
