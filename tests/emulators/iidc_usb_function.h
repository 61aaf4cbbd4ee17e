#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "tests/emulators/iidc_device.h"

namespace omnihdr::emulators {

// The USB face of the device model, for whatever carries USB: descriptors, requests on endpoint 0
// (standard ones and the register requests), and the bulk endpoint 0x81, which is the device's
// ReadStream.
class IidcUsbFunction {
 public:
  static constexpr std::uint8_t kStreamEndpoint = 0x81;

  explicit IidcUsbFunction(IidcDevice& device) : device_(device) {}

  // Device descriptor, then configuration, interface and endpoint.
  static std::span<const std::uint8_t> Descriptors();

  // A request as it stands in the setup packet. For an OUT request `data` holds what came with it;
  // for an IN request the answer is put there, at most wLength bytes. kNak: no answer, ever.
  using Setup = std::array<std::uint8_t, 8>;
  IidcDevice::Answer Control(const Setup& setup, std::vector<std::uint8_t>& data);

 private:
  IidcDevice::Answer Standard(const Setup& setup, std::vector<std::uint8_t>& data);
  IidcDevice::Answer Register(const Setup& setup, std::vector<std::uint8_t>& data);
  IidcDevice& device_;
};

}  // namespace omnihdr::emulators
