#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/image/image.h"
#include "core/image/image_io.h"
#include "core/photometry/noise_model.h"
#include "core/sphere/pose.h"
#include "core/sphere/projection.h"

namespace omnihdr::testing {

// A ball that stands in the room.
struct Ball {
  Eigen::Vector3d centre = Eigen::Vector3d::Zero();
  double radius = 0.5;
  float brightness = 1.0F;  // multiplies its texture
};

// A closed box with textured walls, lit unevenly over about three orders of magnitude, and balls in
// it: a scene of which the radiance and the distance in every direction are known exactly.
struct Room {
  Eigen::Vector3d low = {-7.0, -3.0, -1.5};
  Eigen::Vector3d high = {9.0, 4.0, 2.5};
  std::vector<Ball> balls;
  bool textured = true;        // false: every surface the same grey
  double detail_m = 0.35;      // size of the texture's largest cells
  float brightness = 0.6F;     // median radiance, roughly
  float range_decades = 1.5F;  // of the uneven light, peak to peak
  double texture_shift = 0.0;  // another value: other texture on the same walls

  struct Hit {
    double distance = 0.0;
    Eigen::Vector3f radiance = Eigen::Vector3f::Zero();
  };
  // What lies in direction `ray` (unit, world) from `from`, a point inside the room.
  Hit Look(const Eigen::Vector3d& from, const Eigen::Vector3d& ray) const;
};

struct Truth {
  Image<float> radiance;  // W×H×3: mean over each pixel (2×2 samples)
  Image<float> distance;  // W×H: at the pixel's centre
};
// What a panoramic camera at `world_from_camera` would see without noise or limits.
Truth Render(const Room& room, const Projection& projection, const Pose& world_from_camera);

// An 8-bit linear sensor: Z = 128·E·t with Gaussian noise of variance noise.VarianceOfValue less
// the rounding, which happens by itself; clipped to 0..255. `seed` decides the noise; `with_noise`
// false: only rounding and clipping.
DecodedImage Expose(const Image<float>& radiance, double seconds, std::uint32_t seed,
                    const NoiseModel& noise = {}, bool with_noise = true);

}  // namespace omnihdr::testing
