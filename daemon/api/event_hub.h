#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <mutex>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "core/base/bounded_queue.h"
#include "core/base/clock.h"

namespace omnihdr {

// Hands events (triggers, frames, views, changes of state) to whoever listens. A listener that is
// too slow loses its oldest events and is told how many; nobody else notices. Any thread.
class EventHub {
 public:
  class Subscription {
   public:
    // The next event as one line of JSON without newline; nothing when none came in time or the hub
    // is closed (see closed()). After a loss: {"event": "lost", "count": n} first.
    std::optional<std::string> Next(Nanoseconds timeout);
    bool closed() const { return queue_.closed(); }

   private:
    friend class EventHub;
    explicit Subscription(std::size_t capacity) : queue_(capacity, Overflow::kDropOldest) {}
    BoundedQueue<std::string> queue_;
    std::uint64_t told_lost_ = 0;
  };

  EventHub(std::size_t max_subscriptions, std::size_t queue_capacity)
      : max_subscriptions_(max_subscriptions), queue_capacity_(queue_capacity) {}

  // Null when there are too many listeners already, or the hub is closed. Dropping the pointer ends
  // it.
  std::shared_ptr<Subscription> Subscribe();
  // `event` must be an object with a key "event".
  void Publish(const nlohmann::json& event);
  // Wakes all listeners for the last time.
  void Close();

 private:
  const std::size_t max_subscriptions_;
  const std::size_t queue_capacity_;
  std::mutex mutex_;
  bool closed_ = false;
  std::vector<std::weak_ptr<Subscription>> subscriptions_;
};

}  // namespace omnihdr
