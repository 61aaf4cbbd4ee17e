#pragma once

namespace omnihdr {

// Keeps the process's heap from growing with time: every thread's arena is cut up by what outlives
// a view, and by the buffers of the libraries for pictures, which the C library takes from arenas
// once it has seen some of their size. Two arenas then, and from 1 MB on memory of its own, given
// back when it is freed. Call before the first thread.
void LimitHeap();

}  // namespace omnihdr
