#include "drivers/iidc/register_bus.h"

#include <thread>

#include "drivers/iidc/registers.h"

namespace omnihdr::iidc {

Result<std::uint32_t> Registers::Read(std::uint32_t offset, std::string_view name) const {
  return bus_->ReadQuadlet(base_ + offset, timeouts_.access).Context(name);
}

Status Registers::Write(std::uint32_t offset, std::uint32_t value, std::string_view name) const {
  return bus_->WriteQuadlet(base_ + offset, value, timeouts_.access).Context(name);
}

Result<std::uint32_t> Registers::WriteChecked(std::uint32_t offset, std::uint32_t value,
                                              std::uint32_t mask, std::string_view name) const {
  OMNIHDR_TRY(Write(offset, value, name));
  OMNIHDR_ASSIGN(const std::uint32_t read, Read(offset, name));
  if ((read & mask) != (value & mask)) {
    return Fail(
        ErrorKind::kProtocol,
        "{} ({:#05x}): wrote {:#010x}, read {:#010x}: expected {:#010x} in the bits {:#010x}", name,
        offset, value, read, value & mask, mask);
  }
  return read;
}

Result<std::uint32_t> Registers::WaitFor(std::uint32_t offset, std::uint32_t mask,
                                         std::uint32_t expected, std::string_view name) const {
  const SystemClock clock;
  const HostTime deadline = clock.Now() + timeouts_.settle;
  while (true) {
    OMNIHDR_ASSIGN(const std::uint32_t value, Read(offset, name));
    if ((value & mask) == expected) return value;
    if (clock.Now() >= deadline) {
      return Fail(ErrorKind::kTemporary,
                  "{} ({:#05x}): {:#010x} after {} ms: expected {:#010x} in the bits {:#010x}",
                  name, offset, value, timeouts_.settle.count() / 1'000'000, expected, mask);
    }
    std::this_thread::sleep_for(timeouts_.poll);
  }
}

Registers Registers::At(std::uint32_t quadlet_pointer) const {
  return Registers(*bus_, kRegisterSpace + std::uint64_t{quadlet_pointer} * 4, timeouts_);
}

}  // namespace omnihdr::iidc
