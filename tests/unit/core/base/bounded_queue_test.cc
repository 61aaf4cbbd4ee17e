#include "core/base/bounded_queue.h"

#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <thread>
#include <vector>

namespace omnihdr::bounded_queue_test {
namespace {

using std::chrono::milliseconds;
using std::chrono::seconds;

TEST(BoundedQueue, ItemsLeaveInTheOrderTheyCame) {
  BoundedQueue<int> queue(3);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(queue.TryPush(i), PushResult::kAccepted);
  for (int i = 0; i < 3; ++i) EXPECT_EQ(queue.Pop(milliseconds(0)), i);
  EXPECT_EQ(queue.Pop(milliseconds(0)), std::nullopt);
}

TEST(BoundedQueue, AFullQueueRefusesAndCounts) {
  BoundedQueue<int> queue(1);
  EXPECT_EQ(queue.TryPush(1), PushResult::kAccepted);
  EXPECT_EQ(queue.TryPush(2), PushResult::kFull);
  EXPECT_EQ(queue.Push(3, milliseconds(1)), PushResult::kFull);
  EXPECT_EQ(queue.dropped(), 2U);
  EXPECT_EQ(queue.Pop(milliseconds(0)), 1);
}

TEST(BoundedQueue, AFullQueueThatDropsTheOldestKeepsTheNewest) {
  BoundedQueue<int> queue(2, Overflow::kDropOldest);
  queue.TryPush(1);
  queue.TryPush(2);
  EXPECT_EQ(queue.TryPush(3), PushResult::kReplacedOldest);
  EXPECT_EQ(queue.dropped(), 1U);
  EXPECT_EQ(queue.Pop(milliseconds(0)), 2);
  EXPECT_EQ(queue.Pop(milliseconds(0)), 3);
}

TEST(BoundedQueue, AClosedQueueRefusesAndDrains) {
  BoundedQueue<int> queue(2);
  queue.TryPush(1);
  queue.Close();
  EXPECT_EQ(queue.TryPush(2), PushResult::kClosed);
  EXPECT_EQ(queue.Push(2, seconds(10)), PushResult::kClosed);
  EXPECT_EQ(queue.Pop(seconds(10)), 1);
  EXPECT_EQ(queue.Pop(seconds(10)), std::nullopt);
  EXPECT_EQ(queue.dropped(), 0U);
}

TEST(BoundedQueue, ClosingWakesAWaitingReader) {
  BoundedQueue<int> queue(1);
  std::jthread closer([&] { queue.Close(); });
  EXPECT_EQ(queue.Pop(seconds(30)), std::nullopt);
}

TEST(BoundedQueue, CarriesItemsThatCannotBeCopied) {
  BoundedQueue<std::unique_ptr<int>> queue(1);
  queue.TryPush(std::make_unique<int>(5));
  EXPECT_EQ(**queue.Pop(milliseconds(0)), 5);
}

TEST(BoundedQueue, EveryItemIsPoppedOnceOrCounted) {
  constexpr int kWriters = 3;
  constexpr int kReaders = 2;
  constexpr int kItems = 2000;
  BoundedQueue<int> queue(4);
  std::vector<std::atomic<int>> seen(kWriters * kItems);
  {
    std::vector<std::jthread> readers;
    for (int r = 0; r < kReaders; ++r) {
      readers.emplace_back([&] {
        while (true) {
          const std::optional<int> item = queue.Pop(seconds(30));
          if (!item) return;
          ++seen[static_cast<std::size_t>(*item)];
        }
      });
    }
    {
      std::vector<std::jthread> writers;
      for (int w = 0; w < kWriters; ++w) {
        writers.emplace_back([&, w] {
          for (int i = 0; i < kItems; ++i) {
            // Half of them wait for room, half give up at once.
            if (i % 2 == 0) {
              queue.Push(w * kItems + i, seconds(30));
            } else {
              queue.TryPush(w * kItems + i);
            }
          }
        });
      }
    }
    queue.Close();
  }
  std::uint64_t popped = 0;
  for (const auto& count : seen) {
    ASSERT_LE(count, 1);
    popped += static_cast<std::uint64_t>(count);
  }
  EXPECT_EQ(popped + queue.dropped(), static_cast<std::uint64_t>(kWriters * kItems));
}

}  // namespace
}  // namespace omnihdr::bounded_queue_test
