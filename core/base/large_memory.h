#pragma once

#include <cstddef>

namespace omnihdr {

// Memory for arrays of any size, aligned to a cache line at least; throws std::bad_alloc as
// operator new does. Large ones are aligned to huge pages and ask the kernel for them
// (transparent_hugepage = madvise or always; without it nothing changes): what reads another view's
// pixels along curves is slowed down by translations of addresses more than by anything else. Up to
// 192 MB of freed ones, from 256 kB on, are kept for the next ones of their sizes, except under
// sanitizers. Any thread.
void* AllocateLarge(std::size_t bytes);
// Takes what AllocateLarge gave, or null.
void FreeLarge(void* memory) noexcept;

// The same for std::vector.
template <typename T>
struct LargeAllocator {
  using value_type = T;
  LargeAllocator() = default;
  template <typename U>
  LargeAllocator(const LargeAllocator<U>& /*other*/) {}  // NOLINT(google-explicit-constructor)
  T* allocate(std::size_t count) { return static_cast<T*>(AllocateLarge(count * sizeof(T))); }
  void deallocate(T* memory, std::size_t /*count*/) noexcept { FreeLarge(memory); }
  friend bool operator==(const LargeAllocator& /*a*/, const LargeAllocator& /*b*/) { return true; }
};

}  // namespace omnihdr
