#include "core/base/tcp.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/socket.h>

#include <cerrno>
#include <cstdint>
#include <cstring>
#include <optional>

namespace omnihdr {
namespace {

struct SocketAddress {
  sockaddr_storage storage{};
  socklen_t length = 0;
  const sockaddr* get() const { return reinterpret_cast<const sockaddr*>(&storage); }
};

std::optional<SocketAddress> Parse(const std::string& address, int port) {
  SocketAddress result;
  sockaddr_in v4{};
  sockaddr_in6 v6{};
  if (inet_pton(AF_INET, address.c_str(), &v4.sin_addr) == 1) {
    v4.sin_family = AF_INET;
    v4.sin_port = htons(static_cast<std::uint16_t>(port));
    std::memcpy(&result.storage, &v4, sizeof v4);
    result.length = sizeof v4;
    return result;
  }
  if (inet_pton(AF_INET6, address.c_str(), &v6.sin6_addr) == 1) {
    v6.sin6_family = AF_INET6;
    v6.sin6_port = htons(static_cast<std::uint16_t>(port));
    std::memcpy(&result.storage, &v6, sizeof v6);
    result.length = sizeof v6;
    return result;
  }
  return std::nullopt;
}

}  // namespace

bool IsNumericAddress(const std::string& address) { return Parse(address, 0).has_value(); }

Result<Fd> ConnectTcp(const std::string& address, int port, Nanoseconds timeout) {
  const auto where = [&] { return fmt::format("connect to {}:{}", address, port); };
  const std::optional<SocketAddress> to = Parse(address, port);
  if (!to) return Fail(ErrorKind::kConfig, "address: \"{}\": expected a numeric address", address);
  Fd fd(socket(to->storage.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  if (!fd.valid()) return FailErrno(ErrorKind::kSystem, where(), errno);
  if (connect(fd.get(), to->get(), to->length) != 0) {
    if (errno != EINPROGRESS) return FailErrno(ErrorKind::kUnavailable, where(), errno);
    pollfd ready{fd.get(), POLLOUT, 0};
    const int got = poll(&ready, 1, static_cast<int>(timeout.count() / 1'000'000));
    if (got == 0) {
      return Fail(ErrorKind::kTemporary, "{}: no answer within {} ms", where(),
                  timeout.count() / 1'000'000);
    }
    if (got < 0) return FailErrno(ErrorKind::kTemporary, where(), errno);
    int error = 0;
    socklen_t length = sizeof error;
    getsockopt(fd.get(), SOL_SOCKET, SO_ERROR, &error, &length);
    if (error != 0) return FailErrno(ErrorKind::kUnavailable, where(), error);
  }
  const int on = 1;
  setsockopt(fd.get(), IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
  return fd;
}

Result<Fd> ListenTcp(const std::string& address, int port) {
  const auto where = [&] { return fmt::format("listen on {}:{}", address, port); };
  const std::optional<SocketAddress> at = Parse(address, port);
  if (!at) return Fail(ErrorKind::kConfig, "address: \"{}\": expected a numeric address", address);
  Fd fd(socket(at->storage.ss_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0));
  if (!fd.valid()) return FailErrno(ErrorKind::kSystem, where(), errno);
  const int on = 1;
  setsockopt(fd.get(), SOL_SOCKET, SO_REUSEADDR, &on, sizeof on);
  if (bind(fd.get(), at->get(), at->length) != 0 || listen(fd.get(), 64) != 0) {
    return FailErrno(errno == EACCES ? ErrorKind::kPermission : ErrorKind::kUnavailable, where(),
                     errno);
  }
  return fd;
}

int LocalPort(int fd) {
  sockaddr_storage address{};
  socklen_t length = sizeof address;
  if (getsockname(fd, reinterpret_cast<sockaddr*>(&address), &length) != 0) return 0;
  if (address.ss_family == AF_INET) {
    return ntohs(reinterpret_cast<const sockaddr_in*>(&address)->sin_port);
  }
  return address.ss_family == AF_INET6
             ? ntohs(reinterpret_cast<const sockaddr_in6*>(&address)->sin6_port)
             : 0;
}

}  // namespace omnihdr
