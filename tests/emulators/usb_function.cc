#include "tests/emulators/usb_function.h"

namespace omnihdr::emulators {
namespace {

constexpr std::size_t kDeviceBytes = 18;

enum Request : std::uint8_t {
  kGetStatus = 0,
  kClearFeature = 1,
  kSetFeature = 3,
  kGetDescriptor = 6,
  kGetConfiguration = 8,
  kSetConfiguration = 9,
  kGetInterface = 10,
  kSetInterface = 11,
};
enum Descriptor : std::uint8_t { kDevice = 1, kConfiguration = 2, kString = 3 };

// UTF-16, of ASCII. Number 0 is the list of languages: English.
bool AppendString(std::uint8_t number, std::span<const std::string> strings,
                  std::vector<std::uint8_t>& data) {
  if (number > strings.size() || strings.empty()) return false;
  data = {0, kString};
  if (number == 0) {
    data.insert(data.end(), {0x09, 0x04});
  } else {
    for (const char c : strings[number - 1U]) {
      data.insert(data.end(), {static_cast<std::uint8_t>(c), 0});
    }
  }
  data[0] = static_cast<std::uint8_t>(data.size());
  return true;
}

}  // namespace

DeviceAnswer AnswerStandardRequest(const UsbFunction::Setup& setup,
                                   std::span<const std::uint8_t> descriptors,
                                   std::span<const std::string> strings,
                                   std::vector<std::uint8_t>& data) {
  switch (setup[1]) {
    case kGetStatus:
      data = {0, 0};
      break;
    case kGetConfiguration:
      data = {1};
      break;
    case kGetInterface:
      data = {0};
      break;
    case kGetDescriptor:
      if (setup[3] == kDevice || setup[3] == kConfiguration) {
        const auto part = setup[3] == kDevice ? descriptors.first(kDeviceBytes)
                                              : descriptors.subspan(kDeviceBytes);
        data.assign(part.begin(), part.end());
      } else if (setup[3] != kString || !AppendString(setup[2], strings, data)) {
        return DeviceAnswer::kStall;
      }
      break;
    case kClearFeature:
    case kSetFeature:
    case kSetConfiguration:
    case kSetInterface:
      data.clear();
      break;
    default:
      return DeviceAnswer::kStall;
  }
  if (data.size() > SetupWord(setup, 6)) data.resize(SetupWord(setup, 6));
  return DeviceAnswer::kOk;
}

}  // namespace omnihdr::emulators
