#pragma once

#include <cstddef>
#include <cstdint>
#include <deque>
#include <mutex>
#include <string>

#include "core/base/clock.h"
#include "core/base/file.h"
#include "core/ports/trigger.h"

namespace omnihdr::gpio {

// Triggers by the edges of a line, handed over from the thread that reads the line. Edges while it
// is stopped are ignored.
class EdgeTrigger final : public TriggerSource {
 public:
  // Edges that may wait to be polled; more are lost, counted and told of by the next one.
  static constexpr std::size_t kMaxWaiting = 64;

  std::string_view kind() const override { return "gpio"; }
  Status Start() override;
  void Stop() override;
  Result<std::optional<TriggerEvent>> Poll() override;
  int fd() const override { return fd_.get(); }
  LostEvents TakeLost() override;

  // An edge and what was lost before it. From one other thread.
  void Edge(HostTime time, std::uint64_t lost_before, const std::string& lost_reason);

 private:
  Fd fd_;
  mutable std::mutex mutex_;
  std::deque<TriggerEvent> waiting_;
  std::uint64_t lost_ = 0;
  std::string lost_reason_;
};

}  // namespace omnihdr::gpio
