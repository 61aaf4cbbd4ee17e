#include "drivers/usb/usb.h"

#include <fmt/format.h>

#include <charconv>

#include "core/base/file.h"

namespace omnihdr::usb {

std::string DeviceInfo::Name() const {
  std::string way;
  for (const int port : ports) way += fmt::format("{}{}", way.empty() ? "-" : ".", port);
  return fmt::format("usb {}{} ({:04x}:{:04x})", bus, way, vendor, product);
}

Status BulkStreamOptions::Validate() const {
  if (transfer_bytes < 512 || transfer_bytes > (std::size_t{64} << 20)) {
    return Fail(ErrorKind::kConfig, "transfer_bytes: {}: expected 512 to 67108864", transfer_bytes);
  }
  if (transfers < 1 || transfers > 64) {
    return Fail(ErrorKind::kConfig, "transfers: {}: expected 1 to 64", transfers);
  }
  if (spare < 1 || spare > 256) {
    return Fail(ErrorKind::kConfig, "spare: {}: expected 1 to 256", spare);
  }
  return {};
}

Status CheckUsbfsMemory(std::size_t bytes, const std::filesystem::path& file) {
  const Result<std::string> text = ReadTextFile(file, 64);
  if (!text) return {};
  std::size_t limit_mib = 0;
  const char* const end = text->data() + text->size();
  const auto read = std::from_chars(text->data(), end, limit_mib);
  if (read.ec != std::errc{} || limit_mib == 0) return {};
  const std::size_t need_mib = (bytes + (std::size_t{1} << 20) - 1) >> 20;
  if (need_mib <= limit_mib) return {};
  return Fail(ErrorKind::kSystem,
              "streaming needs {} MiB of USB buffers, the kernel allows {} MiB for all programs "
              "together ({}): write a larger number into that file, or start the kernel with "
              "usbcore.usbfs_memory_mb={}",
              need_mib, limit_mib, file.string(), 4 * need_mib);
}

}  // namespace omnihdr::usb
