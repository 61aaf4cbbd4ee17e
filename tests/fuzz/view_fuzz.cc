#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "core/session/view_writer.h"

// Law: whatever is accepted as view.json is written back as a text that reads the same.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace omnihdr;
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const Result<ViewRecord> view = ParseViewRecord(text, "view.json");
  if (!view) {
    if (view.error().message.empty()) std::abort();
    return 0;
  }
  const std::string written = FormatViewRecord(*view);
  const Result<ViewRecord> again = ParseViewRecord(written, "view.json");
  if (!again || FormatViewRecord(*again) != written) std::abort();
  return 0;
}
