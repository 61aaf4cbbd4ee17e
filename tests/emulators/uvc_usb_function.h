#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "tests/emulators/usb_function.h"
#include "tests/emulators/uvc_device.h"

namespace omnihdr::emulators {

// The USB face of a camera of the video class: its descriptors, the class's requests, and frames
// over the bulk endpoint 0x82.
class UvcUsbFunction final : public UsbFunction {
 public:
  static constexpr std::uint8_t kStreamEndpoint = 0x82;

  explicit UvcUsbFunction(std::shared_ptr<UvcDevice> device);

  DeviceAnswer Control(const Setup& setup, std::vector<std::uint8_t>& data) override;
  std::uint8_t stream_endpoint() const override { return kStreamEndpoint; }
  DeviceMoved ReadStream(std::span<std::byte> buffer) override {
    return device_->ReadStream(buffer);
  }
  void Unplug() override { device_->Unplug(); }
  void PlugIn() override { device_->PlugIn(); }

 private:
  const std::shared_ptr<UvcDevice> device_;
  const std::vector<std::string> strings_;
  const std::vector<std::uint8_t> descriptors_;
};

}  // namespace omnihdr::emulators
