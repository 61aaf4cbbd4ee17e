#pragma once

#include <optional>
#include <string>

#include "core/base/clock.h"

namespace omnihdr {

// "2026-01-01T00:00:00.000000000Z".
std::string IsoUtcNanoseconds(UtcTime time);

// "2026-01-01T00:00:00.25Z" as receivers say it; a leap second is second 60. Nothing for anything
// else and for years outside 1970 to 2200.
std::optional<UtcTime> UtcFromText(const std::string& text);

}  // namespace omnihdr
