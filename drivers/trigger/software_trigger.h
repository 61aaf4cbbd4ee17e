#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <mutex>

#include "core/base/clock.h"
#include "core/base/file.h"
#include "core/ports/trigger.h"

namespace omnihdr {

// Triggers asked for by a program or a person, handed over through an eventfd.
class SoftwareTrigger final : public TriggerSource {
 public:
  // Requests that may wait to be polled; more are counted as lost.
  static constexpr std::size_t kMaxWaiting = 64;

  // `limit`: events before it is exhausted, 0 = none.
  explicit SoftwareTrigger(std::uint64_t limit = 0) : limit_(limit) {}
  std::string_view kind() const override { return "software"; }
  Status Start() override;
  void Stop() override;
  Result<std::optional<TriggerEvent>> Poll() override;
  int fd() const override { return fd_.get(); }
  bool exhausted() const override;

  // Asks for a picture now. kUnavailable when not started or exhausted, kTemporary when too many
  // wait. Any thread, but not while Start or Stop runs.
  Status Fire();

 private:
  const std::uint64_t limit_;
  const SystemClock clock_;
  Fd fd_;
  mutable std::mutex mutex_;
  std::deque<TriggerEvent> waiting_;
  std::uint64_t lost_ = 0;    // since the last one that was accepted
  std::uint64_t events_ = 0;  // accepted
};

}  // namespace omnihdr
