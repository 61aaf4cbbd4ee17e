#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>

#include "drivers/ladybug/jpeg_frame.h"

// A compressed frame: any bytes give six mosaics or an error with a message; blocks that are
// accepted lie within the data.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace omnihdr;
  const std::span<const std::byte> frame = std::as_bytes(std::span(data, size));
  const auto header = ladybug::ParseJpegFrame(frame);
  if (!header) {
    if (header.error().message.empty()) std::abort();
    return 0;
  }
  for (const auto& sensor : header->blocks) {
    for (const ladybug::JpegBlock& block : sensor) {
      if (std::uint64_t{block.offset} + block.bytes > size) std::abort();
    }
  }
  const auto stack = ladybug::DecodeJpegFrame(frame, *header, 16, 12);
  if (stack && (stack->width() != 16 || stack->height() != 72)) std::abort();
  return 0;
}
