#pragma once

#include <filesystem>
#include <memory>

#include "core/base/result.h"
#include "daemon/evaluation/reference.h"

namespace omnihdr {

// Photographs a session was made from, as described at OpenReference. `directory` has how.json and
// one NNNNNN.jpg a frame, in the frames' projection (any size).
Result<std::unique_ptr<Reference>> OpenPhotographs(const std::filesystem::path& directory,
                                                   const CameraDescription& camera);

}  // namespace omnihdr
