#pragma once

#include "core/base/result.h"
#include "daemon/app.h"
#include "daemon/config.h"

namespace omnihdr {

// The drivers' options that a configuration asks for, checked. kConfig when they are out of range.
Status CheckParts(const DaemonConfig& config);

// Camera, trigger source, odometer and pipeline as configured: the one place that turns
// configuration into drivers. Nothing is opened yet. For App's MakeParts.
Result<AppParts> MakeConfiguredParts(const DaemonConfig& config, const PartsContext& context);

}  // namespace omnihdr
