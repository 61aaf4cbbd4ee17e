#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"

// The seam between a driver and USB: what a driver needs of a bus, abstract, so that it is tested
// over an emulated device. The real one is libusb_bus.h.
namespace omnihdr::usb {

struct DeviceInfo {
  std::uint16_t vendor = 0;
  std::uint16_t product = 0;
  int bus = 0;
  int address = 0;  // changes each time the device is plugged in
  // "usb 1-2.3 (1e10:2004)", for people.
  std::string Name() const;
  std::vector<int> ports;  // the way from the root hub
};

struct ControlSetup {
  std::uint8_t request = 0;
  std::uint16_t value = 0;
  std::uint16_t index = 0;
};

struct BulkStreamOptions {
  std::uint8_t endpoint = 0x81;
  std::size_t transfer_bytes = std::size_t{1} << 20;  // a multiple of the endpoint's packet
  int transfers = 8;                                  // in flight, 1 to 64
  int spare = 8;  // further buffers for what the reader has not taken yet, 1 to 256
  Status Validate() const;
};

// What one transfer brought.
struct BulkChunk {
  std::vector<std::byte> bytes;
  bool ended_short = false;  // the device ended it before the buffer was full
  bool gap = false;          // data before this chunk was thrown away: no buffer was free
  std::string error;         // the transfer failed; `bytes` holds what had arrived
  HostTime arrived;
};

// A running ring of transfers on one bulk endpoint. Next, Recycle and Stop from one thread.
class BulkStream {
 public:
  virtual ~BulkStream() = default;
  // The next chunk in order. kTemporary: none within the timeout; kUnavailable: the device has
  // gone; kIo: the endpoint cannot be brought back to life.
  virtual Result<BulkChunk> Next(Nanoseconds timeout) = 0;
  // Gives a chunk's buffer back. A reader that keeps them all makes gaps.
  virtual void Recycle(BulkChunk chunk) = 0;
  // Goes on taking data until nothing has come for `quiet` (at most `limit`), then cancels the
  // transfers: a device that nobody reads from may wedge. Idempotent.
  virtual void Stop(Nanoseconds quiet, Nanoseconds limit) = 0;
};

// An open device whose interface 0 is claimed; closed by its destructor, streams first. One thread.
class Device {
 public:
  virtual ~Device() = default;
  virtual const DeviceInfo& info() const = 0;
  // Whether data come when the device sends them: not from a recording, which is played as fast or
  // slowly as its reader asks.
  virtual bool live() const { return true; }
  // Vendor requests to the device. Errors: kTemporary = no answer in time, kProtocol = refused
  // (stall) or another length than asked for, kUnavailable = gone, kIo = anything else.
  virtual Status VendorIn(const ControlSetup& setup, std::span<std::byte> data,
                          Nanoseconds timeout) = 0;
  virtual Status VendorOut(const ControlSetup& setup, std::span<const std::byte> data,
                           Nanoseconds timeout) = 0;
  // Bytes of one packet of an endpoint (512 with USB 2, 1024 with USB 3).
  virtual Result<int> PacketBytes(std::uint8_t endpoint) = 0;
  virtual Result<std::unique_ptr<BulkStream>> StartStream(const BulkStreamOptions& options) = 0;
};

class Bus {
 public:
  virtual ~Bus() = default;
  // The devices there now, in order of bus and address.
  virtual Result<std::vector<DeviceInfo>> List() = 0;
  // kUnavailable: not there any more or in use; kPermission: this user may not.
  virtual Result<std::unique_ptr<Device>> Open(const DeviceInfo& device) = 0;
};

inline constexpr const char* kUsbfsMemoryFile = "/sys/module/usbcore/parameters/usbfs_memory_mb";

// Whether the kernel lets `bytes` be in flight. Its limit is shared by all programs; a system that
// does not tell (no such file) and 0 (no limit) pass. The error says what to change.
Status CheckUsbfsMemory(std::size_t bytes, const std::filesystem::path& file = kUsbfsMemoryFile);

}  // namespace omnihdr::usb
