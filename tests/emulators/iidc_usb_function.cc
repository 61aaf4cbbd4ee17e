#include "tests/emulators/iidc_usb_function.h"

#include <fmt/format.h>

#include <utility>

namespace omnihdr::emulators {
namespace {

using Answer = DeviceAnswer;

// Device with three strings, configuration, one interface with a bulk endpoint 0x81.
// clang-format off
constexpr std::uint8_t kDescriptors[] = {
    18, 1, 0x00, 0x02, 0, 0, 0, 64, 0x10, 0x1E, 0x04, 0x20, 0x00, 0x01, 1, 2, 3, 1,
    9, 2, 25, 0, 1, 1, 0, 0x80, 250,
    9, 4, 0, 0, 1, 0xFF, 0, 0, 0,
    7, 5, IidcUsbFunction::kStreamEndpoint, 2, 0x00, 0x02, 0};
// clang-format on

}  // namespace

IidcUsbFunction::IidcUsbFunction(std::shared_ptr<IidcDevice> device)
    : device_(std::move(device)),
      strings_({"Emulators", "Test Head", fmt::format("{:08X}", device_->options().serial)}) {}

std::span<const std::uint8_t> IidcUsbFunction::Descriptors() { return kDescriptors; }

Answer IidcUsbFunction::Control(const Setup& setup, std::vector<std::uint8_t>& data) {
  if (!device_->plugged_in()) return Answer::kGone;
  switch (setup[0] & 0x60) {
    case 0x00:
      return AnswerStandardRequest(setup, kDescriptors, strings_, data);
    case 0x40:
      return Register(setup, data);
    default:
      return Answer::kStall;
  }
}

// bRequest 0x7F stands for address bits 47..32 = 0xFFFF; data are little-endian quadlets.
Answer IidcUsbFunction::Register(const Setup& setup, std::vector<std::uint8_t>& data) {
  const std::uint64_t address =
      0xFFFF'0000'0000 | std::uint64_t{SetupWord(setup, 4)} << 16 | SetupWord(setup, 2);
  const std::size_t quadlets = SetupWord(setup, 6) / 4;
  if (setup[1] != 0x7F || quadlets == 0 || quadlets > 128) return Answer::kStall;
  if ((setup[0] & 0x80) != 0) {
    std::vector<std::uint32_t> values(quadlets);
    const Answer answer = device_->Read(address, values);
    if (answer != Answer::kOk) return answer;
    data.clear();
    for (const std::uint32_t value : values) {
      for (int shift = 0; shift < 32; shift += 8) {
        data.push_back(static_cast<std::uint8_t>(value >> shift & 0xFF));
      }
    }
    return answer;
  }
  if (data.size() < 4 * quadlets) return Answer::kStall;
  for (std::size_t i = 0; i < quadlets; ++i) {
    std::uint32_t value = 0;
    for (std::size_t b = 4; b-- > 0;) value = value << 8 | data[4 * i + b];
    if (const Answer answer = device_->Write(address + 4 * i, value); answer != Answer::kOk) {
      return answer;
    }
  }
  return Answer::kOk;
}

}  // namespace omnihdr::emulators
