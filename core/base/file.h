#pragma once

#include <cstddef>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/base/result.h"

namespace omnihdr {

// Owns a file descriptor; closes it once.
class Fd {
 public:
  Fd() = default;
  explicit Fd(int fd) : fd_(fd) {}
  Fd(Fd&& other) noexcept : fd_(std::exchange(other.fd_, -1)) {}
  Fd& operator=(Fd&& other) noexcept {
    if (this != &other) {
      Close();
      fd_ = std::exchange(other.fd_, -1);
    }
    return *this;
  }
  ~Fd() { Close(); }
  Fd(const Fd&) = delete;
  Fd& operator=(const Fd&) = delete;
  int get() const { return fd_; }
  bool valid() const { return fd_ >= 0; }
  // Hands the descriptor over to somebody else who closes it.
  int Release() { return std::exchange(fd_, -1); }
  void Close();

 private:
  int fd_ = -1;
};

// Whole content of a file. Fails (naming the path) when it is missing, not a regular file, or
// larger than max_bytes.
Result<std::vector<std::byte>> ReadFile(const std::filesystem::path& path,
                                        std::size_t max_bytes = std::size_t{1} << 31);
Result<std::string> ReadTextFile(const std::filesystem::path& path,
                                 std::size_t max_bytes = std::size_t{1} << 28);

// Writes all bytes to fd, through short writes and EINTR.
Status WriteAll(int fd, std::span<const std::byte> bytes, std::string_view name);

// Writes a new file beside `path` under a temporary name, syncs it, renames it over `path`, and
// syncs the directory: after a power cut the path holds the old content or the new, never a
// mixture.
Status WriteFileAtomic(const std::filesystem::path& path, std::span<const std::byte> bytes);
Status WriteFileAtomic(const std::filesystem::path& path, std::string_view text);

// Makes a directory's entries durable (fsync on the directory).
Status SyncDirectory(const std::filesystem::path& directory);
// Makes a file's content durable.
Status SyncFile(const std::filesystem::path& path);

}  // namespace omnihdr
