#include "daemon/api/token.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstdlib>

#include "core/base/file.h"

namespace omnihdr {

Result<std::string> ReadToken(const std::filesystem::path& file, bool credential) {
  // What is checked is what is read: by one descriptor.
  const Fd fd(::open(file.c_str(), O_RDONLY | O_CLOEXEC | O_NOCTTY | O_NONBLOCK));
  if (!fd.valid()) return FailErrno(ErrorKind::kNoInput, file.string(), errno);
  struct stat info {};
  if (::fstat(fd.get(), &info) != 0) return FailErrno(ErrorKind::kIo, file.string(), errno);
  if (!S_ISREG(info.st_mode)) {
    return Fail(ErrorKind::kPermission, "{}: expected a regular file", file.string());
  }
  const mode_t refused = credential ? S_IWGRP | S_IXGRP | S_IRWXO : S_IRWXG | S_IRWXO;
  if ((info.st_mode & refused) != 0) {
    return Fail(ErrorKind::kPermission,
                "{}: mode {:04o}, expected a token that its owner alone may read (chmod 600)",
                file.string(), info.st_mode & 07777U);
  }
  if (info.st_uid != 0 && info.st_uid != ::geteuid()) {
    return Fail(ErrorKind::kPermission, "{}: owned by user {}, expected root or user {}",
                file.string(), info.st_uid, ::geteuid());
  }
  std::array<char, kMaxTokenBytes + 2> bytes{};
  std::size_t size = 0;
  while (size < bytes.size()) {
    const ssize_t n = ::read(fd.get(), bytes.data() + size, bytes.size() - size);
    if (n < 0 && errno == EINTR) continue;
    if (n < 0) return FailErrno(ErrorKind::kIo, file.string(), errno);
    if (n == 0) break;
    size += static_cast<std::size_t>(n);
  }
  std::string token(bytes.data(), size);
  if (!token.empty() && token.back() == '\n') token.pop_back();
  const bool visible =
      std::all_of(token.begin(), token.end(), [](char c) { return c > 0x20 && c < 0x7F; });
  if (!visible || token.size() < kMinTokenBytes || token.size() > kMaxTokenBytes) {
    return Fail(ErrorKind::kConfig, "{}: expected a token of {} to {} visible ASCII characters",
                file.string(), kMinTokenBytes, kMaxTokenBytes);
  }
  return token;
}

Result<std::string> FindToken(const std::string& configured_file) {
  if (!configured_file.empty()) return ReadToken(configured_file, false).Context("api.token_file");
  const char* const directory = std::getenv("CREDENTIALS_DIRECTORY");
  if (directory != nullptr && *directory != '\0') {
    const std::filesystem::path file = std::filesystem::path(directory) / kTokenCredential;
    std::error_code error;
    if (std::filesystem::exists(file, error)) {
      return ReadToken(file, true).Context("credential api-token");
    }
  }
  return Fail(ErrorKind::kConfig,
              "api.token_file: \"\", expected a file with a token, or the service's credential "
              "\"{}\", with api.tcp",
              kTokenCredential);
}

bool SameToken(std::string_view presented, std::string_view token) {
  if (token.empty()) return false;
  unsigned difference = presented.size() == token.size() ? 0U : 1U;
  for (std::size_t i = 0; i < presented.size(); ++i) {
    difference |= static_cast<unsigned char>(presented[i]) ^
                  static_cast<unsigned char>(token[i % token.size()]);
  }
  return difference == 0;
}

}  // namespace omnihdr
