#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"
#include "core/base/units.h"

namespace omnihdr::v4l2 {

// The kernel as this driver sees it: what open, ioctl, mmap and poll do for one device node, as
// plain functions. What they return is 0 (or more) or -errno, so that a test can answer as a kernel
// does. Used by one thread at a time.
class V4l2Device {
 public:
  virtual ~V4l2Device() = default;
  virtual int Open(const std::string& path) = 0;  // non-blocking
  virtual void Close() = 0;
  virtual int Ioctl(unsigned long request, void* argument) = 0;
  struct Mapping {
    std::byte* data = nullptr;  // nullptr: `error` says why
    int error = 0;              // -errno
  };
  virtual Mapping Map(std::size_t length, std::int64_t offset) = 0;
  virtual void Unmap(std::byte* data, std::size_t length) = 0;
  // 1 when a buffer can be dequeued, 0 when none could within `timeout`.
  virtual int WaitForFrame(Nanoseconds timeout) = 0;

  // What the driver does next depends on when somebody asked for something, too. It says so here,
  // for a recording, and asks whether the same was asked for when the recording was made
  // (drivers/v4l2/recording.h). A kernel's device has nothing to say to it.
  //
  // How long to wait for a trigger at this moment; nothing = none is to be taken.
  virtual std::optional<Nanoseconds> TriggerPatience() { return Nanoseconds(0); }
  // A trigger has been taken. Returns its time on the clock of the system.
  virtual HostTime TookTrigger(const Exposure& /*exposure*/, HostTime time) { return time; }
  // What comes next, as Prepare said; returns what is to be set.
  virtual std::optional<Exposure> TookHint(std::optional<Exposure> hint) { return hint; }
};

// A device node that may be a camera.
struct V4l2Node {
  std::string path;                // /dev/video0
  std::vector<std::string> names;  // in /dev/v4l/by-id and by-path
  std::string serial;              // of the USB device; empty = none
};

class V4l2System {
 public:
  virtual ~V4l2System() = default;
  // Those there now, by number.
  virtual std::vector<V4l2Node> List() = 0;
  virtual std::unique_ptr<V4l2Device> MakeDevice() = 0;
  // The one of its frames' time stamps, and of all waiting for them. The system's; a recording that
  // is played has that of its own.
  virtual const Clock& clock() const;
  // Where a recording that is played was left; empty = it goes on, or the system is a kernel's.
  virtual std::string why() const { return {}; }
};

// What a failed call means: kUnavailable = the device has gone (ENODEV, ENXIO, ENOENT) or another
// has all the bandwidth (ENOSPC); kPermission, kTemporary (EBUSY, EAGAIN, ETIMEDOUT), else
// kProtocol.
ErrorKind KindOf(int error);
// "what: No such device (ENODEV)" for -errno.
tl::unexpected<Error> FailCall(std::string_view what, int error);

// "GREY" for a format's four characters; what cannot be printed as '?'.
std::string FourCcName(std::uint32_t fourcc);

}  // namespace omnihdr::v4l2
