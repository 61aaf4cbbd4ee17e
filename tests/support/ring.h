#pragma once

#include <cstdint>
#include <functional>
#include <vector>

#include "core/image/image_io.h"
#include "core/photometry/mosaic.h"
#include "core/sphere/rig.h"

namespace omnihdr::testing {

// Radiance (R, G, B) of a point of the scene, in the camera's frame.
using RadianceAt = std::function<Eigen::Vector3d(const Eigen::Vector3d& point_in_camera)>;

struct RingOptions {
  int width = 128;  // of a sensor, lying on its side as in a Ladybug
  int height = 96;
  BayerOrder bayer = BayerOrder::kBggr;
  double offset_m = 0.04;  // of the lenses from the centre
  double sphere_radius_m = 10.0;
  double blend_width_deg = 4.0;
  Vignetting vignetting{{-0.3, 0.05, 0.0}};
  bool equal_gains = false;  // otherwise every sensor and channel has its own
};
// Radiance that comes along a ray (unit) from a point, both in the camera's frame.
using RadianceAlong =
    std::function<Eigen::Vector3d(const Eigen::Vector3d& from, const Eigen::Vector3d& ray)>;

// Five sensors round and one up, as a Ladybug has them, with fisheye lenses that overlap.
Rig MakeRing(const RingOptions& options = {});

// What the rig's sensors count, stacked, each from its own place. Value 128 for radiance 1.0 at 1
// s; vignetting, gain and Bayer pattern of the rig applied; rounded, clipped at the largest value
// of `bits` (8: bytes, else 16-bit). `noise_rms` in 8-bit values, seeded. Three channels when the
// rig has no Bayer pattern.
DecodedImage ShootRig(const Rig& rig, const RadianceAlong& scene, double seconds, int bits = 8,
                      double noise_rms = 0.0, std::uint64_t seed = 1);
// The same of a scene on a sphere of `distance` round the camera.
DecodedImage ShootRing(const Rig& rig, const RadianceAt& scene, double distance, double seconds,
                       int bits = 8, double noise_rms = 0.0, std::uint64_t seed = 1);

}  // namespace omnihdr::testing
