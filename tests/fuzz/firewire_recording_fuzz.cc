#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <memory>
#include <span>
#include <utility>
#include <vector>

#include "drivers/firewire/recording.h"
#include "drivers/firewire/recording_format.h"
#include "drivers/iidc/firewire_link.h"
#include "drivers/iidc/register_bus.h"

// The calls of a recording, behind its magic: what is taken for a call is written back as the same
// bytes, its packets lie within their batch, and a link that plays it comes to an end.
extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace omnihdr;
  const std::span<const std::byte> bytes = std::as_bytes(std::span(data, size));
  if (const auto call = firewire::DecodeCall(bytes)) {
    const std::vector<std::byte> again = firewire::EncodeCall(*call);
    const auto twice = firewire::DecodeCall(again);
    if (!twice || firewire::EncodeCall(*twice) != again || call->Request().empty()) std::abort();
    for (const firewire::IsoPacket& packet : call->batch.packets) {
      if (packet.begin + packet.length > call->batch.bytes.size()) std::abort();
    }
  }
  const auto magic = std::as_bytes(std::span(firewire::kRecordingMagic));
  std::vector<std::byte> recording(magic.begin(), magic.end());
  recording.insert(recording.end(), bytes.begin(), bytes.end());
  auto bus = firewire::MakeReplayingBus(std::move(recording));
  if (!bus) std::abort();
  const auto nodes = (*bus)->List();
  if (!nodes || nodes->empty()) return 0;
  auto node = (*bus)->Open(nodes->front());
  if (!node) return 0;
  iidc::FirewireLinkOptions options;
  options.pause = Nanoseconds(0);
  options.most_tries = 4;
  options.silence = Nanoseconds(0);
  const std::unique_ptr<iidc::Link> link = iidc::MakeFirewireLink(std::move(*node), options);
  constexpr std::uint64_t kBase = 0xFFFF'F0F0'0000;
  const iidc::Registers registers(*link, kBase, {});
  for (int i = 0; i < 4; ++i) {
    if (!link->ReadQuadlet(kBase + 0x400, std::chrono::milliseconds(5))) break;
  }
  if (!link->PrepareStream(registers, 64) || !link->StartStream(256)) return 0;
  for (int i = 0; i < 64; ++i) {
    auto chunk = link->ReadStream(Nanoseconds(0));
    if (!chunk) {
      if (chunk.error().kind != ErrorKind::kTemporary) break;
      continue;
    }
    if (chunk->bytes.size() > 256) std::abort();
    link->Recycle(std::move(*chunk));
  }
  link->StopStream();
  return 0;
}
