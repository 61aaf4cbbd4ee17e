#pragma once

#include "core/base/result.h"
#include "core/photometry/response.h"
#include "core/session/json.h"

// A response's members inside a larger file. Private to core/session.
namespace omnihdr::json {

Result<Response> ReadResponse(const ObjectReader& json);
ObjectWriter ResponseObject(const Response& response);

}  // namespace omnihdr::json
