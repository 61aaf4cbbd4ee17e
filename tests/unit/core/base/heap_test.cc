#include "core/base/heap.h"

#include <gtest/gtest.h>
#include <malloc.h>

#include <cstddef>
#include <cstdlib>

namespace omnihdr::heap_test {
namespace {

TEST(LimitHeap, WhatIsLargeIsMemoryOfItsOwnWhateverHasBeenFreedBefore) {
  if (::mallinfo2().uordblks == 0) {
    GTEST_SKIP() << "another allocator, a sanitizer's, stands in for the C library's";
  }
  LimitHeap();
  constexpr std::size_t kBytes = 6 << 20;
  // The first one freed would teach the C library to take the next from an arena.
  void* volatile memory = std::malloc(kBytes);  // volatile, lest it is left out
  std::free(memory);
  const std::size_t before = ::mallinfo2().hblkhd;
  memory = std::malloc(kBytes);
  EXPECT_GE(::mallinfo2().hblkhd, before + kBytes);
  std::free(memory);
}

}  // namespace
}  // namespace omnihdr::heap_test
