#include "drivers/ladybug/raw_stack.h"

#include <algorithm>
#include <cstring>

namespace omnihdr::ladybug {

Result<Image<std::uint8_t>> StackFromRaw(std::span<const std::byte> bytes, int width, int height) {
  if (width < 1 || height < 1 || width > 16384 || height > 16384) {
    return Fail(ErrorKind::kUsage, "raw frame: sensors of {}x{}: expected 1 to 16384", width,
                height);
  }
  const auto block = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  if (bytes.size() < block * kSensors) {
    return Fail(ErrorKind::kData, "raw frame: {} bytes: expected {} sensors of {}x{}", bytes.size(),
                kSensors, width, height);
  }
  Image<std::uint8_t> stack = Image<std::uint8_t>::Uninitialized(width, height * kSensors);
  for (std::size_t i = 0; i < kRawBlocks.size(); ++i) {
    std::uint8_t* to = stack.row(kRawBlocks[i].sensor * height);
    std::memcpy(to, bytes.data() + i * block, block);
    if (kRawBlocks[i].turned) std::reverse(to, to + block);
  }
  return stack;
}

}  // namespace omnihdr::ladybug
