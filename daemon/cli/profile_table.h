#pragma once

#include <nlohmann/json.hpp>
#include <string>

#include "core/base/profile.h"

namespace omnihdr {

// Where the time of a view went, for people: a line a part with wall and CPU time (all threads) in
// milliseconds, means of `views` views (at least 1), the share of the wall time, and how often it
// ran. Tasks that ran side by side stand indented below the part that waited for them, in whose
// time they are contained; what no part accounts for is "elsewhere".
std::string ProfileTable(const Profile::Report& report, int views);

// The same for scripts: {"views", "wall_ms", "cpu_ms", "parts": [{"part", "wall_ms", "cpu_ms",
// "calls", "beside_others"}]}; times are means per view, calls are sums.
nlohmann::json ProfileJson(const Profile::Report& report, int views);

}  // namespace omnihdr
