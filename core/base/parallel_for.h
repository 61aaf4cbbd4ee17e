#pragma once

#include <functional>

namespace omnihdr {

// Runs body(begin, end) over [0, count) in pieces of at least `grain`, on the one worker pool of
// the process. Law: the result must not depend on how the range was cut (each index writes only its
// own output), so that one and eight cores give the same bytes.
void ParallelFor(int count, int grain, const std::function<void(int begin, int end)>& body);

// Limits the pool for the whole process; 0 means one worker per core. Call once, before any work.
void SetWorkerCount(int workers);
int WorkerCount();

}  // namespace omnihdr
