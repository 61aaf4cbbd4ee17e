#include "tests/emulators/uvc_usb_function.h"

#include <cmath>
#include <initializer_list>
#include <utility>

namespace omnihdr::emulators {
namespace {

using Bytes = std::vector<std::uint8_t>;

void Append(Bytes& to, std::initializer_list<unsigned> bytes) {
  for (const unsigned byte : bytes) to.push_back(static_cast<std::uint8_t>(byte));
}
void AppendNumber(Bytes& to, std::uint32_t value, std::size_t bytes) {
  for (std::size_t i = 0; i < bytes; ++i) {
    to.push_back(static_cast<std::uint8_t>(value >> (8 * i) & 0xFF));
  }
}
// A descriptor begins with its length.
void AppendDescriptor(Bytes& to, Bytes body) {
  body.insert(body.begin(), static_cast<std::uint8_t>(body.size() + 1));
  to.insert(to.end(), body.begin(), body.end());
}
void SetTotal(Bytes& of, std::size_t at) {
  of[at] = static_cast<std::uint8_t>(of.size() & 0xFF);
  of[at + 1] = static_cast<std::uint8_t>(of.size() >> 8);
}

// Numbers of the strings.
enum String : std::uint8_t { kMaker = 1, kProduct = 2, kSerial = 3 };

// Interface 0: header, camera terminal, processing unit, output terminal.
Bytes ControlDescriptors() {
  Bytes all;
  Append(all, {13, 0x24, 0x01, 0x10, 0x01, 0, 0});
  AppendNumber(all, UvcDevice::kClockHz, 4);
  Append(all, {1, UvcDevice::kStreamInterface});
  // Bits 1, 2, 3: automatic exposure's mode and priority, exposure.
  AppendDescriptor(all, {0x24, 0x02, UvcDevice::kCameraTerminal, 0x01, 0x02, 0, 0, 0, 0, 0, 0, 0, 0,
                         3, 0x0E, 0, 0});
  // Bits 6, 8, 9, 10, 12: white balance, backlight, gain, power line, automatic white balance.
  AppendDescriptor(all, {0x24, 0x05, UvcDevice::kProcessingUnit, UvcDevice::kCameraTerminal, 0, 0,
                         2, 0x40, 0x17, 0, 0});
  AppendDescriptor(
      all, {0x24, 0x03, UvcDevice::kOutputTerminal, 0x01, 0x01, 0, UvcDevice::kProcessingUnit, 0});
  SetTotal(all, 5);
  return all;
}

// An uncompressed format with its one size.
void AppendFormat(Bytes& all, const UvcDeviceOptions& options, std::uint8_t number,
                  const char (&fourcc)[5], unsigned bits) {
  Bytes format;
  Append(format, {0x24, 0x04, number, 1});
  for (const char c : {fourcc[0], fourcc[1], fourcc[2], fourcc[3]}) {
    format.push_back(static_cast<std::uint8_t>(c));
  }
  Append(format, {0, 0, 0x10, 0, 0x80, 0, 0, 0xAA, 0, 0x38, 0x9B, 0x71});
  Append(format, {bits, 1, 0, 0, 0, 0});
  AppendDescriptor(all, format);
  const auto width = static_cast<std::uint32_t>(options.width);
  const auto height = static_cast<std::uint32_t>(options.height);
  const auto interval = static_cast<std::uint32_t>(std::lround(options.interval_s * 1e7));
  const std::uint32_t frame_bits = width * height * bits;
  Bytes frame;
  Append(frame, {0x24, 0x05, 1, 0});
  AppendNumber(frame, width, 2);
  AppendNumber(frame, height, 2);
  const double rate = 1.0 / options.interval_s;
  AppendNumber(frame, static_cast<std::uint32_t>(0.5 * frame_bits * rate), 4);
  AppendNumber(frame, static_cast<std::uint32_t>(frame_bits * rate), 4);
  AppendNumber(frame, frame_bits / 8, 4);
  AppendNumber(frame, interval, 4);
  Append(frame, {2});
  AppendNumber(frame, interval, 4);
  AppendNumber(frame, 2 * interval, 4);
  AppendDescriptor(all, frame);
}

// Interface 1: input header and formats.
Bytes StreamDescriptors(const UvcDeviceOptions& options) {
  Bytes all;
  AppendDescriptor(all, {0x24, 0x01, 2, 0, 0, UvcUsbFunction::kStreamEndpoint, 0,
                         UvcDevice::kOutputTerminal, 0, 0, 0, 1, 0, 0});
  AppendFormat(all, options, UvcDevice::kGrey, "Y800", 8);
  AppendFormat(all, options, UvcDevice::kYuyv, "YUY2", 16);
  SetTotal(all, 4);
  return all;
}

// Device, then configuration with both interfaces.
Bytes Descriptors(const UvcDeviceOptions& options) {
  Bytes configuration;
  Append(configuration, {9, 2, 0, 0, 2, 1, 0, 0x80, 250});
  Append(configuration, {8, 0x0B, 0, 2, 0x0E, 3, 0, kProduct});
  Append(configuration, {9, 4, UvcDevice::kControlInterface, 0, 0, 0x0E, 1, 0, kProduct});
  const Bytes control = ControlDescriptors();
  configuration.insert(configuration.end(), control.begin(), control.end());
  Append(configuration, {9, 4, UvcDevice::kStreamInterface, 0, 1, 0x0E, 2, 0, 0});
  const Bytes stream = StreamDescriptors(options);
  configuration.insert(configuration.end(), stream.begin(), stream.end());
  Append(configuration, {7, 5, UvcUsbFunction::kStreamEndpoint, 2, 0x00, 0x02, 0});
  SetTotal(configuration, 2);
  // A vendor and product that are for testing.
  Bytes all;
  Append(all, {18, 1, 0x00, 0x02, 0xEF, 2, 1, 64, 0x09, 0x12, 0x01, 0, 0x00, 0x01, kMaker, kProduct,
               kSerial, 1});
  all.insert(all.end(), configuration.begin(), configuration.end());
  return all;
}

}  // namespace

UvcUsbFunction::UvcUsbFunction(std::shared_ptr<UvcDevice> device)
    : device_(std::move(device)),
      strings_({"Emulators", "Test UVC Camera", device_->options().serial}),
      descriptors_(Descriptors(device_->options())) {}

DeviceAnswer UvcUsbFunction::Control(const Setup& setup, std::vector<std::uint8_t>& data) {
  constexpr std::uint8_t kToInterface = 0x21;
  constexpr std::uint8_t kToEndpoint = 0x02;
  constexpr std::uint8_t kClearFeature = 1;
  constexpr std::uint8_t kSetInterface = 11;
  if (!device_->plugged_in()) return DeviceAnswer::kGone;
  if ((setup[0] & 0x7F) == kToInterface) {
    const UvcDevice::Request request{setup[1], setup[3], setup[5], setup[4]};
    const DeviceAnswer answer = device_->Handle(request, data);
    if (data.size() > SetupWord(setup, 6)) data.resize(SetupWord(setup, 6));
    return answer;
  }
  if ((setup[0] & 0x60) != 0) return DeviceAnswer::kStall;
  // How a host says to a camera on a bulk endpoint that it wants no more.
  if ((setup[0] == kToEndpoint && setup[1] == kClearFeature && setup[4] == kStreamEndpoint) ||
      (setup[1] == kSetInterface && setup[4] == UvcDevice::kStreamInterface)) {
    device_->StopStream();
  }
  return AnswerStandardRequest(setup, descriptors_, strings_, data);
}

}  // namespace omnihdr::emulators
