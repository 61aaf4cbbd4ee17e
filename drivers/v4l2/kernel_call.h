#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/clock.h"
#include "core/base/units.h"
#include "drivers/v4l2/device.h"

namespace omnihdr::v4l2 {

// What a driver asked of a V4l2System or one of its devices, and the outcome. Which members mean
// something follows from the kind.
struct KernelCall {
  enum class Kind : std::uint8_t {
    kList = 1,
    kOpen,
    kIoctl,
    kMap,
    kWait,     // for a frame
    kTrigger,  // one was taken: no call, but what follows depends on when it came
    kPrepare,  // likewise, what Prepare said
  };
  Kind kind = Kind::kList;
  std::uint32_t device = 0;  // in the order in which they were made
  HostTime at;               // when it returned
  // The request.
  std::string path;                 // to be opened
  std::uint32_t request = 0;        // of an ioctl
  std::vector<std::byte> argument;  // what it was given
  std::vector<std::byte> controls;  // the array of VIDIOC_S_EXT_CTRLS and VIDIOC_G_EXT_CTRLS
  std::uint64_t length = 0;         // to be mapped
  std::int64_t offset = 0;
  Exposure exposure;  // of a trigger, or to be prepared
  // The outcome.
  HostTime trigger_time;
  std::int32_t result = 0;
  std::vector<V4l2Node> nodes;
  std::vector<std::byte> argument_after;
  std::vector<std::byte> controls_after;
  std::vector<std::byte> frame;  // in the buffer that VIDIOC_DQBUF gave

  // "VIDIOC_S_EXT_CTRLS 0x009a0902=20", for people.
  std::string Request() const;
  // The same question, whatever the answer.
  bool AsksTheSame(const KernelCall& other) const;
};

// The file: drivers/recording, with this line.
inline constexpr std::string_view kKernelCallMagic = "omnihdr v4l2 recording 1\n";

std::vector<std::byte> EncodeCall(const KernelCall& call);
// Untrusted; nothing when the bytes are no call. An ioctl's arguments have the size that its
// request says.
std::optional<KernelCall> DecodeCall(std::span<const std::byte> bytes);

// Whether an ioctl's argument points at an array of controls.
bool HasControls(std::uint32_t request);

}  // namespace omnihdr::v4l2
