#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "daemon/config.h"

namespace omnihdr {

struct Deletion {
  std::filesystem::path path;  // a session directory, or its views
  std::uint64_t bytes = 0;
  std::string why;
};

// What is to be deleted in the directory of sessions, oldest first. Laws: only what lies in a
// session directory with session.json and ended.json, so never one that is being written, continued
// or still made into views, and never one of `keep`; links are not followed; by size, no more than
// needed.
Result<std::vector<Deletion>> PlanRetention(const std::filesystem::path& sessions,
                                            const RetentionOptions& options, UtcTime now,
                                            const std::vector<std::filesystem::path>& keep);

// Deletes it. A session loses its session.json first: what is left of an interrupted deletion is no
// session.
Status Delete(const Deletion& deletion);

}  // namespace omnihdr
