#include "core/base/parallel_for.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/parallel_for.h>

#include <algorithm>
#include <memory>
#include <mutex>
#include <thread>
#include <vector>

namespace omnihdr {
namespace {

std::mutex g_mutex;
std::unique_ptr<tbb::global_control> g_limit;

}  // namespace

#ifdef __SANITIZE_THREAD__
// The thread sanitizer does not see into the library, and takes all that passes through its pool
// for races: pieces on threads made for them are what it can judge.
void ParallelFor(int count, int grain, const std::function<void(int, int)>& body) {
  const int workers = std::max(2, WorkerCount());
  const int piece = std::max({1, grain, (count + workers - 1) / workers});
  std::vector<std::jthread> threads;
  for (int begin = 0; begin < count; begin += piece) {
    threads.emplace_back(
        [&body, begin, end = std::min(count, begin + piece)] { body(begin, end); });
  }
}
#else
void ParallelFor(int count, int grain, const std::function<void(int, int)>& body) {
  if (count <= 0) return;
  tbb::parallel_for(
      tbb::blocked_range<int>(0, count, grain < 1 ? 1 : grain),
      [&body](const tbb::blocked_range<int>& range) { body(range.begin(), range.end()); });
}
#endif

void SetWorkerCount(int workers) {
  std::lock_guard lock(g_mutex);
  g_limit.reset();
  if (workers > 0) {
    g_limit = std::make_unique<tbb::global_control>(tbb::global_control::max_allowed_parallelism,
                                                    static_cast<std::size_t>(workers));
  }
}

int WorkerCount() {
  return static_cast<int>(
      tbb::global_control::active_value(tbb::global_control::max_allowed_parallelism));
}

}  // namespace omnihdr
