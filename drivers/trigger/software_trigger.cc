#include "drivers/trigger/software_trigger.h"

#include <sys/eventfd.h>
#include <unistd.h>

#include <cerrno>
#include <utility>

namespace omnihdr {

Status SoftwareTrigger::Start() {
  if (fd_.valid()) return {};
  // A semaphore: readable as long as anything waits.
  Fd fd(eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC | EFD_SEMAPHORE));
  if (!fd.valid()) return FailErrno(ErrorKind::kSystem, "software trigger: eventfd", errno);
  std::lock_guard lock(mutex_);
  fd_ = std::move(fd);
  return {};
}

void SoftwareTrigger::Stop() {
  std::lock_guard lock(mutex_);
  fd_.Close();
  events_ -= waiting_.size();
  waiting_.clear();
}

Result<std::optional<TriggerEvent>> SoftwareTrigger::Poll() {
  std::lock_guard lock(mutex_);
  if (!fd_.valid() || waiting_.empty()) return std::nullopt;
  std::uint64_t one = 0;
  if (read(fd_.get(), &one, sizeof one) < 0 && errno != EAGAIN) {
    return FailErrno(ErrorKind::kSystem, "software trigger: read", errno);
  }
  TriggerEvent event = waiting_.front();
  waiting_.pop_front();
  return event;
}

bool SoftwareTrigger::exhausted() const {
  std::lock_guard lock(mutex_);
  return limit_ > 0 && events_ >= limit_ && waiting_.empty();
}

Status SoftwareTrigger::Fire() {
  std::lock_guard lock(mutex_);
  if (!fd_.valid()) return Fail(ErrorKind::kUnavailable, "software trigger: not started");
  if (limit_ > 0 && events_ >= limit_) {
    return Fail(ErrorKind::kUnavailable, "software trigger: its limit of {} is reached", limit_);
  }
  if (waiting_.size() >= kMaxWaiting) {
    ++lost_;
    return Fail(ErrorKind::kTemporary, "software trigger: {} are waiting already", kMaxWaiting);
  }
  const std::uint64_t one = 1;
  if (write(fd_.get(), &one, sizeof one) < 0) {
    return FailErrno(ErrorKind::kSystem, "software trigger: write", errno);
  }
  TriggerEvent event;
  event.time = clock_.Now();
  event.lost_before = std::exchange(lost_, 0);
  waiting_.push_back(event);
  ++events_;
  return {};
}

}  // namespace omnihdr
