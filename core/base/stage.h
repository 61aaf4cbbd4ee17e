#pragma once

#include <atomic>
#include <cstdint>
#include <functional>
#include <stop_token>
#include <string>
#include <thread>

#include "core/base/result.h"

namespace omnihdr {

// One named thread of the appliance, scheduled as usual whoever makes it. Constructed running,
// stopped and joined by its destructor. The body loops until its stop token is set, with a deadline
// on every wait, and calls Progress() each time round, so that a supervisor can tell a busy stage
// from a wedged one. An exception that escapes the body ends the stage with an error; it never
// leaves the thread.
class Stage {
 public:
  using Body = std::function<Status(std::stop_token, Stage&)>;

  Stage(std::string name, Body body);
  ~Stage();
  Stage(const Stage&) = delete;
  Stage& operator=(const Stage&) = delete;

  const std::string& name() const { return name_; }
  void Progress() { progress_.fetch_add(1, std::memory_order_relaxed); }
  // Grows while the stage is alive; any thread.
  std::uint64_t progress() const { return progress_.load(std::memory_order_relaxed); }
  bool finished() const { return finished_.load(std::memory_order_acquire); }
  void RequestStop() { thread_.request_stop(); }
  // Waits for the body's end and tells how it ended. Call from one thread only.
  Status Join();

 private:
  const std::string name_;
  std::atomic<std::uint64_t> progress_{0};
  std::atomic<bool> finished_{false};
  Status outcome_;
  std::jthread thread_;  // last: starts when everything else is ready
};

}  // namespace omnihdr
