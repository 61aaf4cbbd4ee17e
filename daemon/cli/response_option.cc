#include "daemon/cli/response_option.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "core/base/file.h"
#include "core/session/response_json.h"
#include "core/session/session_reader.h"

namespace omnihdr {
namespace {

Result<Response> SrgbResponse() {
  std::array<std::vector<double>, 3> ln;
  for (std::vector<double>& channel : ln) {
    for (int z = 0; z < 256; ++z) {
      const double v = std::max(z, 1) / 255.0 * (z == 0 ? 0.5 : 1.0);
      const double linear = v <= 0.04045 ? v / 12.92 : std::pow((v + 0.055) / 1.055, 2.4);
      channel.push_back(std::log(linear));
    }
  }
  return Response::Table(ln);
}

}  // namespace

Result<Response> ResponseOf(const std::string& name) {
  if (name == "linear") return Response::Linear();
  if (name == "srgb") return SrgbResponse();
  OMNIHDR_ASSIGN(const std::string text, ReadTextFile(name));
  if (text.find("omnihdr-session") == std::string::npos) return ParseResponse(text, name);
  OMNIHDR_ASSIGN(const SessionInfo info, ParseSessionInfo(text, name));
  return info.response;
}

}  // namespace omnihdr
