#pragma once

#include <span>
#include <vector>

#include "core/sphere/pose.h"

namespace omnihdr {

struct PoseErrors {
  double rotation_deg = 0.0;
  // Distance from the true place, in percent of the way travelled from the chain's first position;
  // 0 for the first.
  double translation_percent = 0.0;
};

struct ChainErrors {
  std::vector<PoseErrors> positions;
  // Truth length per estimated length, least squares over the chain; 1 when it cannot be known.
  double scale = 1.0;
};

// Errors of a chain of poses (world_from_camera, in order) against the true ones, the frames of the
// first position laid on each other. With `fit_scale` the estimate is first brought to the truth's
// length unit (relative scale); without, an error of scale counts. Both spans have the same length.
ChainErrors ComparePoses(std::span<const Pose> estimated, std::span<const Pose> truth,
                         bool fit_scale);

}  // namespace omnihdr
