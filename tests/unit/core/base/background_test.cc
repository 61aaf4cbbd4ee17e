#include "core/base/background.h"

#include <gtest/gtest.h>
#include <sched.h>
#include <sys/resource.h>
#include <sys/syscall.h>
#include <unistd.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <fstream>
#include <functional>
#include <thread>
#include <vector>

#include "core/base/parallel_for.h"

namespace omnihdr::background_test {
namespace {

bool IsLowered() {
  const auto thread = static_cast<id_t>(::syscall(SYS_gettid));
  return ::getpriority(PRIO_PROCESS, thread) == 19 && ::sched_getscheduler(0) == SCHED_BATCH;
}

// Two pieces that wait for each other, so that a worker must take one; false when none came.
bool RunOnTwoThreads(const std::function<void()>& body) {
  std::atomic<int> arrived = 0;
  ParallelFor(2, 1, [&](int begin, int end) {
    for (int k = begin; k < end; ++k) {
      body();
      ++arrived;
      const auto give_up = std::chrono::steady_clock::now() + std::chrono::seconds(5);
      while (arrived < 2 && begin + 1 == end && std::chrono::steady_clock::now() < give_up) {
        std::this_thread::yield();
      }
    }
  });
  return arrived == 2;
}

TEST(BackgroundThread, WorkersThatHelpItAreLoweredWhoeverMadeThem) {
  if (WorkerCount() < 2) GTEST_SKIP() << "one processor: no workers";
  // Workers made at normal priority, by somebody else.
  ASSERT_TRUE(RunOnTwoThreads([] {}));
  std::atomic<int> pieces = 0;
  std::atomic<int> lowered = 0;
  std::thread background([&] {
    const BackgroundThread low;
    for (int i = 0; i < 20; ++i) {
      EXPECT_TRUE(RunOnTwoThreads([&] {
        ++pieces;
        lowered += IsLowered() ? 1 : 0;
      }));
    }
  });
  background.join();
  EXPECT_EQ(pieces, 40);
  EXPECT_EQ(lowered, pieces);
}

TEST(BackgroundThread, OtherThreadsKeepTheirPriority) {
  std::thread background([] {
    const BackgroundThread low;
    EXPECT_TRUE(IsLowered());
  });
  background.join();
  EXPECT_FALSE(IsLowered());
  std::thread other([] { EXPECT_FALSE(IsLowered()); });
  other.join();
}

TEST(BackgroundThread, TellsHowLongOthersHadTheProcessors) {
  if (!std::ifstream("/proc/self/schedstat")) GTEST_SKIP() << "the kernel keeps no such statistics";
  std::atomic<bool> stop = false;
  const auto compute = [&] {
    while (!stop) {
    }
  };
  const unsigned processors = std::max(1U, std::thread::hardware_concurrency());
  const Nanoseconds before = BackgroundWait();
  std::vector<std::thread> threads;
  for (unsigned i = 0; i < processors; ++i) threads.emplace_back(compute);
  threads.emplace_back([&] {
    const BackgroundThread low;
    compute();
  });
  // It stands behind them until they end; it need not have been told of the end to be counted.
  const auto give_up = std::chrono::steady_clock::now() + std::chrono::seconds(20);
  Nanoseconds waited{0};
  while (waited < std::chrono::milliseconds(50) && std::chrono::steady_clock::now() < give_up) {
    std::this_thread::sleep_for(std::chrono::milliseconds(10));
    waited = BackgroundWait() - before;
  }
  stop = true;
  for (std::thread& thread : threads) thread.join();
  EXPECT_GE(waited, std::chrono::milliseconds(50));
}

}  // namespace
}  // namespace omnihdr::background_test
