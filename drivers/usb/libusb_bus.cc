#include "drivers/usb/libusb_bus.h"

#include <fmt/format.h>

#include <algorithm>
#include <limits>
#include <utility>

#include "drivers/usb/libusb_stream.h"

namespace omnihdr::usb {
namespace {

// bmRequestType: vendor request, recipient device.
constexpr std::uint8_t kVendorIn = 0xC0;
constexpr std::uint8_t kVendorOut = 0x40;
constexpr int kConfiguration = 1;
constexpr int kInterface = 0;

// libusb takes milliseconds, 0 of which mean for ever.
unsigned Milliseconds(Nanoseconds timeout) {
  const auto ms = std::chrono::ceil<std::chrono::milliseconds>(timeout).count();
  return static_cast<unsigned>(std::clamp<std::int64_t>(ms, 1, 3'600'000));
}

Result<LibusbContext> MakeContext() {
  libusb_context* context = nullptr;
  if (const int code = libusb_init(&context); code != LIBUSB_SUCCESS) {
    return LibusbFailure(code, "libusb");
  }
  return LibusbContext(context, libusb_exit);
}

// The devices of a context, each referenced once.
class DeviceList {
 public:
  static Result<DeviceList> Read(const LibusbContext& context) {
    libusb_device** devices = nullptr;
    const ssize_t count = libusb_get_device_list(context.get(), &devices);
    if (count < 0) return LibusbFailure(static_cast<int>(count), "list the USB devices");
    return DeviceList(devices, static_cast<std::size_t>(count));
  }
  DeviceList(DeviceList&& other) noexcept
      : devices_(std::exchange(other.devices_, nullptr)), count_(std::exchange(other.count_, 0)) {}
  DeviceList& operator=(DeviceList&&) = delete;
  DeviceList(const DeviceList&) = delete;
  DeviceList& operator=(const DeviceList&) = delete;
  ~DeviceList() {
    if (devices_ != nullptr) libusb_free_device_list(devices_, 1);
  }
  std::span<libusb_device* const> devices() const { return {devices_, count_}; }

 private:
  DeviceList(libusb_device** devices, std::size_t count) : devices_(devices), count_(count) {}
  libusb_device** devices_;
  std::size_t count_;
};

Result<DeviceInfo> Describe(libusb_device* device) {
  libusb_device_descriptor descriptor;
  if (const int code = libusb_get_device_descriptor(device, &descriptor); code != LIBUSB_SUCCESS) {
    return LibusbFailure(code, "device descriptor");
  }
  DeviceInfo info;
  info.vendor = descriptor.idVendor;
  info.product = descriptor.idProduct;
  info.bus = libusb_get_bus_number(device);
  info.address = libusb_get_device_address(device);
  std::uint8_t ports[8] = {};
  const int depth = libusb_get_port_numbers(device, ports, sizeof(ports));
  for (int i = 0; i < depth; ++i) info.ports.push_back(ports[i]);
  return info;
}

class LibusbDevice final : public Device {
 public:
  LibusbDevice(LibusbContext context, LibusbHandle handle, DeviceInfo info)
      : context_(std::move(context)), handle_(std::move(handle)), info_(std::move(info)) {}
  ~LibusbDevice() override { libusb_release_interface(handle_.get(), kInterface); }

  const DeviceInfo& info() const override { return info_; }

  Status VendorIn(const ControlSetup& setup, std::span<std::byte> data,
                  Nanoseconds timeout) override {
    return Transfer(kVendorIn, setup, reinterpret_cast<unsigned char*>(data.data()), data.size(),
                    timeout);
  }

  Status VendorOut(const ControlSetup& setup, std::span<const std::byte> data,
                   Nanoseconds timeout) override {
    std::vector<unsigned char> copy(data.size());
    std::transform(data.begin(), data.end(), copy.begin(),
                   [](std::byte b) { return static_cast<unsigned char>(b); });
    return Transfer(kVendorOut, setup, copy.data(), copy.size(), timeout);
  }

  Result<int> PacketBytes(std::uint8_t endpoint) override {
    const int bytes = libusb_get_max_packet_size(libusb_get_device(handle_.get()), endpoint);
    if (bytes < 0) return LibusbFailure(bytes, fmt::format("endpoint {:#04x}", endpoint));
    if (bytes == 0) {
      return Fail(ErrorKind::kProtocol, "endpoint {:#04x}: packets of no bytes", endpoint);
    }
    return bytes;
  }

  Result<std::unique_ptr<BulkStream>> StartStream(const BulkStreamOptions& options) override {
    OMNIHDR_TRY(options.Validate().Context("stream"));
    OMNIHDR_TRY(
        CheckUsbfsMemory(options.transfer_bytes * static_cast<std::size_t>(options.transfers))
            .Context("stream"));
    return StartLibusbStream(context_, handle_, options);
  }

