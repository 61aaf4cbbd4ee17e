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
// From here on a freed array is kept: smaller ones the C library keeps by itself.
constexpr std::size_t kPage = 4096;
constexpr std::size_t kLeastKept = 64 * kPage;
// Freed arrays that are kept for the next one of their size, in bytes together.
constexpr std::size_t kMostKept = std::size_t{192} << 20U;
#if defined(__has_feature)
#if __has_feature(address_sanitizer) || __has_feature(thread_sanitizer)
#define OMNIHDR_CLANG_SANITIZER
#endif
#endif
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__) || \
    defined(OMNIHDR_CLANG_SANITIZER)
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
  void* Take(std::size_t bytes, std::size_t alignment) {
    const std::scoped_lock lock(mutex_);
    auto best = free_.end();
    for (auto block = free_.begin(); block != free_.end(); ++block) {
      const bool fits = block->bytes >= bytes && block->bytes / 3 * 2 <= bytes &&
                        reinterpret_cast<std::uintptr_t>(block->memory) % alignment == 0;
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
  std::vector<Block> used_;  // some tens
  std::vector<Block> free_;  // longest unused first
  std::size_t kept_ = 0;
};

// Never destroyed: arrays may outlive whatever else is.
KeptBlocks& Kept() {
  static auto* const kept = new KeptBlocks;
  return *kept;
}

bool IsLarge(std::size_t bytes) { return bytes >= kLarge; }

std::size_t AlignmentOf(std::size_t bytes) {
  if (IsLarge(bytes)) return kHugePage;
  return bytes >= kLeastKept ? kPage : kCacheLine;
}

}  // namespace

void* AllocateLarge(std::size_t bytes) {
  const std::size_t alignment = AlignmentOf(bytes);
  if (bytes > std::numeric_limits<std::size_t>::max() - kHugePage) throw std::bad_alloc();
  const std::size_t rounded = std::max(alignment, (bytes + alignment - 1) / alignment * alignment);
  const bool is_kept = kKeeps && bytes >= kLeastKept;
  if (is_kept) {
    if (void* kept = Kept().Take(rounded, alignment); kept != nullptr) return kept;
  }
  void* memory = std::aligned_alloc(alignment, rounded);
  if (memory == nullptr) throw std::bad_alloc();
  // A wish: where the kernel has no huge pages, small ones do.
  if (IsLarge(bytes)) static_cast<void>(madvise(memory, rounded, MADV_HUGEPAGE));
  if (is_kept) Kept().Lent(memory, rounded);
  return memory;
}

void FreeLarge(void* memory) noexcept {
  if (memory == nullptr) return;
  // Only what starts on a page can be one of those.
  const bool may_be_kept = reinterpret_cast<std::uintptr_t>(memory) % kPage == 0;
  if (kKeeps && may_be_kept && Kept().Return(memory)) return;
  std::free(memory);
}

}  // namespace omnihdr
