#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "tests/emulators/device_answer.h"

namespace omnihdr::emulators {

// The USB face of a device model, for whatever carries USB: requests on endpoint 0 and one bulk
// endpoint from which the device's stream is read. Thread-safe as far as the model is.
class UsbFunction {
 public:
  virtual ~UsbFunction() = default;

  // A request as it stands in the setup packet. For an OUT request `data` holds what came with it;
  // for an IN request the answer is put there, at most wLength bytes. kNak: no answer, ever.
  using Setup = std::array<std::uint8_t, 8>;
  virtual DeviceAnswer Control(const Setup& setup, std::vector<std::uint8_t>& data) = 0;
  virtual std::uint8_t stream_endpoint() const = 0;  // with the direction's bit, such as 0x81
  virtual DeviceMoved ReadStream(std::span<std::byte> buffer) = 0;
  virtual void Unplug() = 0;
  virtual void PlugIn() = 0;  // comes back as after power-up
};

// What every device answers by its descriptors: the device's, then the configuration's with all
// that belongs to it. `strings` are numbered from 1.
DeviceAnswer AnswerStandardRequest(const UsbFunction::Setup& setup,
                                   std::span<const std::uint8_t> descriptors,
                                   std::span<const std::string> strings,
                                   std::vector<std::uint8_t>& data);

// A word of the setup packet: wValue at 2, wIndex at 4, wLength at 6.
inline std::size_t SetupWord(const UsbFunction::Setup& setup, std::size_t at) {
  return static_cast<std::size_t>(setup[at] | setup[at + 1] << 8);
}

}  // namespace omnihdr::emulators
