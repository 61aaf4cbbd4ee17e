#pragma once

#include "core/base/result.h"
#include "daemon/app.h"
#include "daemon/config.h"

namespace omnihdr {

// Adds what [gpio], [modbus] and [gnss] ask for to the parts - connections, odometer, place, lamps,
// strobe - and the trigger source when it is "gpio", or "distance" by one of these odometers.
// Nothing is opened yet. kConfig when options are out of range or what is needed is not configured.
Status AddVehicleParts(const DaemonConfig& config, const PartsContext& context, AppParts& parts);

}  // namespace omnihdr
