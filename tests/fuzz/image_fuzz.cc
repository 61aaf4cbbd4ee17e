#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>

#include "core/image/image_io.h"

// PNG, TIFF and JPEG from anywhere: any bytes give a picture or an error.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  const auto image = omnihdr::DecodeImage(std::as_bytes(std::span(data, size)), "fuzz");
  if (image && (image->width() <= 0 || image->height() <= 0)) std::abort();
  return 0;
}
