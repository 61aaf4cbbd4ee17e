#pragma once

#include <memory>
#include <string>

#include "core/base/result.h"
#include "daemon/evaluation/reference.h"

namespace omnihdr {

// The simulator's own scene, rendered again without noise or clipping. `simulation_json` is the
// value of session.json's key "simulation": {"scene": "hall", "seed": 1, ...}.
Result<std::unique_ptr<Reference>> OpenSimulationTruth(const std::string& simulation_json,
                                                       const std::string& session_file);

}  // namespace omnihdr
