#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <filesystem>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/photometry/measurement.h"
#include "core/pipeline/frame_measurer.h"
#include "core/session/session.h"
#include "core/sphere/projection.h"

namespace omnihdr {

// Which part of a frame shows the scene.
struct FrameMaskOptions {
  // PNG or JPEG the size of a frame, white = use; of a rig's frames also a lat-long picture (see
  // FrameMeasurer). Empty = none.
  std::filesystem::path file;
  // Share of the frame's rows (of a rig: of the panorama's), from the bottom, that is left out
  // (0..1).
  double ignore_bottom = 0.0;
};

// Measures a session's frames one by one, with what the mask leaves. Errors: the mask cannot be
// read or has another size; of a rig, what FrameMeasurer says.
Result<FrameMeasurer> OpenOwnFrames(const std::filesystem::path& session, const SessionInfo& info,
                                    const FrameMaskOptions& options);

// What one frame alone says about the light, on the grid of a written view: linear relative
// radiance, W×H×3; pixels that clipped hold the radiance of the clipping value (what somebody
// without a bracket would have); NaN where the mask or the frame's edge leaves nothing.
Result<Image<float>> OwnFrameRadiance(const std::filesystem::path& session, FrameMeasurer& measurer,
                                      const FrameRecord& frame, const Projection& output,
                                      const Eigen::Quaterniond& camera_from_output);

}  // namespace omnihdr
