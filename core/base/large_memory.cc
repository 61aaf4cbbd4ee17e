#include "core/base/large_memory.h"

#include <sys/mman.h>

#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <limits>
#include <mutex>
#include <new>
#include <vector>

namespace omnihdr {
namespace {

constexpr std::size_t kCacheLine = 64;
constexpr std::size_t kHugePage = std::size_t{2} << 20U;  // of x86-64, and of ARM64 with 4 kB pages
// From here on the last huge page, on average half empty, is a small part of the whole.
constexpr std::size_t kLarge = 4 * kHugePage;
// Freed arrays that are kept for the next one of their size, in bytes together.
constexpr std::size_t kMostKept = std::size_t{128} << 20U;
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
constexpr bool kKeeps = false;  // a sanitizer shall see every array come and go
#else
constexpr bool kKeeps = true;
#endif

struct Block {
  void* memory = nullptr;
  std::size_t bytes = 0;
};

// Arrays of the same few sizes come and go with every view. Given back, each would have to be
// filled with zeros by the kernel before its next use.
class KeptBlocks {
 public:
  // The smallest that does, but not one of which more than a third would lie idle; null: none.
  void* Take(std::size_t bytes) {
    const std::scoped_lock lock(mutex_);
    auto best = free_.end();
    for (auto block = free_.begin(); block != free_.end(); ++block) {
      const bool fits = block->bytes >= bytes && block->bytes / 3 * 2 <= bytes;
      if (fits && (best == free_.end() || block->bytes <= best->bytes)) best = block;
    }
    if (best == free_.end()) return nullptr;
    void* memory = best->memory;
    kept_ -= best->bytes;
    used_.push_back(*best);
    free_.erase(best);
    return memory;
  }
  void Lent(void* memory, std::size_t bytes) {
    const std::scoped_lock lock(mutex_);
    used_.push_back({memory, bytes});
  }
  // Whether it was one of those lent and has been kept, or given back to make room for others.
  bool Return(void* memory) {
    std::vector<void*> dropped;
    {
      const std::scoped_lock lock(mutex_);
      const auto found = std::find_if(used_.begin(), used_.end(),
                                      [&](const Block& block) { return block.memory == memory; });
      if (found == used_.end()) return false;
      free_.push_back(*found);
      kept_ += found->bytes;
      used_.erase(found);
      while (kept_ > kMostKept) {
        dropped.push_back(free_.front().memory);
        kept_ -= free_.front().bytes;
        free_.erase(free_.begin());
      }
    }
    for (void* old : dropped) std::free(old);
    return true;
  }

 private:
  std::mutex mutex_;
  std::vector<Block> used_;  // tens at most
  std::vector<Block> free_;  // longest unused first
  std::size_t kept_ = 0;
};

// Never destroyed: arrays may outlive whatever else is.
KeptBlocks& Kept() {
  static auto* const kept = new KeptBlocks;
  return *kept;
}

bool IsLarge(std::size_t bytes) { return bytes >= kLarge; }

}  // namespace

void* AllocateLarge(std::size_t bytes) {
  const std::size_t alignment = IsLarge(bytes) ? kHugePage : kCacheLine;
  if (bytes > std::numeric_limits<std::size_t>::max() - kHugePage) throw std::bad_alloc();
  const std::size_t rounded = std::max(alignment, (bytes + alignment - 1) / alignment * alignment);
  if (kKeeps && IsLarge(bytes)) {
    if (void* kept = Kept().Take(rounded); kept != nullptr) return kept;
  }
  void* memory = std::aligned_alloc(alignment, rounded);
  if (memory == nullptr) throw std::bad_alloc();
  if (IsLarge(bytes)) {
    // A wish: where the kernel has no huge pages, small ones do.
    static_cast<void>(madvise(memory, rounded, MADV_HUGEPAGE));
    if (kKeeps) Kept().Lent(memory, rounded);
  }
  return memory;
}

void FreeLarge(void* memory) noexcept {
  if (memory == nullptr) return;
  // Only what starts on a huge page can be a large one.
  const bool may_be_large = reinterpret_cast<std::uintptr_t>(memory) % kHugePage == 0;
  if (kKeeps && may_be_large && Kept().Return(memory)) return;
  std::free(memory);
}

}  // namespace omnihdr
