#pragma once

#include <filesystem>

#include "core/base/result.h"
#include "core/photometry/measurement.h"
#include "core/session/session.h"

namespace omnihdr {

// Sets kMover where a person marked something that moves in a frame: the picture in `folder` that
// has the frame's name with .png, white (128 and above, of its first channel) = moves, of any size,
// but of the measurement's shape to a hundredth; its nearest pixel counts. No such file: nothing is
// marked. Errors name the file: unreadable, or of another shape.
Status MarkMovers(const std::filesystem::path& folder, const FrameRecord& frame,
                  Measurement* measurement);

}  // namespace omnihdr
