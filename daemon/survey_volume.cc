#include "daemon/survey_volume.h"

#include <sys/stat.h>
#include <sys/statvfs.h>

#include <cerrno>
#include <system_error>

namespace omnihdr {
namespace {

namespace fs = std::filesystem;

fs::path NearestExisting(const fs::path& path) {
  std::error_code error;
  fs::path existing = fs::absolute(path, error);
  while (!fs::exists(existing, error) && existing.has_parent_path() &&
         existing.parent_path() != existing) {
    existing = existing.parent_path();
  }
  return existing;
}

}  // namespace

Result<VolumeSpace> ReadVolume(const fs::path& path) {
  const fs::path existing = NearestExisting(path);
  struct statvfs volume {};
  if (::statvfs(existing.c_str(), &volume) != 0) {
    return FailErrno(ErrorKind::kIo, fmt::format("{}: free space", existing.string()), errno);
  }
  if ((volume.f_flag & ST_RDONLY) != 0) {
    return Fail(ErrorKind::kIo, "{}: the file system is mounted read-only", existing.string());
  }
  const std::uint64_t block = volume.f_frsize > 0 ? volume.f_frsize : volume.f_bsize;
  if (volume.f_blocks == 0 || block == 0) {
    return Fail(ErrorKind::kIo, "{}: the file system does not tell its size", existing.string());
  }
  return VolumeSpace{std::uint64_t{volume.f_bavail} * block,
                     std::uint64_t{volume.f_blocks} * block};
}

Status CheckSurveyVolume(const fs::path& directory, bool allow_root) {
  if (allow_root) return {};
  const fs::path existing = NearestExisting(directory);
  struct stat here {};
  struct stat root {};
  if (::stat(existing.c_str(), &here) != 0) {
    return FailErrno(ErrorKind::kIo, existing.string(), errno);
  }
  if (::stat("/", &root) != 0) return FailErrno(ErrorKind::kIo, "/", errno);
  if (here.st_dev != root.st_dev) return {};
  return Fail(ErrorKind::kConfig,
              "session.directory: {} is on the root file system: expected a mounted survey volume, "
              "or storage.allow_root = true",
              directory.string());
}

}  // namespace omnihdr
