#pragma once

#include <cstdint>
#include <memory>
#include <optional>
#include <string_view>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/sphere/pose.h"
#include "core/sphere/projection.h"

namespace omnihdr::sim {

class MoverGroup;
struct MoverOptions;
struct Walk;

// The places that can be rendered.
enum class SceneKind {
  kHall,    // a furnished hall with bright windows, blown lamps, a fireplace and a dark alcove
  kYard,    // houses, trees and a lawn under a sky with the sun
  kTunnel,  // a dark tunnel, the bright outside through its mouth
  kStreet,  // a street at dusk: lamps, lit windows, dark asphalt
};
std::string_view ToString(SceneKind kind);
std::optional<SceneKind> SceneKindFromString(std::string_view name);

// What a perfect camera sees.
struct RenderedView {
  Image<float> radiance;  // W×H×3: linear RGB, 1.0 = value 128 at 1 s and 0 dB
  Image<float> distance;  // W×H: metres along the ray through the pixel's centre; +inf = sky
  // With movers in the world, else empty: the share of each pixel that they cover, 0 to 1, W×H, and
  // the two pictures above without them.
  Image<float> movers = {};
  Image<float> background = {};
  Image<float> background_distance = {};
};

// How the camera moves along the scene's path.
struct MotionOptions {
  double yaw_deg_per_m =
      0.0;                // turning of the camera against the direction of travel, per metre driven
  double sway_deg = 1.0;  // amplitude of the slow pitching and rolling, 0 … 10
  Status Validate() const;
};

// A rendered world of at least four decades of radiance in which every surface is diffuse, so that
// a point has the same radiance from everywhere. A seed gives a layout, textures and light of its
// own; equal arguments give equal bytes, on any number of threads. Immutable; any thread.
class World {
 public:
  // Quick: the light, a second or two of work for the whole scene, is computed by the first Render.
  static std::shared_ptr<const World> Create(SceneKind scene, std::uint64_t seed);
  ~World();
  World(const World&) = delete;
  World& operator=(const World&) = delete;

  SceneKind scene() const { return scene_; }
  std::uint64_t seed() const { return seed_; }

  // Computes the light now, so that no Render has to wait for it.
  void PrepareLight() const;
  // `samples` rays a pixel for the radiance (1 … 64, rounded down to a square number); the distance
  // is that of the centre ray. Uses the worker pool.
  // `movers`: who is there as well, null = nobody.
  RenderedView Render(const Pose& world_from_camera, const Projection& projection, int samples = 4,
                      const MoverGroup* movers = nullptr) const;
  // The same for any picture: `corner_rays` (W+1)×(H+1)×3 are the rays, of any length and in the
  // camera's frame, through the corners of its pixels. A pixel with a corner that is not finite
  // sees nothing: radiance 0, distance NaN.
  RenderedView RenderRays(const Pose& world_from_camera, ImageView<const float> corner_rays,
                          int samples = 4, const MoverGroup* movers = nullptr) const;
  // The ways of movers near the drive that begins `start_m` along the path (drivers/sim/movers.h),
  // and who is there when each has walked so far.
  std::vector<Walk> PlanWalks(const MoverOptions& options, double start_m) const;
  MoverGroup MoversAt(const std::vector<Walk>& walks, double walked_m) const;
  // world_from_camera at a distance (metres, any real number) along the path: 1.5 to 2 m above the
  // ground, at least 0.4 m away from everything.
  Pose PoseAt(double distance_m, const MotionOptions& motion = {}) const;
  // Whether nothing of the scene (movers apart) stands between a place and a point of a surface.
  bool IsClear(const Eigen::Vector3d& place, const Eigen::Vector3d& surface) const;
  // Distance to the nearest surface, metres.
  double Clearance(const Eigen::Vector3d& point_in_world) const;

 private:
  struct Impl;
  World(SceneKind scene, std::uint64_t seed);
  SceneKind scene_;
  std::uint64_t seed_;
  std::unique_ptr<Impl> impl_;
};

}  // namespace omnihdr::sim
