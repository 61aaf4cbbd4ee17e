#include "drivers/gpio/edge_trigger.h"

#include <fmt/format.h>
#include <sys/eventfd.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

namespace omnihdr::gpio {

Status EdgeTrigger::Start() {
  std::lock_guard lock(mutex_);
  if (fd_.valid()) return {};
  // A semaphore: readable as long as anything waits.
  Fd fd(eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC | EFD_SEMAPHORE));
  if (!fd.valid()) return FailErrno(ErrorKind::kSystem, "gpio trigger: eventfd", errno);
  fd_ = std::move(fd);
  lost_ = 0;
  lost_reason_.clear();
  return {};
}

void EdgeTrigger::Stop() {
  std::lock_guard lock(mutex_);
  fd_.Close();
  waiting_.clear();
}

Result<std::optional<TriggerEvent>> EdgeTrigger::Poll() {
  std::lock_guard lock(mutex_);
  if (!fd_.valid() || waiting_.empty()) return std::nullopt;
  std::uint64_t one = 0;
  if (read(fd_.get(), &one, sizeof one) < 0 && errno != EAGAIN && errno != EINTR) {
    return FailErrno(ErrorKind::kSystem, "gpio trigger: read", errno);
  }
  TriggerEvent event = std::move(waiting_.front());
  waiting_.pop_front();
  return event;
}

LostEvents EdgeTrigger::TakeLost() {
  std::lock_guard lock(mutex_);
  return {std::exchange(lost_, 0), std::exchange(lost_reason_, {})};
}

void EdgeTrigger::Edge(HostTime time, std::uint64_t lost_before, const std::string& lost_reason) {
  std::lock_guard lock(mutex_);
  if (!fd_.valid()) return;
  if (lost_before > 0) {
    lost_ += lost_before;
    lost_reason_ = lost_reason;
  }
  if (waiting_.size() >= kMaxWaiting) {
    ++lost_;
    lost_reason_ = fmt::format("{} edges of the trigger line waited already", kMaxWaiting);
    return;
  }
  TriggerEvent event;
  event.time = time;
  event.lost_before = std::exchange(lost_, 0);
  event.lost_reason = std::exchange(lost_reason_, {});
  waiting_.push_back(std::move(event));
  const std::uint64_t one = 1;
  // Full means that it is readable already.
  [[maybe_unused]] const ssize_t written = write(fd_.get(), &one, sizeof one);
}

}  // namespace omnihdr::gpio
