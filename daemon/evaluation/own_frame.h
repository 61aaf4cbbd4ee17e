#pragma once

#include <Eigen/Geometry>
#include <cstdint>
#include <filesystem>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/photometry/measurement.h"
#include "core/session/session.h"
#include "core/sphere/projection.h"

namespace omnihdr {

// Which part of a frame shows the scene.
struct FrameMaskOptions {
  std::filesystem::path file;  // PNG or JPEG the size of a frame, white = use; empty = none
  double ignore_bottom =
      0.0;  // share of the frame's rows, from the bottom, that is left out (0..1)
};
// W×H×1, 255 = use, 0 = leave out, for a session's frames. Errors: the file cannot be read or has
// another size than the frames.
Result<Image<std::uint8_t>> LoadFrameMask(const FrameMaskOptions& options,
                                          const CameraDescription& camera);

// What one frame alone says about the light, on the grid of a written view: linear relative
// radiance, W×H×3; pixels that clipped hold the radiance of the clipping value (what somebody
// without a bracket would have); NaN where the mask or the frame's edge leaves nothing.
Result<Image<float>> OwnFrameRadiance(const std::filesystem::path& session, const SessionInfo& info,
                                      const FrameRecord& frame, ImageView<const std::uint8_t> mask,
                                      const Projection& output,
                                      const Eigen::Quaterniond& camera_from_output);

}  // namespace omnihdr
