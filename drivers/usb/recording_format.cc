#include "drivers/usb/recording_format.h"

#include <fmt/format.h>

#include <algorithm>
#include <string_view>
#include <utility>

#include "drivers/recording/call_bytes.h"

namespace omnihdr::usb {
namespace {

constexpr std::size_t kMaxDevices = 1024;
constexpr std::size_t kMaxPorts = 16;

void Put(recording::CallWriter& out, const DeviceInfo& device) {
  out.Put(device.vendor, 2);
  out.Put(device.product, 2);
  out.Put(static_cast<std::uint32_t>(device.bus), 4);
  out.Put(static_cast<std::uint32_t>(device.address), 4);
  out.Put(device.ports.size(), 1);
  for (const int port : device.ports) out.Put(static_cast<std::uint32_t>(port), 1);
}

DeviceInfo ReadDevice(recording::CallReader& in) {
  DeviceInfo device;
  device.vendor = static_cast<std::uint16_t>(in.Number(2));
  device.product = static_cast<std::uint16_t>(in.Number(2));
  device.bus = static_cast<int>(in.Number(4) & 0x7FFFFFFF);
  device.address = static_cast<int>(in.Number(4) & 0x7FFFFFFF);
  const std::size_t ports = in.Number(1);
  if (ports > kMaxPorts) in.Refuse();
  for (std::size_t i = 0; in.ok() && i < ports; ++i) {
    device.ports.push_back(static_cast<int>(in.Number(1)));
  }
  return device;
}

}  // namespace

std::string RecordedCall::Request() const {
  switch (kind) {
    case Kind::kList:
      return "list the devices";
    case Kind::kOpen:
      return fmt::format("open {}", device.Name());
    case Kind::kIn:
      return fmt::format("read request {:#04x} value {:#06x} index {:#06x}, {} bytes",
                         setup.request, setup.value, setup.index, number);
    case Kind::kOut: {
      std::string data;
      for (std::size_t i = 0; i < std::min<std::size_t>(sent.size(), 16); ++i) {
        data += fmt::format("{:02x}", std::to_integer<unsigned>(sent[i]));
      }
      return fmt::format("write request {:#04x} value {:#06x} index {:#06x}, {} bytes {}",
                         setup.request, setup.value, setup.index, sent.size(), data);
    }
    case Kind::kPacketBytes:
      return fmt::format("packet size of endpoint {:#04x}", number);
    case Kind::kStartStream:
      return fmt::format("start the stream of endpoint {:#04x}", number);
    case Kind::kChunk:
      return "wait for data";
    case Kind::kStopStream:
      return "stop the stream";
  }
  return "?";
}

std::vector<std::byte> EncodeCall(const RecordedCall& call) {
  recording::CallWriter out;
  out.Put(static_cast<std::uint64_t>(call.kind), 1);
  Put(out, call.device);
  out.Put(call.setup.request, 1);
  out.Put(call.setup.value, 2);
  out.Put(call.setup.index, 2);
  out.Put(call.sent);
  out.Put(call.number, 4);
  out.Put(call.error);
  out.Put(call.devices.size(), 4);
  for (const DeviceInfo& device : call.devices) Put(out, device);
  out.Put(call.received);
  out.Put(call.result, 4);
  out.Put((call.chunk.ended_short ? 1U : 0U) | (call.chunk.gap ? 2U : 0U), 1);
  out.Put(std::string_view(call.chunk.error));
  out.Put(call.chunk.bytes);
  return std::move(out).Take();
}

std::optional<RecordedCall> DecodeCall(std::span<const std::byte> bytes) {
  recording::CallReader in(bytes);
  RecordedCall call;
  const std::uint64_t kind = in.Number(1);
  if (kind < 1 || kind > static_cast<std::uint64_t>(RecordedCall::Kind::kStopStream)) {
    return std::nullopt;
  }
  call.kind = static_cast<RecordedCall::Kind>(kind);
  call.device = ReadDevice(in);
  call.setup.request = static_cast<std::uint8_t>(in.Number(1));
  call.setup.value = static_cast<std::uint16_t>(in.Number(2));
  call.setup.index = static_cast<std::uint16_t>(in.Number(2));
  call.sent = in.Bytes();
  call.number = static_cast<std::uint32_t>(in.Number(4));
  call.error = in.OptionalError();
  const std::size_t devices = in.Number(4);
  if (devices > kMaxDevices) return std::nullopt;
  for (std::size_t i = 0; in.ok() && i < devices; ++i) call.devices.push_back(ReadDevice(in));
  call.received = in.Bytes();
  call.result = static_cast<std::uint32_t>(in.Number(4));
  const std::uint64_t flags = in.Number(1);
  call.chunk.ended_short = (flags & 1) != 0;
  call.chunk.gap = (flags & 2) != 0;
  call.chunk.error = in.Text();
  call.chunk.bytes = in.Bytes();
  if (!in.ok() || !in.at_end()) return std::nullopt;
  return call;
}

}  // namespace omnihdr::usb
