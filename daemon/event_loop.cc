#include "daemon/event_loop.h"

#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/signalfd.h>
#include <systemd/sd-event.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <csignal>
#include <cstdint>

namespace omnihdr {
namespace {

constexpr std::size_t kMaxMessages = 1024;

sigset_t LoopSignals() {
  sigset_t set;
  sigemptyset(&set);
  sigaddset(&set, SIGTERM);
  sigaddset(&set, SIGINT);
  sigaddset(&set, SIGHUP);
  return set;
}

int CallBack(void* callback) {
  (*static_cast<EventLoop::Callback*>(callback))();
  return 0;
}

std::uint64_t Microseconds(HostTime time) {
  // Rounded up: a timer must not find its moment still to come.
  return time.ns() <= 0 ? 0 : static_cast<std::uint64_t>((time.ns() + 999) / 1000);
}

}  // namespace

Status BlockSignals() {
  const sigset_t set = LoopSignals();
  if (const int error = ::pthread_sigmask(SIG_BLOCK, &set, nullptr); error != 0) {
    return FailErrno(ErrorKind::kSystem, "block signals", error);
  }
  // A peer that hangs up is an error of its write, not the end of the daemon; a file over its size
  // limit likewise.
  std::signal(SIGPIPE, SIG_IGN);
  std::signal(SIGXFSZ, SIG_IGN);
  return {};
}

EventLoop::EventLoop() : messages_(kMaxMessages) {}

EventLoop::~EventLoop() {
  messages_.Close();
  for (const auto& timer : timers_) sd_event_source_unref(timer->source_);
  for (const auto& watch : watches_) sd_event_source_unref(watch->source);
  sd_event_unref(event_);
}

Result<std::unique_ptr<EventLoop>> EventLoop::Create() {
  std::unique_ptr<EventLoop> loop(new EventLoop());
  if (const int error = sd_event_new(&loop->event_); error < 0) {
    return FailErrno(ErrorKind::kSystem, "event loop", -error);
  }
  loop->wake_ = Fd(::eventfd(0, EFD_CLOEXEC | EFD_NONBLOCK));
  if (!loop->wake_.valid()) return FailErrno(ErrorKind::kSystem, "event loop: eventfd", errno);
  EventLoop* self = loop.get();
  OMNIHDR_TRY(loop->OnReadable(loop->wake_.get(), [self] { self->RunMessages(); }));
  return loop;
}

Status EventLoop::OnTermination(std::function<void(int)> callback) {
  on_termination_ = std::move(callback);
  const auto handler = [](sd_event_source*, const signalfd_siginfo* info, void* self) -> int {
    static_cast<EventLoop*>(self)->on_termination_(static_cast<int>(info->ssi_signo));
    return 0;
  };
  for (const int signal : {SIGTERM, SIGINT}) {
    if (const int error = sd_event_add_signal(event_, nullptr, signal, handler, this); error < 0) {
      return FailErrno(ErrorKind::kSystem, "event loop: wait for signals", -error);
    }
  }
  return {};
}

Status EventLoop::OnHangup(Callback callback) {
  on_hangup_ = std::move(callback);
  const auto handler = [](sd_event_source*, const signalfd_siginfo*, void* function) -> int {
    return CallBack(function);
  };
  if (const int error = sd_event_add_signal(event_, nullptr, SIGHUP, handler, &on_hangup_);
      error < 0) {
    return FailErrno(ErrorKind::kSystem, "event loop: wait for SIGHUP", -error);
  }
  return {};
}

Status EventLoop::OnReadable(int fd, Callback callback) {
  auto watch = std::make_unique<Watch>();
  watch->fd = fd;
  watch->callback = std::move(callback);
  const auto handler = [](sd_event_source*, int, std::uint32_t, void* function) {
    return CallBack(function);
  };
  if (const int error =
          sd_event_add_io(event_, &watch->source, fd, EPOLLIN, handler, &watch->callback);
      error < 0) {
    return FailErrno(ErrorKind::kSystem, "event loop: watch a descriptor", -error);
  }
  watches_.push_back(std::move(watch));
  return {};
}

void EventLoop::StopWatching(int fd) {
  for (auto it = watches_.begin(); it != watches_.end();) {
    if ((*it)->fd != fd) {
      ++it;
      continue;
    }
    sd_event_source_set_enabled((*it)->source, SD_EVENT_OFF);
    (*it)->source = sd_event_source_unref((*it)->source);
    // The call may come from the callback itself: it is destroyed when the loop comes round.
    retired_.push_back(std::move(*it));
    it = watches_.erase(it);
    Wake();
  }
}

Result<EventLoop::Timer*> EventLoop::AddTimer(Callback callback) {
  auto timer = std::make_unique<Timer>();
  timer->callback_ = std::move(callback);
  const auto handler = [](sd_event_source*, std::uint64_t, void* function) {
    return CallBack(function);
  };
  // An accuracy of 1 us: a trigger must not wait for others to be bundled with it.
  if (const int error = sd_event_add_time(event_, &timer->source_, CLOCK_MONOTONIC, UINT64_MAX, 1,
                                          handler, &timer->callback_);
      error < 0) {
    return FailErrno(ErrorKind::kSystem, "event loop: timer", -error);
  }
  timer->Disarm();
  timers_.push_back(std::move(timer));
  return timers_.back().get();
}

void EventLoop::Timer::Set(HostTime time) {
  sd_event_source_set_time(source_, Microseconds(time));
  sd_event_source_set_enabled(source_, SD_EVENT_ONESHOT);
}

void EventLoop::Timer::Disarm() { sd_event_source_set_enabled(source_, SD_EVENT_OFF); }

bool EventLoop::Post(Callback message) {
  if (messages_.TryPush(std::move(message)) != PushResult::kAccepted) return false;
  Wake();
  return true;
}

void EventLoop::Wake() {
  const std::uint64_t one = 1;
  // Fails only when the counter is at its end, and then the loop is awake anyhow.
  [[maybe_unused]] const ssize_t written = ::write(wake_.get(), &one, sizeof(one));
}

void EventLoop::RunMessages() {
  std::uint64_t count = 0;
  [[maybe_unused]] const ssize_t got = ::read(wake_.get(), &count, sizeof(count));
  retired_.clear();
  // No more than were there at the start: messages that make messages must not starve the triggers.
  for (std::size_t left = messages_.size(); left > 0; --left) {
    std::optional<Callback> message = messages_.Pop(std::chrono::nanoseconds(0));
    if (!message) return;
    (*message)();
  }
  if (messages_.size() > 0) Wake();
}

Status EventLoop::Run() {
  const int error = sd_event_loop(event_);
  messages_.Close();
  if (error < 0) return FailErrno(ErrorKind::kSystem, "event loop", -error);
  return {};
}

void EventLoop::Quit() {
  if (!Post([this] { sd_event_exit(event_, 0); })) sd_event_exit(event_, 0);
}

}  // namespace omnihdr
