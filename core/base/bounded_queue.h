#pragma once

#include <chrono>
#include <condition_variable>
#include <cstddef>
#include <cstdint>
#include <deque>
#include <mutex>
#include <optional>
#include <utility>

namespace omnihdr {

enum class PushResult {
  kAccepted,
  kReplacedOldest,  // accepted; the oldest item was dropped to make room, and counted
  kFull,            // refused, and counted
  kClosed,          // refused: the queue is closed
};

// What a full queue does with the next item.
enum class Overflow { kRefuse, kDropOldest };

// A hand-over between threads with a fixed capacity and a stated overflow policy. Law: every item
// pushed is popped exactly once, or counted in dropped(). After Close(), pushes are refused and
// pops drain what is left. All members may be called from any thread.
template <typename T>
class BoundedQueue {
 public:
  explicit BoundedQueue(std::size_t capacity, Overflow overflow = Overflow::kRefuse)
      : capacity_(capacity == 0 ? 1 : capacity), overflow_(overflow) {}

  // Never blocks.
  PushResult TryPush(T item) {
    PushResult result = PushResult::kAccepted;
    {
      std::lock_guard lock(mutex_);
      if (closed_) return PushResult::kClosed;
      if (items_.size() >= capacity_) {
        ++dropped_;
        if (overflow_ == Overflow::kRefuse) return PushResult::kFull;
        items_.pop_front();
        result = PushResult::kReplacedOldest;
      }
      items_.push_back(std::move(item));
    }
    not_empty_.notify_one();
    return result;
  }

  // Waits for room until the deadline passes, then refuses and counts.
  PushResult Push(T item, std::chrono::nanoseconds timeout) {
    {
      std::unique_lock lock(mutex_);
      const bool room = not_full_.wait_for(lock, timeout,
                                           [this] { return closed_ || items_.size() < capacity_; });
      if (closed_) return PushResult::kClosed;
      if (!room) {
        ++dropped_;
        return PushResult::kFull;
      }
      items_.push_back(std::move(item));
    }
    not_empty_.notify_one();
    return PushResult::kAccepted;
  }

  // The oldest item; nothing when the timeout passed or the queue is closed and drained.
  std::optional<T> Pop(std::chrono::nanoseconds timeout) {
    std::optional<T> item;
    {
      std::unique_lock lock(mutex_);
      not_empty_.wait_for(lock, timeout, [this] { return closed_ || !items_.empty(); });
      if (items_.empty()) return std::nullopt;
      item.emplace(std::move(items_.front()));
      items_.pop_front();
    }
    not_full_.notify_one();
    return item;
  }

  void Close() {
    {
      std::lock_guard lock(mutex_);
      closed_ = true;
    }
    not_empty_.notify_all();
    not_full_.notify_all();
  }

  bool closed() const {
    std::lock_guard lock(mutex_);
    return closed_;
  }
  std::size_t size() const {
    std::lock_guard lock(mutex_);
    return items_.size();
  }
  std::size_t capacity() const { return capacity_; }
  // Items refused for lack of room or replaced by newer ones.
  std::uint64_t dropped() const {
    std::lock_guard lock(mutex_);
    return dropped_;
  }

 private:
  const std::size_t capacity_;
  const Overflow overflow_;
  mutable std::mutex mutex_;
  std::condition_variable not_empty_;
  std::condition_variable not_full_;
  std::deque<T> items_;
  bool closed_ = false;
  std::uint64_t dropped_ = 0;
};

}  // namespace omnihdr
