#pragma once

#include <memory>

#include "drivers/firewire/firewire.h"
#include "drivers/iidc/register_bus.h"

namespace omnihdr::iidc {

struct FirewireLinkOptions {
  Nanoseconds pause = std::chrono::milliseconds(1);  // before a busy camera is asked again
  int most_tries = 300;                              // of one access
  Nanoseconds refresh = std::chrono::seconds(1);     // for a camera to show itself after a reset
  // A frame whose packets stop for so long is over: they come every 125 us.
  Nanoseconds silence = std::chrono::milliseconds(20);
};

// An IIDC camera on FireWire. Registers: quadlet transactions; busy, conflict and a reset of the
// bus are tried again within the deadline. Pictures: an isochronous channel, one packet a cycle,
// the first of a frame marked; a frame that lacks packets ends as one that is not whole. A reset of
// the bus takes channel and bandwidth away: both are taken again at once.
std::unique_ptr<Link> MakeFirewireLink(std::unique_ptr<firewire::Node> node,
                                       const FirewireLinkOptions& options = {});

// The devices of a bus; which of them are cameras, their configuration ROMs say.
std::unique_ptr<LinkFinder> MakeFirewireFinder(std::shared_ptr<firewire::Bus> bus,
                                               const FirewireLinkOptions& options = {});

// Isochronous bandwidth of one packet a cycle, in the resource manager's units (a quadlet at
// S1600): payload, header and two checksums.
int BandwidthUnits(std::size_t packet_bytes, int speed);

}  // namespace omnihdr::iidc
