#include "core/base/parallel_for.h"

#include <oneapi/tbb/blocked_range.h>
#include <oneapi/tbb/global_control.h>
#include <oneapi/tbb/parallel_for.h>

#include <memory>
#include <mutex>

namespace omnihdr {
namespace {

std::mutex g_mutex;
std::unique_ptr<tbb::global_control> g_limit;

}  // namespace

void ParallelFor(int count, int grain, const std::function<void(int, int)>& body) {
  if (count <= 0) return;
  tbb::parallel_for(
      tbb::blocked_range<int>(0, count, grain < 1 ? 1 : grain),
      [&body](const tbb::blocked_range<int>& range) { body(range.begin(), range.end()); });
}

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
