#pragma once

#include <span>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/sphere/pose.h"

namespace omnihdr {

// A finished view as a source of others: lat-long pictures of one size.
struct SynthesisSource {
  Image<float> radiance;   // W×H×3; NaN = not known
  Image<float> disparity;  // W×H: 1/distance, 0 = infinitely far; NaN = not known
  Pose world_from_output;  // of the pictures' axes; its unit is that whose inverse disparity is
};

struct SynthesisOptions {
  // Two disparities are of one surface within this part of the larger ...
  float relative_tolerance = 0.06F;
  // ... or this share of the inverse of the distance between their viewpoints, whichever is more.
  float parallax_tolerance = 0.01F;
  // How far the blend favours near viewpoints: a source counts (least distance/distance)^this.
  float nearness = 2.0F;
};

struct SynthesizedView {
  Image<float> radiance;   // W×H×3; NaN in holes
  Image<float> disparity;  // W×H: seen from the new viewpoint; NaN in holes
  // Share of the sphere, by solid angle, that no source shows: hidden from all of them, or not
  // known to any.
  double holes = 0.0;
  // Of what is shown, the share that some source with a value there does not see: another surface
  // is in its way.
  double occluded = 0.0;
};

// The scene from a new viewpoint (thesis 5.3.3, where a target has no disparity map of its own):
// every source's disparity is warped forward to the target's lat-long picture, nearest surface
// first, the cracks of the stretched surface closed; the value that most sources (by nearness)
// agree on is the target's; then colours are fetched backward, from every source that sees that
// surface, and blended by nearness in linear radiance; single pixels that no source's grid hit are
// closed from their neighbours. Deterministic on any number of cores. Errors
// (kData): no source, pictures of different sizes or not twice as wide as high, a pose that is not
// finite.
Result<SynthesizedView> SynthesizeView(std::span<const SynthesisSource> sources,
                                       const Pose& world_from_target, int width,
                                       const SynthesisOptions& options);

}  // namespace omnihdr
