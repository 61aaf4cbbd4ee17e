#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "drivers/firewire/firewire.h"

namespace omnihdr::firewire {

// One call and its outcome. Which members mean something follows from the kind.
struct RecordedCall {
  enum class Kind : std::uint8_t {
    kList = 1,
    kOpen,
    kRead,
    kWrite,
    kRefresh,
    kAllocateChannel,
    kAllocateBandwidth,
    kReleaseChannel,
    kReleaseBandwidth,
    kStartReceive,
    kStopReceive,
    kBatch,  // what Receive gave: packets, or an error other than "nothing yet"
    kReset,  // WasReset said yes
  };
  Kind kind = Kind::kList;
  // The request.
  NodeInfo node;
  std::uint64_t address = 0;
  std::uint32_t number = 0;  // quadlets asked for, value written, channel, or units
  std::uint32_t packet_bytes = 0;
  // The outcome.
  Answer answer = Answer::kComplete;
  std::optional<Error> error;
  std::vector<NodeInfo> nodes;
  std::vector<std::uint32_t> quadlets;
  std::int32_t speed = 0;  // kOpen, kRefresh: to the node
  IsoBatch batch;

  // Of the registers, not of the stream and its resources.
  bool IsAccess() const { return kind == Kind::kRead || kind == Kind::kWrite; }
  // Came by itself.
  bool IsEvent() const { return kind == Kind::kBatch || kind == Kind::kReset; }
  // "read 1 quadlet at 0xfffff0f0062c", for people.
  std::string Request() const;
};

// The file: drivers/recording, with this line.
inline constexpr std::string_view kRecordingMagic = "omnihdr firewire recording 1\n";

std::vector<std::byte> EncodeCall(const RecordedCall& call);
// Untrusted; nothing when the bytes are no call. Packets lie within their batch.
std::optional<RecordedCall> DecodeCall(std::span<const std::byte> bytes);

}  // namespace omnihdr::firewire
