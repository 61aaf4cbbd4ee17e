#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <memory>
#include <span>

#include "drivers/ladybug/pgr_file.h"

namespace {

using namespace omnihdr;

class MemorySource final : public ladybug::PgrSource {
 public:
  MemorySource(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}
  std::uint64_t size() const override { return size_; }
  Status Read(std::uint64_t offset, std::span<std::byte> to) const override {
    if (offset > size_ || to.size() > size_ - offset) std::abort();
    if (!to.empty()) std::memcpy(to.data(), data_ + offset, to.size());
    return {};
  }

 private:
  const std::uint8_t* data_;
  std::size_t size_;
};

}  // namespace

// A recorded stream: any bytes end in an error or in frames that lie one behind the other within
// them, none read outside.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  auto reader = ladybug::PgrReader::Open(std::make_unique<MemorySource>(data, size));
  if (!reader) {
    if (reader.error().message.empty()) std::abort();
    return 0;
  }
  std::uint64_t end = 0;
  while (true) {
    const auto frame = reader->Next();
    if (!frame) std::abort();
    if (!*frame) return 0;
    if ((*frame)->offset < end || (*frame)->offset + (*frame)->bytes.size() > size) std::abort();
    end = (*frame)->offset + (*frame)->bytes.size();
  }
}
