#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <map>

#include "drivers/iidc/features.h"
#include "drivers/iidc/format7.h"
#include "drivers/iidc/frame_info.h"
#include "drivers/iidc/registers.h"
#include "drivers/iidc/trigger_mode.h"

namespace {

using namespace omnihdr;

// Registers that answer with what the input says: each request takes a byte that chooses between
// the value written last, a value from the input, and an error.
class FuzzedBus final : public iidc::RegisterBus {
 public:
  FuzzedBus(const std::uint8_t* data, std::size_t size) : data_(data), size_(size) {}
  Result<std::uint32_t> ReadQuadlet(std::uint64_t address, Nanoseconds) override {
    const std::uint8_t choice = Next();
    if (choice >= 0xF8) return Fail(ErrorKind::kProtocol, "refused");
    if (choice >= 0xF0) return Fail(ErrorKind::kTemporary, "no answer");
    if (choice % 2 == 0) {
      const auto written = written_.find(address);
      if (written != written_.end()) return written->second;
    }
    std::uint32_t value = 0;
    for (int i = 0; i < 4; ++i) value = value << 8 | Next();
    return value;
  }
  Status WriteQuadlet(std::uint64_t address, std::uint32_t value, Nanoseconds) override {
    if (Next() >= 0xF8) return Fail(ErrorKind::kProtocol, "refused");
    written_[address] = value;
    return {};
  }
  Status ReadBlock(std::uint64_t, std::span<std::uint32_t>, Nanoseconds) override {
    return Fail(ErrorKind::kProtocol, "refused");
  }

 private:
  std::uint8_t Next() { return at_ < size_ ? data_[at_++] : std::uint8_t{0}; }
  const std::uint8_t* data_;
  std::size_t size_;
  std::size_t at_ = 0;
  std::map<std::uint64_t, std::uint32_t> written_;
};

void Check(bool law) {
  if (!law) std::abort();
}

}  // namespace

// Whatever a camera's registers answer, setting it up ends in a setup that can be believed or in an
// error with a message.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  FuzzedBus bus(data, size);
  iidc::RegisterTimeouts timeouts;
  timeouts.settle = Nanoseconds(0);
  timeouts.poll = Nanoseconds(0);
  const iidc::Registers registers(bus, iidc::kRegisterSpace + 0xF00000, timeouts);

  iidc::Format7Request request;
  request.mode = size > 0 ? data[0] % 8 : 0;
  request.width = size > 1 && data[1] % 4 == 0 ? 0 : 64;
  request.height = request.width == 0 ? 0 : 48;
  request.link_packet_bytes = 512;
  const auto format = iidc::SetUpFormat7(registers, request);
  if (format) {
    Check(format->packet_bytes > 0 && format->frame_bytes >= format->image_bytes &&
          format->frame_bytes <= iidc::kMaxFrameBytes && format->width > 0 && format->height > 0);
  } else {
    Check(!format.error().message.empty());
  }
  const auto settled = iidc::SettleFeatures(registers, {100, 200});
  Check(settled || !settled.error().message.empty());
  if (const auto shutter = iidc::Feature::Open(registers, iidc::kShutter, "SHUTTER")) {
    if (const auto range = shutter->ReadRange()) Check(range->minimum <= range->maximum);
    if (const auto set = shutter->SetAbsolute(0.01)) Check(set->raw <= 0xFFF);
  }
  if (const auto enabled = iidc::EnableEmbeddedInfo(registers)) {
    Check(*enabled <= iidc::kEmbeddedAll);
  }
  const auto trigger = iidc::SetUpSoftwareTrigger(registers, 15, 3);
  Check(trigger || !trigger.error().message.empty());
  return 0;
}
