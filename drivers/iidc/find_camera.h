#pragma once

#include <cstdint>
#include <memory>
#include <string>

#include "core/base/result.h"
#include "drivers/iidc/config_rom.h"
#include "drivers/iidc/register_bus.h"

namespace omnihdr::iidc {

// A camera whose configuration ROM has been read.
struct FoundCamera {
  std::unique_ptr<Link> link;
  ConfigRom rom;
  std::uint32_t serial = 0;
};

// The camera of that GUID or serial number; "" = the only one there. kUnavailable: there is none,
// or more than one; the message names what is there.
Result<FoundCamera> FindCamera(LinkFinder& finder, const std::string& id,
                               const RegisterTimeouts& timeouts);

}  // namespace omnihdr::iidc
