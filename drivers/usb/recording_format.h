#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "drivers/usb/usb.h"

namespace omnihdr::usb {

// One call and its outcome. Which members mean something follows from the kind.
struct RecordedCall {
  enum class Kind : std::uint8_t {
    kList = 1,
    kOpen,
    kIn,
    kOut,
    kPacketBytes,
    kStartStream,
    kChunk,  // what Next gave: a chunk, or an error other than "nothing yet"
    kStopStream,
  };
  Kind kind = Kind::kList;
  // The request.
  DeviceInfo device;
  ControlSetup setup;
  std::vector<std::byte> sent;
  std::uint32_t number = 0;  // bytes asked for, endpoint, or transfers of a stream
  // The outcome.
  std::optional<Error> error;
  std::vector<DeviceInfo> devices;
  std::vector<std::byte> received;
  std::uint32_t result = 0;
  BulkChunk chunk;

  // "read request 0x7f value 0x0614 index 0xf0f0, 4 bytes", for people.
  std::string Request() const;
};

// The file: kRecordingMagic, then for each call its length in bytes (32 bits, little-endian) and
// its bytes.
inline constexpr std::string_view kRecordingMagic = "omnihdr usb recording 1\n";

std::vector<std::byte> EncodeCall(const RecordedCall& call);
// Untrusted; nothing when the bytes are no call.
std::optional<RecordedCall> DecodeCall(std::span<const std::byte> bytes);

}  // namespace omnihdr::usb
