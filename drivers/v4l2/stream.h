#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "drivers/v4l2/device.h"
#include "drivers/v4l2/pixel_format.h"

namespace omnihdr::v4l2 {

// What a buffer's time stamp says.
enum class StampKind {
  kNone,   // nothing of this machine's clock: `stamp` is when the buffer was taken out
  kStart,  // the exposure's begin
  kEnd,    // the end of the frame
};

// A filled buffer. Its bytes belong to the stream, until Recycle.
struct Filled {
  std::uint32_t index = 0;
  std::span<const std::byte> bytes;
  std::uint32_t sequence = 0;
  bool damaged = false;  // the driver says so
  HostTime stamp;
  StampKind kind = StampKind::kNone;
  HostTime taken_out;
};

// The buffers of a device, mapped, and circulating: the driver fills them in turn. Not thread-safe.
class Stream {
 public:
  static constexpr std::uint32_t kBuffers = 4;
  static constexpr std::uint32_t kMaxBuffers = 32;

  Stream(V4l2Device& device, const Clock& clock) : device_(&device), clock_(&clock) {}
  ~Stream() { Stop(); }
  Stream(const Stream&) = delete;
  Stream& operator=(const Stream&) = delete;

  Status Start(const FrameLayout& layout);
  void Stop();
  bool running() const { return running_; }
  // The next buffer; nothing when none came within `timeout`. kUnavailable: the device has gone.
  Result<std::optional<Filled>> Next(Nanoseconds timeout);
  Status Recycle(const Filled& filled);

 private:
  struct Buffer {
    V4l2Device::Mapping mapping;
    std::size_t length = 0;
  };
  Status Begin(const FrameLayout& layout);
  Status Queue(std::uint32_t index);

  V4l2Device* device_;
  const Clock* clock_;
  std::vector<Buffer> buffers_;
  bool running_ = false;
};

}  // namespace omnihdr::v4l2
