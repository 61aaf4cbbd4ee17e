#include "core/base/large_memory.h"

#include <gtest/gtest.h>

#include <cstdint>
#include <limits>
#include <new>
#include <numeric>
#include <vector>

namespace omnihdr::large_memory_test {
namespace {

TEST(LargeMemory, SmallArraysStartOnACacheLineAndLargeOnesOnAHugePage) {
  for (const std::size_t bytes : {std::size_t{0}, std::size_t{1}, std::size_t{100}}) {
    void* memory = AllocateLarge(bytes);
    ASSERT_NE(memory, nullptr);
    EXPECT_EQ(reinterpret_cast<std::uintptr_t>(memory) % 64, 0U);
    FreeLarge(memory);
  }
  void* memory = AllocateLarge((std::size_t{9} << 20U) + 3);
  EXPECT_EQ(reinterpret_cast<std::uintptr_t>(memory) % (std::size_t{2} << 20U), 0U);
  FreeLarge(memory);
}

TEST(LargeMemory, MoreThanCanBeAddressedThrowsAsOperatorNewDoes) {
  EXPECT_THROW(AllocateLarge(std::numeric_limits<std::size_t>::max()), std::bad_alloc);
  FreeLarge(nullptr);
}

TEST(LargeMemory, AVectorOfItHoldsItsValues) {
  std::vector<std::uint32_t, LargeAllocator<std::uint32_t>> values(3'000'000);
  std::iota(values.begin(), values.end(), 1U);
  values.resize(4'000'000, 7U);
  EXPECT_EQ(values.front(), 1U);
  EXPECT_EQ(values[2'999'999], 3'000'000U);
  EXPECT_EQ(values.back(), 7U);
}

}  // namespace
}  // namespace omnihdr::large_memory_test
