#pragma once

#include <string>
#include <string_view>

#include "core/base/result.h"
#include "core/photometry/response.h"

namespace omnihdr {

// A camera response as the JSON object that session.json has under "response" and that stands by
// itself in response files: {"model": "linear", "black": 16}, {"model": "loglinear", "r": [a, b],
// ...}, {"model": "table", "ln_exposure": [256 numbers, three times]}. Other members are ignored,
// so that a calibration's report may stand beside the curve.

// Errors: "file:line: key: value, expected ...".
Result<Response> ParseResponse(std::string_view text, const std::string& name);
// The compact object; ParseResponse of it gives `response` back exactly.
std::string FormatResponse(const Response& response);

// The text of a session.json with its "response" replaced and every other byte as it was. Errors:
// `text` is not a session.json (as ParseSessionInfo).
Result<std::string> ReplaceSessionResponse(std::string_view text, const std::string& name,
                                           const Response& response);

}  // namespace omnihdr
