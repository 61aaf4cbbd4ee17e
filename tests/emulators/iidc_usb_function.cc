#include "tests/emulators/iidc_usb_function.h"

namespace omnihdr::emulators {
namespace {

using Answer = IidcDevice::Answer;

constexpr std::size_t kDeviceBytes = 18;
// Device, configuration, one interface with a bulk endpoint 0x81.
// clang-format off
constexpr std::uint8_t kDescriptors[] = {
    18, 1, 0x00, 0x02, 0, 0, 0, 64, 0x10, 0x1E, 0x04, 0x20, 0x00, 0x01, 0, 0, 0, 1,
    9, 2, 25, 0, 1, 1, 0, 0x80, 250,
    9, 4, 0, 0, 1, 0xFF, 0, 0, 0,
    7, 5, IidcUsbFunction::kStreamEndpoint, 2, 0x00, 0x02, 0};
// clang-format on

std::size_t Word(const IidcUsbFunction::Setup& setup, std::size_t at) {
  return static_cast<std::size_t>(setup[at] | setup[at + 1] << 8);
}

}  // namespace

std::span<const std::uint8_t> IidcUsbFunction::Descriptors() { return kDescriptors; }

Answer IidcUsbFunction::Control(const Setup& setup, std::vector<std::uint8_t>& data) {
  if (!device_.plugged_in()) return Answer::kGone;
  switch (setup[0] & 0x60) {
    case 0x00:
      return Standard(setup, data);
    case 0x40:
      return Register(setup, data);
    default:
      return Answer::kStall;
  }
}

Answer IidcUsbFunction::Standard(const Setup& setup, std::vector<std::uint8_t>& data) {
  constexpr std::uint8_t kGetStatus = 0;
  constexpr std::uint8_t kClearFeature = 1;
  constexpr std::uint8_t kGetDescriptor = 6;
  constexpr std::uint8_t kGetConfiguration = 8;
  constexpr std::uint8_t kSetConfiguration = 9;
  constexpr std::uint8_t kSetInterface = 11;
  const std::span<const std::uint8_t> all = kDescriptors;
  switch (setup[1]) {
    case kGetStatus:
      data = {0, 0};
      break;
    case kGetConfiguration:
      data = {1};
      break;
    case kGetDescriptor: {
      const std::uint8_t type = setup[3];
      if (type != 1 && type != 2) return Answer::kStall;
      const auto part = type == 1 ? all.first(kDeviceBytes) : all.subspan(kDeviceBytes);
      data.assign(part.begin(), part.end());
      break;
    }
    case kClearFeature:
    case kSetConfiguration:
    case kSetInterface:
      data.clear();
      break;
    default:
      return Answer::kStall;
  }
  if (data.size() > Word(setup, 6)) data.resize(Word(setup, 6));
  return Answer::kOk;
}

// bRequest 0x7F stands for address bits 47..32 = 0xFFFF; data are little-endian quadlets.
Answer IidcUsbFunction::Register(const Setup& setup, std::vector<std::uint8_t>& data) {
  const std::uint64_t address =
      0xFFFF'0000'0000 | std::uint64_t{Word(setup, 4)} << 16 | Word(setup, 2);
  const std::size_t quadlets = Word(setup, 6) / 4;
  if (setup[1] != 0x7F || quadlets == 0 || quadlets > 128) return Answer::kStall;
  if ((setup[0] & 0x80) != 0) {
    std::vector<std::uint32_t> values(quadlets);
    const Answer answer = device_.Read(address, values);
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
    if (const Answer answer = device_.Write(address + 4 * i, value); answer != Answer::kOk) {
      return answer;
    }
  }
  return Answer::kOk;
}

}  // namespace omnihdr::emulators
