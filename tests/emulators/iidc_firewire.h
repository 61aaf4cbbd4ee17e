#pragma once

#include <cstdint>
#include <memory>
#include <mutex>
#include <set>
#include <vector>

#include "drivers/firewire/firewire.h"
#include "tests/emulators/iidc_device.h"

namespace omnihdr::emulators {

// A FireWire bus of this process with one IIDC camera on it, and the resource manager of the bus.
// Pictures go out on the channel and with the packet size that the camera's registers name, one
// packet a cycle, the first of a frame marked. Its options' link_packet_bytes must be larger than a
// frame (FrameEnds). Thread-safe.
class IidcFirewire {
 public:
  // A frame's end is seen by its length alone.
  static constexpr std::size_t kFrameEnds = std::size_t{1} << 20;

  explicit IidcFirewire(std::shared_ptr<IidcDevice> device) : device_(std::move(device)) {}

  // The next so many transactions end so.
  struct Faults {
    int busy = 0;
    int conflicts = 0;
    int unanswered = 0;
    int lose_first_packets = 0;   // of the next so many frames
    int lose_middle_packets = 0;  // one each
    int lose_last_packets = 0;
    int drop_packets = 0;  // one each, told as dropped
  };
  void Set(const Faults& faults);
  // A reset of the bus: channel and bandwidth are free again, numbers of nodes are others.
  void Reset();
  // Somebody else has the channel.
  void Take(int channel);

  std::set<int> channels() const;
  int bandwidth() const;
  int refreshes() const;

  std::unique_ptr<firewire::Bus> MakeBus();

 private:
  friend class EmulatedNode;
  const std::shared_ptr<IidcDevice> device_;
  mutable std::mutex mutex_;
  Faults faults_;
  std::uint64_t generation_ = 1;
  std::set<int> channels_;
  int bandwidth_ = 0;
  int refreshes_ = 0;
};

}  // namespace omnihdr::emulators
