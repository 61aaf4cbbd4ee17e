#pragma once

#include <string>

#include "core/base/result.h"
#include "core/photometry/response.h"

namespace omnihdr {

// What --response names: linear, srgb (the inverse of sRGB's transfer curve, for pictures developed
// for screens), or a file: a session.json, whose response is taken, or a response by itself.
Result<Response> ResponseOf(const std::string& name);

}  // namespace omnihdr
