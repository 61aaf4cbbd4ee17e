#include <cmath>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "core/session/response_json.h"
#include "core/session/session_reader.h"

namespace {

using namespace omnihdr;

// Law: a response that was read rises with the value, and what is written of it reads back the
// same.
void CheckResponse(const Response& response) {
  const std::string written = FormatResponse(response);
  const Result<Response> again = ParseResponse(written, "again.json");
  if (!again || FormatResponse(*again) != written) std::abort();
  for (int c = 0; c < 3; ++c) {
    double before = 0.0;
    for (int z = 0; z < 256; ++z) {
      const double e = response.ExposureFromValue(c, z);
      if (std::isnan(e) || e < before) std::abort();
      before = e;
    }
  }
}

// Law: a session.json with another response says that response and otherwise what it said; putting
// it there once more changes no byte.
void CheckReplaced(std::string_view text, const SessionInfo& info, const Response& response) {
  const Result<std::string> replaced = ReplaceSessionResponse(text, "session.json", response);
  if (!replaced) {
    if (replaced.error().message.empty()) std::abort();
    return;
  }
  Result<SessionInfo> changed = ParseSessionInfo(*replaced, "session.json");
  if (!changed || FormatResponse(changed->response) != FormatResponse(response)) std::abort();
  changed->response = info.response;
  if (FormatSessionInfo(*changed) != FormatSessionInfo(info)) std::abort();
  const Result<std::string> twice = ReplaceSessionResponse(*replaced, "session.json", response);
  if (!twice || *twice != *replaced) std::abort();
}

}  // namespace

// The bytes are a response, or a session.json that gets another one.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const std::string_view text(reinterpret_cast<const char*>(data), size);
  const Result<Response> response = ParseResponse(text, "response.json");
  if (response) {
    CheckResponse(*response);
  } else if (response.error().message.empty()) {
    std::abort();
  }
  const Result<SessionInfo> info = ParseSessionInfo(text, "session.json");
  if (!info) {
    if (ReplaceSessionResponse(text, "session.json", Response::Linear().value())) std::abort();
    return 0;
  }
  CheckReplaced(text, *info, Response::Linear(7.5).value());
  CheckReplaced(text, *info,
                Response::LogLinear({{{0.02, -1.5}, {0.021, -1.4}, {0.019, -1.6}}}).value());
  return 0;
}