 private:
  Status Transfer(std::uint8_t type, const ControlSetup& setup, unsigned char* data,
                  std::size_t bytes, Nanoseconds timeout) {
    if (bytes > std::numeric_limits<std::uint16_t>::max()) {
      return Fail(ErrorKind::kUsage, "control transfer of {} bytes: expected at most 65535", bytes);
    }
    const unsigned ms = Milliseconds(timeout);
    const int moved =
        libusb_control_transfer(handle_.get(), type, setup.request, setup.value, setup.index, data,
                                static_cast<std::uint16_t>(bytes), ms);
    if (moved == LIBUSB_ERROR_TIMEOUT) {
      return Fail(ErrorKind::kTemporary, "no answer in {} ms", ms);
    }
    if (moved < 0) return LibusbFailure(moved, {});
    if (static_cast<std::size_t>(moved) != bytes) {
      return Fail(ErrorKind::kProtocol, "{} bytes: expected {}", moved, bytes);
    }
    return {};
  }

  // Destroyed in reverse: the handle is closed before the context ends.
  const LibusbContext context_;
  const LibusbHandle handle_;
  const DeviceInfo info_;
};

class LibusbBus final : public Bus {
 public:
  Result<std::vector<DeviceInfo>> List() override {
    OMNIHDR_ASSIGN(const LibusbContext context, MakeContext());
    OMNIHDR_ASSIGN(const DeviceList list, DeviceList::Read(context));
    std::vector<DeviceInfo> found;
    for (libusb_device* device : list.devices()) {
      // One that has just gone is no reason not to see the others.
      if (Result<DeviceInfo> info = Describe(device)) found.push_back(std::move(*info));
    }
    std::sort(found.begin(), found.end(), [](const DeviceInfo& a, const DeviceInfo& b) {
      return std::pair(a.bus, a.address) < std::pair(b.bus, b.address);
    });
    return found;
  }

  Result<std::unique_ptr<Device>> Open(const DeviceInfo& wanted) override {
    OMNIHDR_ASSIGN(LibusbContext context, MakeContext());
    OMNIHDR_ASSIGN(const DeviceList list, DeviceList::Read(context));
    for (libusb_device* device : list.devices()) {
      const Result<DeviceInfo> info = Describe(device);
      if (!info || info->bus != wanted.bus || info->address != wanted.address ||
          info->vendor != wanted.vendor || info->product != wanted.product) {
        continue;
      }
      return Claim(std::move(context), device, *info).Context(wanted.Name());
    }
    return Fail(ErrorKind::kUnavailable, "{}: not there any more", wanted.Name());
  }

 private:
  static Result<std::unique_ptr<Device>> Claim(LibusbContext context, libusb_device* device,
                                               const DeviceInfo& info) {
    libusb_device_handle* raw = nullptr;
    if (const int code = libusb_open(device, &raw); code != LIBUSB_SUCCESS) {
      return LibusbFailure(code, "open");
    }
    LibusbHandle handle(raw, libusb_close);
    int configuration = 0;
    const int code = libusb_get_configuration(raw, &configuration);
    // Setting the one that is set already resets the device.
    if (code != LIBUSB_SUCCESS || configuration != kConfiguration) {
      if (const int set = libusb_set_configuration(raw, kConfiguration); set != LIBUSB_SUCCESS) {
        return LibusbFailure(set, fmt::format("set configuration {}", kConfiguration));
      }
    }
    if (const int claimed = libusb_claim_interface(raw, kInterface); claimed != LIBUSB_SUCCESS) {
      return LibusbFailure(claimed, fmt::format("claim interface {}", kInterface));
    }
    return std::unique_ptr<Device>(
        std::make_unique<LibusbDevice>(std::move(context), std::move(handle), info));
  }
};

}  // namespace

tl::unexpected<Error> LibusbFailure(int code, std::string_view what) {
  Error error;
  switch (code) {
    case LIBUSB_ERROR_NO_DEVICE:
    case LIBUSB_ERROR_NOT_FOUND:
      error = {ErrorKind::kUnavailable, "the device has gone"};
      break;
    case LIBUSB_ERROR_BUSY:
      error = {ErrorKind::kUnavailable, "in use by another program"};
      break;
    case LIBUSB_ERROR_ACCESS:
      error = {ErrorKind::kPermission, "this user may not use the device (a udev rule is needed)"};
      break;
    case LIBUSB_ERROR_TIMEOUT:
      error = {ErrorKind::kTemporary, "no answer in time"};
      break;
    case LIBUSB_ERROR_PIPE:
      error = {ErrorKind::kProtocol, "refused by the device (stall)"};
      break;
    case LIBUSB_ERROR_NO_MEM:
      error = {ErrorKind::kSystem,
               fmt::format("the kernel has no room for USB buffers: raise {}", kUsbfsMemoryFile)};
      break;
    default:
      error = {ErrorKind::kIo,
               fmt::format("USB: {}", libusb_strerror(static_cast<libusb_error>(code)))};
  }
  if (what.empty()) return Forward(std::move(error));
  return Forward(std::move(error), what);
}

std::unique_ptr<Bus> MakeLibusbBus() { return std::make_unique<LibusbBus>(); }

}  // namespace omnihdr::usb
