#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "core/session/session_reader.h"

// Law: whatever is accepted as session.json is written back as a text that reads the same.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace omnihdr;
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const Result<SessionInfo> info = ParseSessionInfo(text, "session.json");
  if (!info) {
    if (info.error().message.empty()) std::abort();
    return 0;
  }
  const std::string written = FormatSessionInfo(*info);
  const Result<SessionInfo> again = ParseSessionInfo(written, "session.json");
  if (!again || FormatSessionInfo(*again) != written) std::abort();
  return 0;
}
