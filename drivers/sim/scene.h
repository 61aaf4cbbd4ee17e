#pragma once

#include <cstdint>
#include <functional>
#include <string_view>
#include <vector>

#include "drivers/sim/geometry.h"
#include "drivers/sim/material.h"

namespace omnihdr::sim {

// Light from infinity: a gradient from horizon to zenith, clouds, a glow round the sun and its
// disc.
struct Sky {
  Vec3 zenith;
  Vec3 horizon;
  Vec3 below;  // radiance of what lies below the horizon and beyond the scene
  Vec3 cloud;
  float cloudiness = 0.4F;
  Vec3 sun_direction{0, 0, 1};
  Vec3 sun_irradiance;         // on a surface facing the sun
  Vec3 glow;                   // radiance close to the disc, falling off with the angle
  float disc_radius = 0.014F;  // radians: large enough for a pixel to hit it
  std::uint32_t seed = 0;

  // Radiance from a direction (unit length, pointing away from the viewer), sun disc included if
  // asked.
  Vec3 Radiance(Vec3 direction, bool with_disc = true) const;
};

// An emitter for baking light. Its visible surface is a primitive with emission.
struct AreaLight {
  Vec3 centre;
  Vec3 radiance;
  Vec3 half_u;  // the emitting rectangle spans centre ± half_u ± half_v
  Vec3 half_v;
  Vec3 normal;              // direction of emission
  bool both_sides = false;  // a lamp that shines all round
};

// An opening through which indoor surfaces see the sky.
struct Portal {
  Vec3 centre;
  Vec3 half_u;
  Vec3 half_v;
  Vec3 inward;  // unit normal into the room
};

// The line the vehicle follows, tabulated by distance.
class Path {
 public:
  struct Point {
    double x = 0.0;
    double y = 0.0;
    double heading = 0.0;  // radians from +X towards +Y
  };
  Path() = default;
  // Integrates the heading from `start`: curvature(s) in 1/metre over `length` metres. A closed
  // path comes back to its start and is driven round and round; an open one is driven to and fro.
  Path(Point start, double length, bool closed, const std::function<double(double s)>& curvature);

  Point At(double s) const;
  double length() const { return length_; }
  bool closed() const { return closed_; }
  // Horizontal distance of a point from the line.
  double DistanceFrom(double x, double y) const;

 private:
  std::vector<Point> points_;  // every kStep metres
  double length_ = 0.0;
  bool closed_ = false;
};

struct Scene {
  std::vector<Material> materials;
  std::vector<Primitive> primitives;
  Sky sky;
  std::vector<AreaLight> lights;
  std::vector<Portal> portals;
  Path path;
  double camera_height = 1.6;
};

Scene BuildHall(std::uint64_t seed);
Scene BuildYard(std::uint64_t seed);
Scene BuildTunnel(std::uint64_t seed);
Scene BuildStreet(std::uint64_t seed);

}  // namespace omnihdr::sim
