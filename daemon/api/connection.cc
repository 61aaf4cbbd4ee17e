#include "daemon/api/connection.h"

#include <poll.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <utility>

namespace omnihdr {
namespace {

constexpr std::size_t kMostThrownAway = std::size_t{1} << 18;

// Whether the socket is ready for it before the deadline.
bool Wait(int fd, short events, HostTime deadline) {
  while (true) {
    const Nanoseconds left = deadline - SystemClock().Now();
    if (left <= Nanoseconds(0)) return false;
    pollfd watched{fd, events, 0};
    const auto ms = std::chrono::ceil<std::chrono::milliseconds>(left).count();
    const int ready = ::poll(&watched, 1, static_cast<int>(std::min<std::int64_t>(ms, 60'000)));
    if (ready > 0) return true;
    if (ready < 0 && errno != EINTR) return false;
  }
}

}  // namespace

bool HttpConnection::Read(HttpReader& reader, HostTime deadline) {
  std::array<char, 4096> piece{};
  while (reader.state() == HttpReader::State::kNeedMore) {
    if (!Wait(fd_.get(), POLLIN, deadline)) return false;
    const ssize_t n = ::recv(fd_.get(), piece.data(), piece.size(), MSG_DONTWAIT);
    if (n < 0 && (errno == EAGAIN || errno == EINTR)) continue;
    if (n <= 0) return false;
    reader.Take(std::string_view(piece.data(), static_cast<std::size_t>(n)));
  }
  return true;
}

bool HttpConnection::Write(std::string_view bytes, HostTime deadline) {
  while (!bytes.empty()) {
    if (!Wait(fd_.get(), POLLOUT, deadline)) return false;
    const ssize_t n = ::send(fd_.get(), bytes.data(), bytes.size(), MSG_DONTWAIT | MSG_NOSIGNAL);
    if (n < 0 && (errno == EAGAIN || errno == EINTR)) continue;
    if (n <= 0) return false;
    bytes.remove_prefix(static_cast<std::size_t>(n));
  }
  return true;
}

void HttpConnection::Finish(HostTime deadline) {
  ::shutdown(fd_.get(), SHUT_WR);
  std::array<char, 4096> piece{};
  for (std::size_t thrown_away = 0; thrown_away < kMostThrownAway;) {
    if (!Wait(fd_.get(), POLLIN, deadline)) return;
    const ssize_t n = ::recv(fd_.get(), piece.data(), piece.size(), MSG_DONTWAIT);
    if (n < 0 && (errno == EAGAIN || errno == EINTR)) continue;
    if (n <= 0) return;
    thrown_away += static_cast<std::size_t>(n);
  }
}

}  // namespace omnihdr
