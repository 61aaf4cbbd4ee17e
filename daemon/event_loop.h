#pragma once

#include <atomic>
#include <chrono>
#include <functional>
#include <future>
#include <memory>
#include <optional>
#include <type_traits>
#include <utility>
#include <vector>

#include "core/base/bounded_queue.h"
#include "core/base/clock.h"
#include "core/base/file.h"
#include "core/base/result.h"

struct sd_event;
struct sd_event_source;

namespace omnihdr {

// Blocks the signals the daemon waits for in this thread and all threads made later; they are then
// read by the event loop alone. Call before any thread exists.
Status BlockSignals();

// The daemon's main loop over sd-event: signals, descriptors, timers, and messages from other
// threads. Nothing in a callback may block. Run() and everything that adds sources belong to one
// thread; Post, Call and Quit may come from any.
class EventLoop {
 public:
  using Callback = std::function<void()>;

  static Result<std::unique_ptr<EventLoop>> Create();
  ~EventLoop();
  EventLoop(const EventLoop&) = delete;
  EventLoop& operator=(const EventLoop&) = delete;

  // SIGTERM and SIGINT (blocked beforehand with BlockSignals).
  Status OnTermination(std::function<void(int signal)> callback);
  // SIGHUP, likewise.
  Status OnHangup(Callback callback);
  // Calls back whenever `fd` is readable.
  Status OnReadable(int fd, Callback callback);
  void StopWatching(int fd);

  // A one-shot timer on CLOCK_MONOTONIC, disarmed until Set. Owned by the loop.
  class Timer {
   public:
    // Calls back at `time` (at once when it has passed); replaces an earlier setting.
    void Set(HostTime time);
    void Disarm();

   private:
    friend class EventLoop;
    sd_event_source* source_ = nullptr;
    Callback callback_;
  };
  Result<Timer*> AddTimer(Callback callback);

  // Runs `message` on the loop's thread, soon. False when too many messages are waiting or the loop
  // has ended: then it will not run.
  [[nodiscard]] bool Post(Callback message);
  // Runs `function` on the loop's thread and gives its value; kTemporary when the loop did not get
  // to it within `timeout` (it is then not run later). Not from the loop's own thread.
  template <typename Function, typename Value = std::invoke_result_t<Function>>
  Result<Value> Call(Function function, std::chrono::nanoseconds timeout);

  // Until Quit. An error is one of the loop itself.
  Status Run();
  void Quit();

 private:
  struct Watch {
    int fd = -1;
    sd_event_source* source = nullptr;
    Callback callback;
  };
  EventLoop();
  void RunMessages();
  void Wake();

  sd_event* event_ = nullptr;
  Fd wake_;
  BoundedQueue<Callback> messages_;
  std::function<void(int)> on_termination_;
  Callback on_hangup_;
  std::vector<std::unique_ptr<Watch>> watches_;
  std::vector<std::unique_ptr<Watch>> retired_;
  std::vector<std::unique_ptr<Timer>> timers_;
};

template <typename Function, typename Value>
Result<Value> EventLoop::Call(Function function, std::chrono::nanoseconds timeout) {
  // Taken by whoever comes first: the loop to run it, or the caller to give up.
  struct Exchange {
    std::promise<Value> promise;
    std::atomic<bool> taken{false};
  };
  const auto exchange = std::make_shared<Exchange>();
  std::future<Value> answer = exchange->promise.get_future();
  const bool posted = Post([exchange, function = std::move(function)]() mutable {
    if (!exchange->taken.exchange(true)) exchange->promise.set_value(function());
  });
  if (!posted) return Fail(ErrorKind::kTemporary, "the daemon is too busy to answer: try again");
  if (answer.wait_for(timeout) != std::future_status::ready) {
    if (!exchange->taken.exchange(true)) {
      return Fail(ErrorKind::kTemporary, "the daemon's main loop did not answer within {} ms",
                  std::chrono::duration_cast<std::chrono::milliseconds>(timeout).count());
    }
    // It is running right now: the loop never blocks, so the value is there in a moment.
  }
  return answer.get();
}

}  // namespace omnihdr
