#include "core/base/file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <cerrno>

namespace omnihdr {
namespace {

ErrorKind KindOfErrno(int error_number, ErrorKind otherwise) {
  switch (error_number) {
    case ENOENT:
    case ENOTDIR:
    case EISDIR:
      return ErrorKind::kNoInput;
    case EACCES:
    case EPERM:
    case EROFS:
      return ErrorKind::kPermission;
    default:
      return otherwise;
  }
}

template <typename Container>
Result<Container> ReadWhole(const std::filesystem::path& path, std::size_t max_bytes) {
  Fd fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (!fd.valid()) {
    return FailErrno(KindOfErrno(errno, ErrorKind::kIo), path.string(), errno);
  }
  struct stat info {};
  if (::fstat(fd.get(), &info) != 0) return FailErrno(ErrorKind::kIo, path.string(), errno);
  if (!S_ISREG(info.st_mode)) {
    return Fail(ErrorKind::kNoInput, "{}: not a regular file", path.string());
  }
  if (static_cast<std::size_t>(info.st_size) > max_bytes) {
    return Fail(ErrorKind::kData, "{}: {} bytes, expected at most {}", path.string(), info.st_size,
                max_bytes);
  }
  Container content;
  content.resize(static_cast<std::size_t>(info.st_size));
  std::size_t done = 0;
  while (done < content.size()) {
    const ssize_t n = ::read(fd.get(), content.data() + done, content.size() - done);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return FailErrno(ErrorKind::kIo, path.string(), errno);
    if (n == 0) break;  // shrank while we read
    done += static_cast<std::size_t>(n);
  }
  content.resize(done);
  return content;
}

}  // namespace

void Fd::Close() {
  if (fd_ >= 0) ::close(fd_);
  fd_ = -1;
}

Result<std::vector<std::byte>> ReadFile(const std::filesystem::path& path, std::size_t max_bytes) {
  return ReadWhole<std::vector<std::byte>>(path, max_bytes);
}

Result<std::string> ReadTextFile(const std::filesystem::path& path, std::size_t max_bytes) {
  return ReadWhole<std::string>(path, max_bytes);
}

Status WriteAll(int fd, std::span<const std::byte> bytes, std::string_view name) {
  std::size_t done = 0;
  while (done < bytes.size()) {
    const ssize_t n = ::write(fd, bytes.data() + done, bytes.size() - done);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return FailErrno(ErrorKind::kIo, fmt::format("{}: write", name), errno);
    done += static_cast<std::size_t>(n);
  }
  return {};
}

Status WriteFileAtomic(const std::filesystem::path& path, std::span<const std::byte> bytes) {
  std::filesystem::path temporary = path;
  temporary += ".tmp";
  {
    Fd fd(::open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
    if (!fd.valid()) return FailErrno(ErrorKind::kCannotCreate, temporary.string(), errno);
    Status written = WriteAll(fd.get(), bytes, temporary.string());
    if (written && ::fsync(fd.get()) != 0) {
      written = FailErrno(ErrorKind::kIo, fmt::format("{}: fsync", temporary.string()), errno);
    }
    if (!written) {
      ::unlink(temporary.c_str());
      return written;
    }
  }
  if (::rename(temporary.c_str(), path.c_str()) != 0) {
    const int error_number = errno;
    ::unlink(temporary.c_str());
    return FailErrno(ErrorKind::kIo, fmt::format("{}: rename", path.string()), error_number);
  }
  const std::filesystem::path parent = path.parent_path();
  return SyncDirectory(parent.empty() ? std::filesystem::path(".") : parent);
}

Status WriteFileAtomic(const std::filesystem::path& path, std::string_view text) {
  return WriteFileAtomic(path, std::as_bytes(std::span(text.data(), text.size())));
}

Status SyncDirectory(const std::filesystem::path& directory) {
  Fd fd(::open(directory.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  if (!fd.valid()) return FailErrno(ErrorKind::kIo, directory.string(), errno);
  if (::fsync(fd.get()) != 0) {
    return FailErrno(ErrorKind::kIo, fmt::format("{}: fsync", directory.string()), errno);
  }
  return {};
}

Status SyncFile(const std::filesystem::path& path) {
  Fd fd(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  if (!fd.valid()) return FailErrno(ErrorKind::kIo, path.string(), errno);
  if (::fsync(fd.get()) != 0) {
    return FailErrno(ErrorKind::kIo, fmt::format("{}: fsync", path.string()), errno);
  }
  return {};
}

}  // namespace omnihdr
