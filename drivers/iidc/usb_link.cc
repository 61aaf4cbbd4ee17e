#include "drivers/iidc/usb_link.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <utility>

#include "drivers/iidc/model_table.h"

namespace omnihdr::iidc {
namespace {

constexpr std::uint8_t kEndpoint = 0x81;
constexpr std::size_t kMaxTransferBytes = std::size_t{1} << 20;
constexpr int kTransfers = 8;
constexpr std::size_t kMaxBlockQuadlets = 128;
// A read is asked for again when no answer has come after this long.
constexpr Nanoseconds kReadPatience = std::chrono::milliseconds(200);
constexpr Nanoseconds kQuiet = std::chrono::milliseconds(30);
constexpr Nanoseconds kLongestDrain = std::chrono::milliseconds(500);

class UsbLink final : public Link {
 public:
  explicit UsbLink(std::unique_ptr<usb::Device> device) : device_(std::move(device)) {
    if (const Result<int> bytes = device_->PacketBytes(kEndpoint)) {
      packet_bytes_ = static_cast<std::size_t>(*bytes);
    }
  }
  ~UsbLink() override { StopStream(); }
  UsbLink(const UsbLink&) = delete;
  UsbLink& operator=(const UsbLink&) = delete;

  Result<std::uint32_t> ReadQuadlet(std::uint64_t address, Nanoseconds timeout) override {
    std::uint32_t quadlet = 0;
    OMNIHDR_TRY(ReadBlock(address, {&quadlet, 1}, timeout));
    return quadlet;
  }

  Status WriteQuadlet(std::uint64_t address, std::uint32_t value, Nanoseconds timeout) override {
    OMNIHDR_ASSIGN(const usb::ControlSetup setup, SetupForAddress(address));
    std::array<std::byte, 4> bytes;
    for (std::size_t i = 0; i < bytes.size(); ++i) {
      bytes[i] = static_cast<std::byte>(value >> (8 * i) & 0xFF);
    }
    return device_->VendorOut(setup, bytes, timeout)
        .Context(fmt::format("write {:#010x} to {:#014x}", value, address));
  }

  Status ReadBlock(std::uint64_t address, std::span<std::uint32_t> quadlets,
                   Nanoseconds timeout) override {
    if (quadlets.size() > kMaxBlockQuadlets) {
      return Fail(ErrorKind::kUsage, "read {} quadlets at {:#014x}: expected at most {}",
                  quadlets.size(), address, kMaxBlockQuadlets);
    }
    OMNIHDR_ASSIGN(const usb::ControlSetup setup, SetupForAddress(address));
    std::array<std::byte, 4 * kMaxBlockQuadlets> bytes;
    const std::span<std::byte> wanted = std::span(bytes).first(4 * quadlets.size());
    const HostTime deadline = clock_.Now() + timeout;
    while (true) {
      const Nanoseconds left = deadline - clock_.Now();
      Status read = device_->VendorIn(setup, wanted, std::min(left, kReadPatience));
      if (read) break;
      // Reading twice does no harm.
      if (read.error().kind != ErrorKind::kTemporary || clock_.Now() >= deadline) {
        return Forward(std::move(read).error(), fmt::format("read {:#014x}", address));
      }
    }
    for (std::size_t i = 0; i < quadlets.size(); ++i) {
      std::uint32_t value = 0;
      for (std::size_t b = 4; b-- > 0;) {
        value = value << 8 | std::to_integer<std::uint32_t>(wanted[4 * i + b]);
      }
      quadlets[i] = value;
    }
    return {};
  }

  std::string name() const override { return device_->info().Name(); }
  std::uint16_t product() const override { return device_->info().product; }
  std::size_t packet_bytes() const override { return packet_bytes_; }
  bool live() const override { return device_->live(); }

