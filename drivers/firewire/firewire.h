#pragma once

#include <cstddef>
#include <cstdint>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/base/clock.h"
#include "core/base/result.h"

namespace omnihdr::firewire {

// How a transaction with a node ended.
enum class Answer {
  kComplete,
  kBusy,      // the node took nothing: ask again
  kConflict,  // another transaction holds the resource: ask again
  kReset,     // the bus was reset, nothing was sent: Refresh, then ask again
  kRefused,   // address or type error: final
  kNoAnswer,  // none in time; a write may have been taken
  kGone,      // the node has left the bus
  kFailed,    // anything else
};
const char* ToString(Answer answer);

struct NodeInfo {
  int port = 0;            // the controller
  std::uint64_t guid = 0;  // what stays over resets of the bus
};

// Isochronous packets in their order.
struct IsoPacket {
  std::size_t begin = 0;  // in IsoBatch::bytes
  std::size_t length = 0;
  bool sync = false;          // the header's sy field is 1
  std::uint32_t cycle = 0;    // 0 to 7999
  std::uint32_t dropped = 0;  // packets before it that there was no room for
};
struct IsoBatch {
  std::vector<std::byte> bytes;
  std::vector<IsoPacket> packets;
  HostTime arrived;  // of the last one
};

struct IsoOptions {
  int channel = 0;               // 0 to 63
  std::size_t packet_bytes = 0;  // the largest packet's payload
  std::size_t packets = 0;       // room for so many
};

// One device on the bus. Every call ends within its timeout. One thread.
class Node {
 public:
  virtual ~Node() = default;
  virtual NodeInfo info() const = 0;
  // Whether packets come when the device sends them: not from a recording.
  virtual bool live() const { return true; }
  // What more there is to say of a kFailed or kGone; empty = nothing.
  virtual std::string detail() const { return {}; }
  // Quadlets in the host's order; one quadlet as a quadlet transaction.
  virtual Answer Read(std::uint64_t address, std::span<std::uint32_t> quadlets,
                      Nanoseconds timeout) = 0;
  virtual Answer Write(std::uint64_t address, std::uint32_t value, Nanoseconds timeout) = 0;
  // Whether the bus has been reset since the last Refresh.
  virtual bool WasReset() = 0;
  // Finds the node by its GUID again: kComplete, or kGone when it is not there.
  virtual Answer Refresh(Nanoseconds timeout) = 0;
  // The fastest speed between here and there: 0 = S100, 1 = S200, 2 = S400, 3 = S800, ...
  virtual int speed() const = 0;

  // Of the isochronous resource manager; lost with every reset of the bus. kUnavailable: taken.
  virtual Status AllocateChannel(int channel) = 0;
  virtual Status AllocateBandwidth(int units) = 0;
  virtual void ReleaseChannel(int channel) = 0;
  virtual void ReleaseBandwidth(int units) = 0;

  virtual Status StartReceive(const IsoOptions& options) = 0;
  // kTemporary: nothing within the timeout. An empty batch: look at WasReset.
  virtual Result<IsoBatch> Receive(Nanoseconds timeout) = 0;
  virtual void StopReceive() = 0;  // idempotent
};

class Bus {
 public:
  virtual ~Bus() = default;
  // Devices other than this machine, on all its controllers. kUnavailable: there is no controller.
  virtual Result<std::vector<NodeInfo>> List() = 0;
  virtual Result<std::unique_ptr<Node>> Open(const NodeInfo& info) = 0;
};

// This machine's FireWire, over libraw1394; kConfig from every call when it was built without
// (OMNIHDR_FIREWIRE).
std::unique_ptr<Bus> MakeSystemBus();

}  // namespace omnihdr::firewire
