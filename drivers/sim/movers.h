#pragma once

#include <cstdint>
#include <vector>

#include "core/base/result.h"
#include "drivers/sim/geometry.h"
#include "drivers/sim/lighting.h"
#include "drivers/sim/material.h"
#include "drivers/sim/scene.h"

namespace omnihdr::sim {

// People who walk to and fro beside the vehicle's way while it drives.
struct MoverOptions {
  int count = 0;            // 0 to 16
  double speed = 1.4;       // metres walked per metre driven, 0 to 100
  Status Validate() const;  // kConfig error naming the option and its range
};

// A straight walk to and fro, on the ground.
struct Walk {
  Vec3 from;
  Vec3 to;
  float start = 0.0F;  // metres walked already when the vehicle begins
};

// Walks near the first metres of the vehicle's way, which begins at `start_m` of the scene's path,
// never closer to the path than 0.9 m and clear of everything where such places are found. Equal
// arguments give equal walks.
std::vector<Walk> PlanWalks(const Scene& scene, const Geometry& geometry,
                            const MoverOptions& options, std::uint64_t seed, double start_m);

// The movers of one moment: about 1.75 m tall and 0.5 m wide, each in clothes of its own, lit by
// the scene but throwing no shadow on it. Immutable; any thread.
class MoverGroup {
 public:
  MoverGroup() = default;  // nobody
  // `light`: the scene's own, of `geometry`. `walked_m`: by each since the vehicle began.
  MoverGroup(const Scene& scene, const Geometry& geometry, const BakedLight& light,
             const std::vector<Walk>& walks, double walked_m, std::uint64_t seed);

  bool empty() const { return geometry_.primitives().empty(); }
  // The first mover's surface along a ray, nearer than `t_max`.
  Hit Intersect(Vec3 origin, Vec3 direction, float t_max) const {
    return geometry_.Intersect(origin, direction, t_max);
  }
  // Whether a mover stands between a viewer and what is `distance` away along `direction`.
  bool Hides(Vec3 viewer, Vec3 direction, float distance) const {
    return !empty() && geometry_.Occluded(viewer, direction, distance);
  }
  // Whether a ray passes within `margin` radians of a mover's bounding sphere: where nothing has to
  // be sought otherwise.
  bool MayMeet(Vec3 origin, Vec3 direction, float margin) const;
  // As Shade.
  Vec3 Radiance(Vec3 direction, float pixel, const Hit& hit) const;

 private:
  struct Ball {
    Vec3 centre;
    float radius = 0.0F;
  };
  Geometry geometry_;
  std::vector<Material> materials_;
  std::vector<Ball> balls_;
  BakedLight light_;
};

}  // namespace omnihdr::sim
