#pragma once

#include <memory>
#include <string>

#include "core/base/result.h"
#include "daemon/evaluation/reference.h"

namespace omnihdr {

// The simulator's own scene, rendered again without noise or clipping. `extra_json` is an object
// with session.json's key "simulation" (drivers/sim/simulation.h); `session_file` is for error
// messages.
Result<std::unique_ptr<Reference>> OpenSimulationTruth(const std::string& extra_json,
                                                       const std::string& session_file);

}  // namespace omnihdr
