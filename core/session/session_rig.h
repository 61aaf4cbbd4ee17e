#pragma once

#include <filesystem>
#include <vector>

#include "core/base/result.h"
#include "core/session/session.h"

namespace omnihdr {

// The calibration that lies in a directory (a session's, or a rig file's): rig.toml and the masks
// it names, to be stored with another session. Errors: rig.toml missing or wrong, a mask that is
// missing or lies outside the directory.
Result<std::vector<SessionFile>> ReadRigFiles(const std::filesystem::path& directory);
// The same of a rig file of any name; it becomes rig.toml.
Result<std::vector<SessionFile>> ReadRigFilesOf(const std::filesystem::path& rig_file);

}  // namespace omnihdr
