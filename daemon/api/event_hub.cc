#include "daemon/api/event_hub.h"

#include <fmt/format.h>

#include <algorithm>

namespace omnihdr {

std::optional<std::string> EventHub::Subscription::Next(Nanoseconds timeout) {
  if (const std::uint64_t lost = queue_.dropped(); lost > told_lost_) {
    const std::uint64_t count = lost - told_lost_;
    told_lost_ = lost;
    return fmt::format(R"({{"event":"lost","count":{}}})", count);
  }
  return queue_.Pop(timeout);
}

std::shared_ptr<EventHub::Subscription> EventHub::Subscribe() {
  std::lock_guard lock(mutex_);
  std::erase_if(subscriptions_, [](const auto& weak) { return weak.expired(); });
  if (closed_ || subscriptions_.size() >= max_subscriptions_) return nullptr;
  std::shared_ptr<Subscription> subscription(new Subscription(queue_capacity_));
  subscriptions_.push_back(subscription);
  return subscription;
}

void EventHub::Publish(const nlohmann::json& event) {
  std::lock_guard lock(mutex_);
  std::string text;
  for (const auto& weak : subscriptions_) {
    const std::shared_ptr<Subscription> subscription = weak.lock();
    if (!subscription) continue;
    if (text.empty()) {
      text = event.dump(-1, ' ', false, nlohmann::json::error_handler_t::replace);
    }
    subscription->queue_.TryPush(text);
  }
}

void EventHub::Close() {
  std::lock_guard lock(mutex_);
  closed_ = true;
  for (const auto& weak : subscriptions_) {
    if (const std::shared_ptr<Subscription> subscription = weak.lock()) {
      subscription->queue_.Close();
    }
  }
}

}  // namespace omnihdr
