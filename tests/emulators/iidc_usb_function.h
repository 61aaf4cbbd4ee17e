#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "tests/emulators/iidc_device.h"
#include "tests/emulators/usb_function.h"

namespace omnihdr::emulators {

// The USB face of an IIDC camera: standard and register requests, and the bulk endpoint 0x81, which
// is the device's ReadStream.
class IidcUsbFunction final : public UsbFunction {
 public:
  static constexpr std::uint8_t kStreamEndpoint = 0x81;

  explicit IidcUsbFunction(std::shared_ptr<IidcDevice> device);

  // Device descriptor, then configuration, interface and endpoint.
  static std::span<const std::uint8_t> Descriptors();

  DeviceAnswer Control(const Setup& setup, std::vector<std::uint8_t>& data) override;
  std::uint8_t stream_endpoint() const override { return kStreamEndpoint; }
  DeviceMoved ReadStream(std::span<std::byte> buffer) override {
    return device_->ReadStream(buffer);
  }
  void Unplug() override { device_->Unplug(); }
  void PlugIn() override { device_->PlugIn(); }

 private:
  DeviceAnswer Register(const Setup& setup, std::vector<std::uint8_t>& data);
  const std::shared_ptr<IidcDevice> device_;
  const std::vector<std::string> strings_;  // maker, product, serial number in hexadecimal
};

}  // namespace omnihdr::emulators
