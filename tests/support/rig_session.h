#pragma once

#include <filesystem>
#include <vector>

#include "core/session/session.h"
#include "core/sphere/rig.h"
#include "tests/support/room.h"

namespace omnihdr::testing {

// session.json of a session recorded with `rig`, its rig.toml among the files.
SessionInfo RigInfo(const Rig& rig);

// A whole recorded session of raw frames: `frames_per_position` exposures at every pose, in turn
// from `exposures_s`; read noise of half a value; the journal tells the poses.
void WriteRigSession(const std::filesystem::path& directory, const Rig& rig, const Room& room,
                     const std::vector<Pose>& poses, const std::vector<double>& exposures_s,
                     int frames_per_position);

}  // namespace omnihdr::testing