  Status StartStream(std::size_t frame_bytes) override {
    StopStream();
    if (packet_bytes_ == 0) {
      return Fail(ErrorKind::kProtocol, "endpoint {:#04x}: the device does not have it", kEndpoint);
    }
    usb::BulkStreamOptions options;
    options.endpoint = kEndpoint;
    // Whole packets, with room for a frame's short last one.
    const std::size_t whole = (frame_bytes / packet_bytes_ + 1) * packet_bytes_;
    options.transfer_bytes = std::min(whole, kMaxTransferBytes / packet_bytes_ * packet_bytes_);
    options.transfers = kTransfers;
    const std::size_t per_frame = whole / options.transfer_bytes + 1;
    options.spare = static_cast<int>(std::min<std::size_t>(2 * per_frame + 2, 256));
    OMNIHDR_ASSIGN(stream_, device_->StartStream(options));
    return {};
  }

  Result<StreamChunk> ReadStream(Nanoseconds timeout) override {
    if (!stream_) return Fail(ErrorKind::kUnavailable, "stream: not started");
    OMNIHDR_ASSIGN(usb::BulkChunk from, stream_->Next(timeout));
    StreamChunk chunk;
    chunk.bytes = std::move(from.bytes);
    chunk.ended_short = from.ended_short;
    chunk.gap = from.gap;
    chunk.error = std::move(from.error);
    chunk.arrived = from.arrived;
    return chunk;
  }

  void Recycle(StreamChunk chunk) override {
    if (!stream_) return;
    usb::BulkChunk back;
    back.bytes = std::move(chunk.bytes);
    stream_->Recycle(std::move(back));
  }

  void StopStream() override {
    if (!stream_) return;
    stream_->Stop(kQuiet, kLongestDrain);
    stream_.reset();
  }

 private:
  const SystemClock clock_;
  const std::unique_ptr<usb::Device> device_;
  std::size_t packet_bytes_ = 0;
  std::unique_ptr<usb::BulkStream> stream_;
};

class UsbFinder final : public LinkFinder {
 public:
  explicit UsbFinder(std::shared_ptr<usb::Bus> bus) : bus_(std::move(bus)) {}

  Result<std::vector<Candidate>> Find() override {
    OMNIHDR_ASSIGN(const std::vector<usb::DeviceInfo> devices, bus_->List());
    std::vector<Candidate> found;
    for (const usb::DeviceInfo& device : devices) {
      if (device.vendor != kPointGreyVendor) continue;
      found.push_back({device.Name(), [bus = bus_, device]() -> Result<std::unique_ptr<Link>> {
                         OMNIHDR_ASSIGN(std::unique_ptr<usb::Device> opened, bus->Open(device));
                         return MakeUsbLink(std::move(opened));
                       }});
    }
    return found;
  }

 private:
  const std::shared_ptr<usb::Bus> bus_;
};

}  // namespace

Result<usb::ControlSetup> SetupForAddress(std::uint64_t address) {
  usb::ControlSetup setup;
  switch (address >> 32) {
    case 0xFFFF:
      setup.request = 0x7F;
      break;
    case 0xD000:
      setup.request = 0x80;
      break;
    default:
      return Fail(ErrorKind::kUsage,
                  "address {:#014x}: expected bits 47..32 to be 0xffff or 0xd000", address);
  }
  setup.value = static_cast<std::uint16_t>(address & 0xFFFF);
  setup.index = static_cast<std::uint16_t>(address >> 16 & 0xFFFF);
  return setup;
}

std::size_t UsbBytesInFlight(std::size_t frame_bytes) {
  constexpr std::size_t kLargestPacket = 1024;
  return std::min(frame_bytes + kLargestPacket, kMaxTransferBytes) * kTransfers;
}

std::unique_ptr<Link> MakeUsbLink(std::unique_ptr<usb::Device> device) {
  return std::make_unique<UsbLink>(std::move(device));
}

std::unique_ptr<LinkFinder> MakeUsbFinder(std::shared_ptr<usb::Bus> bus) {
  return std::make_unique<UsbFinder>(std::move(bus));
}

}  // namespace omnihdr::iidc
