#include "drivers/usb/recording_format.h"

#include <fmt/format.h>

#include <algorithm>
#include <utility>

namespace omnihdr::usb {
namespace {

constexpr std::size_t kMaxDevices = 1024;
constexpr std::size_t kMaxPorts = 16;

class Writer {
 public:
  void Put(std::uint64_t value, int bytes) {
    for (int i = 0; i < bytes; ++i) out_.push_back(static_cast<std::byte>(value >> (8 * i) & 0xFF));
  }
  void Put(std::span<const std::byte> bytes) {
    Put(bytes.size(), 4);
    out_.insert(out_.end(), bytes.begin(), bytes.end());
  }
  void Put(std::string_view text) { Put(std::as_bytes(std::span(text))); }
  void Put(const DeviceInfo& device) {
    Put(device.vendor, 2);
    Put(device.product, 2);
    Put(static_cast<std::uint32_t>(device.bus), 4);
    Put(static_cast<std::uint32_t>(device.address), 4);
    Put(device.ports.size(), 1);
    for (const int port : device.ports) Put(static_cast<std::uint32_t>(port), 1);
  }
  std::vector<std::byte> Take() && { return std::move(out_); }

 private:
  std::vector<std::byte> out_;
};

// Reads what Writer wrote; after the first thing that does not fit everything is empty and ok() is
// false.
class Reader {
 public:
  explicit Reader(std::span<const std::byte> bytes) : left_(bytes) {}
  bool ok() const { return ok_; }
  bool at_end() const { return left_.empty(); }
  std::uint64_t Number(int bytes) {
    std::uint64_t value = 0;
    if (!Has(static_cast<std::size_t>(bytes))) return 0;
    for (int i = bytes; i-- > 0;) {
      value = value << 8 | std::to_integer<std::uint64_t>(left_[static_cast<std::size_t>(i)]);
    }
    left_ = left_.subspan(static_cast<std::size_t>(bytes));
    return value;
  }
  std::vector<std::byte> Bytes() {
    const std::size_t size = Number(4);
    if (!Has(size)) return {};
    std::vector<std::byte> bytes(left_.begin(), left_.begin() + static_cast<std::ptrdiff_t>(size));
    left_ = left_.subspan(size);
    return bytes;
  }
  std::string Text() {
    const std::vector<std::byte> bytes = Bytes();
    std::string text(bytes.size(), '\0');
    std::transform(bytes.begin(), bytes.end(), text.begin(),
                   [](std::byte b) { return static_cast<char>(b); });
    return text;
  }
  DeviceInfo Device() {
    DeviceInfo device;
    device.vendor = static_cast<std::uint16_t>(Number(2));
    device.product = static_cast<std::uint16_t>(Number(2));
    device.bus = static_cast<int>(Number(4) & 0x7FFFFFFF);
    device.address = static_cast<int>(Number(4) & 0x7FFFFFFF);
    const std::size_t ports = Number(1);
    if (ports > kMaxPorts) ok_ = false;
    for (std::size_t i = 0; ok_ && i < ports; ++i) {
      device.ports.push_back(static_cast<int>(Number(1)));
    }
    return device;
  }

 private:
  bool Has(std::size_t bytes) {
    ok_ = ok_ && left_.size() >= bytes;
    return ok_;
  }
  std::span<const std::byte> left_;
  bool ok_ = true;
};

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
  Writer out;
  out.Put(static_cast<std::uint64_t>(call.kind), 1);
  out.Put(call.device);
  out.Put(call.setup.request, 1);
  out.Put(call.setup.value, 2);
  out.Put(call.setup.index, 2);
  out.Put(call.sent);
  out.Put(call.number, 4);
  out.Put(call.error ? 1 : 0, 1);
  if (call.error) {
    out.Put(static_cast<std::uint64_t>(call.error->kind), 1);
    out.Put(call.error->message);
  }
  out.Put(call.devices.size(), 4);
  for (const DeviceInfo& device : call.devices) out.Put(device);
  out.Put(call.received);
  out.Put(call.result, 4);
  out.Put((call.chunk.ended_short ? 1U : 0U) | (call.chunk.gap ? 2U : 0U), 1);
  out.Put(call.chunk.error);
  out.Put(call.chunk.bytes);
  return std::move(out).Take();
}

std::optional<RecordedCall> DecodeCall(std::span<const std::byte> bytes) {
  Reader in(bytes);
  RecordedCall call;
  const std::uint64_t kind = in.Number(1);
  if (kind < 1 || kind > static_cast<std::uint64_t>(RecordedCall::Kind::kStopStream)) {
    return std::nullopt;
  }
  call.kind = static_cast<RecordedCall::Kind>(kind);
  call.device = in.Device();
  call.setup.request = static_cast<std::uint8_t>(in.Number(1));
  call.setup.value = static_cast<std::uint16_t>(in.Number(2));
  call.setup.index = static_cast<std::uint16_t>(in.Number(2));
  call.sent = in.Bytes();
  call.number = static_cast<std::uint32_t>(in.Number(4));
  if (in.Number(1) != 0) {
    const std::uint64_t error_kind = in.Number(1);
    if (error_kind > static_cast<std::uint64_t>(ErrorKind::kConfig)) return std::nullopt;
    call.error = Error{static_cast<ErrorKind>(error_kind), in.Text()};
  }
  const std::size_t devices = in.Number(4);
  if (devices > kMaxDevices) return std::nullopt;
  for (std::size_t i = 0; in.ok() && i < devices; ++i) call.devices.push_back(in.Device());
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
