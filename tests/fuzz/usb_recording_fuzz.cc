#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>
#include <string_view>
#include <vector>

#include "drivers/usb/recording.h"
#include "drivers/usb/recording_format.h"

// The calls of a recording, behind its magic: what is taken for a call is written back as the same
// bytes, and a driver that plays it comes to an end.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace omnihdr;
  const std::span<const std::byte> bytes = std::as_bytes(std::span(data, size));
  if (const auto call = usb::DecodeCall(bytes)) {
    const std::vector<std::byte> again = usb::EncodeCall(*call);
    const auto twice = usb::DecodeCall(again);
    if (!twice || usb::EncodeCall(*twice) != again || call->Request().empty()) std::abort();
  }
  const auto magic = std::as_bytes(std::span(usb::kRecordingMagic));
  std::vector<std::byte> recording(magic.begin(), magic.end());
  recording.insert(recording.end(), bytes.begin(), bytes.end());
  auto bus = usb::MakeReplayingBus(std::move(recording));
  if (!bus) std::abort();
  const auto devices = (*bus)->List();
  if (!devices || devices->empty()) return 0;
  const auto device = (*bus)->Open(devices->front());
  if (!device) return 0;
  std::array<std::byte, 4> quadlet{};
  for (int i = 0; i < 4; ++i) {
    if (!(*device)->VendorIn({0x7F, 0x0400, 0xF000}, quadlet, Nanoseconds(0))) break;
  }
  const auto packet = (*device)->PacketBytes(0x81);
  if (packet && *packet < 1) std::abort();
  const auto stream = (*device)->StartStream({});
  if (!stream) return 0;
  for (int i = 0; i < 64; ++i) {
    const auto chunk = (*stream)->Next(Nanoseconds(0));
    if (!chunk && chunk.error().kind != ErrorKind::kTemporary) break;
  }
  (*stream)->Stop(Nanoseconds(0), Nanoseconds(0));
  return 0;
}
