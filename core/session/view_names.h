#pragma once

#include <filesystem>
#include <optional>
#include <string>

#include "core/base/units.h"

namespace omnihdr {

// Names inside a views directory. Private to core/session.

// "000003" is position 3; anything else is none.
std::optional<PositionId> PositionFromName(const std::string& name);
// Where a view is written until it is whole: "VIEWS/.000003.tmp".
std::filesystem::path TemporaryViewName(const std::filesystem::path& views, PositionId position);
bool IsTemporaryViewName(const std::string& name);

}  // namespace omnihdr
