#pragma once

#include <cstdint>
#include <filesystem>

#include "core/base/result.h"

namespace omnihdr {

// The file system that sessions are written to.

struct VolumeSpace {
  std::uint64_t free_bytes = 0;  // for a process without privileges
  std::uint64_t total_bytes = 0;
};

// Space on the file system that holds `path`, or that will hold it: of its nearest parent that
// exists. kIo with the path when it cannot be read, when it says nothing, or when the file system
// is mounted read-only.
Result<VolumeSpace> ReadVolume(const std::filesystem::path& path);

// Refuses (kConfig) a directory on the root file system unless `allow_root`: a survey volume that
// is not mounted must not fill the system's own disk.
Status CheckSurveyVolume(const std::filesystem::path& directory, bool allow_root);

}  // namespace omnihdr
