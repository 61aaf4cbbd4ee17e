#include "core/base/heap.h"

#include <malloc.h>

namespace omnihdr {

void LimitHeap() {
  ::mallopt(M_ARENA_MAX, 2);
  ::mallopt(M_MMAP_THRESHOLD, 1 << 20);  // and no longer by what has been freed
  ::mallopt(M_TRIM_THRESHOLD, 16 << 20);
}

}  // namespace omnihdr
