#pragma once

#include <cstdint>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/sphere/pose.h"
#include "core/sphere/rig.h"
#include "drivers/sim/world.h"

namespace omnihdr::sim {

// The nominal Ladybug2 of config/rigs, as the program was built with it.
Result<Rig> NominalRig();

// A unit of a kind of head as it leaves the factory with its calibration: `nominal` with sensors of
// `width` columns (0 = as they are; smaller pictures of the same field of view), and, where it
// tells no gains and no vignetting, such of each sensor's own, drawn from `seed`. Errors: a size
// that leaves the sensors no even sides of at least 32 pixels.
Result<Rig> SimulatedUnit(const Rig& nominal, int width, std::uint64_t seed);

// Lenses, vignetting and colour filters of a rig in the rendered world.
class RigOptics {
 public:
  // `rig` as Validate and StackedRows accept it.
  explicit RigOptics(Rig rig);

  // What the sensors' pixels collect, stacked top to bottom, W×H×1: each from its own place, the
  // radiance of its filter's colour (grey sensors: green) times vignetting, over gain. 0 where the
  // lens shows nothing. `movers`: who is in the world as well, null = nobody.
  Image<float> Collect(const World& world, const Pose& world_from_camera, int samples,
                       const MoverGroup* movers = nullptr) const;

  const Rig& rig() const { return rig_; }
  int width() const { return rig_.sensors.front().lens.width(); }
  int height() const { return rows_.back(); }

 private:
  Rig rig_;
  std::vector<int> rows_;
  std::vector<Image<float>> corner_rays_;  // per sensor, in its lens frame
  Image<float> factor_;                    // vignetting / gain of a pixel's own colour
};

}  // namespace omnihdr::sim
