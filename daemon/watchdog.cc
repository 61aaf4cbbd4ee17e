#include "daemon/watchdog.h"

#include <fmt/format.h>
#include <systemd/sd-daemon.h>

#include <cstddef>
#include <cstdlib>
#include <cstring>
#include <utility>

namespace omnihdr {
namespace {

// More than a start, some reloads and a stop; the oldest go first, the last one is what counts.
constexpr std::size_t kMostKept = 8;

}  // namespace

ServiceNotifier::ServiceNotifier() {
  const char* path = std::getenv("NOTIFY_SOCKET");
  if (path == nullptr || (path[0] != '/' && path[0] != '@')) return;
  const std::size_t length = std::strlen(path);
  if (length < 2 || length >= sizeof address_.sun_path) return;
  address_.sun_family = AF_UNIX;
  std::memcpy(address_.sun_path, path, length);
  // A name without a file begins with a zero byte.
  if (path[0] == '@') address_.sun_path[0] = '\0';
  address_length_ = static_cast<socklen_t>(offsetof(sockaddr_un, sun_path) + length);
  socket_ = Fd(::socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0));
}

void ServiceNotifier::Ready() { Tell("READY=1"); }

void ServiceNotifier::Reloading(HostTime now) {
  Tell(fmt::format("RELOADING=1\nMONOTONIC_USEC={}", now.ns() / 1000));
}

void ServiceNotifier::Stopping() { Tell("STOPPING=1"); }

void ServiceNotifier::StatusText(std::string_view text) {
  std::lock_guard lock(mutex_);
  kept_status_ = fmt::format("STATUS={}", text);
  SendKept();
}

void ServiceNotifier::FeedWatchdog() {
  std::lock_guard lock(mutex_);
  SendKept();
  Send("WATCHDOG=1");
}

void ServiceNotifier::Retry() {
  std::lock_guard lock(mutex_);
  SendKept();
}

void ServiceNotifier::Tell(std::string message) {
  std::lock_guard lock(mutex_);
  if (kept_.size() >= kMostKept) kept_.pop_front();
  kept_.push_back(std::move(message));
  SendKept();
}

void ServiceNotifier::SendKept() {
  while (!kept_.empty() && Send(kept_.front())) kept_.pop_front();
  if (kept_status_ && Send(*kept_status_)) kept_status_.reset();
}

// Whether there was room for it.
bool ServiceNotifier::Send(std::string_view message) const {
  if (!socket_.valid()) return true;
  return ::sendto(socket_.get(), message.data(), message.size(), MSG_NOSIGNAL,
                  reinterpret_cast<const sockaddr*>(&address_), address_length_) >= 0;
}

std::optional<Nanoseconds> ServiceNotifier::WatchdogInterval() const {
  std::uint64_t interval_us = 0;
  if (sd_watchdog_enabled(0, &interval_us) <= 0 || interval_us == 0) return std::nullopt;
  return std::chrono::microseconds(interval_us);
}

}  // namespace omnihdr
