#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"

namespace omnihdr::iidc {

// The camera's registers, whatever carries the requests. Addresses are the 48 bits of IEEE 1394's
// register space, values as the register has them (bit 31 the most significant). Every call ends
// within its timeout. Errors: kTemporary = no answer in time, kProtocol = refused, kUnavailable =
// the camera has gone, kIo = anything else; messages name the address. One thread.
class RegisterBus {
 public:
  virtual ~RegisterBus() = default;
  virtual Result<std::uint32_t> ReadQuadlet(std::uint64_t address, Nanoseconds timeout) = 0;
  virtual Status WriteQuadlet(std::uint64_t address, std::uint32_t value, Nanoseconds timeout) = 0;
  // Consecutive quadlets; all or an error.
  virtual Status ReadBlock(std::uint64_t address, std::span<std::uint32_t> quadlets,
                           Nanoseconds timeout) = 0;
};

// A piece of the picture stream, in order.
struct StreamChunk {
  std::vector<std::byte> bytes;
  bool ended_short = false;  // the camera ended it: the end of a frame, or of what is left of it
  bool gap = false;          // bytes before this piece are lost
  std::string error;         // why the piece is not whole
  HostTime arrived;
};

class Registers;

// One open camera: its registers and its pictures. Back ends: usb_link.h, firewire_link.h, tests.
// One thread.
class Link : public RegisterBus {
 public:
  // For messages: "usb 1-2 (1e10:2004)".
  virtual std::string name() const = 0;
  virtual std::uint16_t product() const = 0;  // USB's product number; 0 when there is none
  // Frames whose length is no multiple of this end visibly (a short packet); 0 = every frame does.
  virtual std::size_t packet_bytes() const = 0;
  // Whether the host's time at which a frame comes says anything of when it was taken: not of one
  // that is played back.
  virtual bool live() const { return true; }
  // Before every StartStream: what the camera must be told so that its pictures, in packets of so
  // many bytes, come here.
  virtual Status PrepareStream(const Registers& /*registers*/, std::size_t /*packet_bytes*/) {
    return {};
  }
  virtual Status StartStream(std::size_t frame_bytes) = 0;
  // kTemporary: nothing within the timeout. Any other error: the stream has ended.
  virtual Result<StreamChunk> ReadStream(Nanoseconds timeout) = 0;
  virtual void Recycle(StreamChunk chunk) = 0;
  // Takes what still comes, for a moment, then stops. Idempotent.
  virtual void StopStream() = 0;
};

// Where cameras are looked for.
class LinkFinder {
 public:
  virtual ~LinkFinder() = default;
  // Opens a candidate; any failure says why it is none to use.
  struct Candidate {
    std::string name;
    std::function<Result<std::unique_ptr<Link>>()> open;
  };
  virtual Result<std::vector<Candidate>> Find() = 0;
};

// How long a single register may take, and a change that it starts.
struct RegisterTimeouts {
  Nanoseconds access = std::chrono::seconds(1);
  Nanoseconds settle = std::chrono::seconds(2);
  Nanoseconds poll = std::chrono::milliseconds(1);
};

// A bus with names in its errors and one set of timeouts: what the rest of the driver uses.
class Registers {
 public:
  Registers(RegisterBus& bus, std::uint64_t base, const RegisterTimeouts& timeouts)
      : bus_(&bus), base_(base), timeouts_(timeouts) {}
  // Offsets from the command base.
  Result<std::uint32_t> Read(std::uint32_t offset, std::string_view name) const;
  Status Write(std::uint32_t offset, std::uint32_t value, std::string_view name) const;
  // Writes and reads back: kProtocol unless the bits under `mask` are as written.
  Result<std::uint32_t> WriteChecked(std::uint32_t offset, std::uint32_t value, std::uint32_t mask,
                                     std::string_view name) const;
  // Reads until (value & mask) == expected; kTemporary after the settling time.
  Result<std::uint32_t> WaitFor(std::uint32_t offset, std::uint32_t mask, std::uint32_t expected,
                                std::string_view name) const;
  // Registers elsewhere that a pointer register (value · 4) leads to.
  Registers At(std::uint32_t quadlet_pointer) const;

 private:
  RegisterBus* bus_;
  std::uint64_t base_;
  RegisterTimeouts timeouts_;
};

}  // namespace omnihdr::iidc
