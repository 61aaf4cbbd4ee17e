#pragma once

#include <memory>

#include "core/base/clock.h"

namespace omnihdr {

// From here on the calling thread, and every worker of the pool from the moment it first helps in
// one of this thread's parallel loops while this lives, run at the lowest priority: nice 19 and
// SCHED_BATCH, which yields the processor to whoever has woken up. For work that must not delay
// capture. The kernel lets a thread without privileges only go down: what was lowered stays so,
// and whoever must not wait keeps out of ParallelFor. Refused by the kernel, it has no effect.
class BackgroundThread {
 public:
  BackgroundThread();
  ~BackgroundThread();
  BackgroundThread(const BackgroundThread&) = delete;
  BackgroundThread& operator=(const BackgroundThread&) = delete;

 private:
  class Observer;
  std::unique_ptr<Observer> observer_;
};

// How long this process's lowered threads have stood ready while others had the processors, in all.
// Programs that compute at usual priority can starve them for minutes. None where the kernel does
// not tell.
Nanoseconds BackgroundWait();

}  // namespace omnihdr
