#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>

#include "drivers/sim/scene.h"

namespace omnihdr::sim {

// What the scenes are put together with. Only the scenes' own files need it.

// Puts solids together; distances in metres, yaw in radians.
class Builder {
 public:
  Builder(Scene& scene, std::uint64_t seed) : random(seed), scene_(scene) {}

  Random random;

  int Mat(Pattern pattern, Vec3 colour, Vec3 second = {0.3F, 0.3F, 0.3F}, float size = 0.2F,
          float contrast = 1.0F) {
    scene_.materials.push_back({pattern, colour, second, size, contrast});
    return static_cast<int>(scene_.materials.size()) - 1;
  }
  void SetIndoor(bool indoor) { indoor_ = indoor; }
  void SetTexel(float texel) { texel_ = texel; }

  Primitive& Add(Shape shape, Vec3 centre, Vec3 half, int material, float yaw = 0.0F) {
    Primitive p;
    p.shape = shape;
    p.centre = centre;
    p.half = half;
    p.material = material;
    p.indoor = indoor_;
    p.texel = texel_;
    p.axis_x = {std::cos(yaw), std::sin(yaw), 0.0F};
    p.axis_y = {-std::sin(yaw), std::cos(yaw), 0.0F};
    scene_.primitives.push_back(p);
    return scene_.primitives.back();
  }
  // From corner to corner, axis-aligned.
  Primitive& Block(Vec3 low, Vec3 high, int material) {
    return Add(Shape::kBox, (low + high) * 0.5F, (high - low) * 0.5F, material);
  }
  // Standing on z = `bottom`.
  Primitive& Standing(float x, float y, float bottom, Vec3 size, int material, float yaw = 0.0F) {
    return Add(Shape::kBox, {x, y, bottom + size.z * 0.5F}, size * 0.5F, material, yaw);
  }
  Primitive& Pole(float x, float y, float bottom, float radius, float height, int material) {
    return Add(Shape::kCylinder, {x, y, bottom + height * 0.5F}, {radius, radius, height * 0.5F},
               material);
  }
  Primitive& Ball(Vec3 centre, float radius, int material) {
    return Add(Shape::kSphere, centre, {radius, radius, radius}, material);
  }
  // A rectangle of full size (width along its x axis) facing `normal`; x axis horizontal.
  Primitive& Panel(Vec3 centre, Vec3 normal, float width, float height, int material) {
    Primitive& p = Add(Shape::kQuad, centre, {width * 0.5F, height * 0.5F, 0.0F}, material);
    p.axis_z = normal;
    p.axis_x =
        std::abs(normal.z) > 0.99F ? Vec3{1, 0, 0} : Normalised(Cross(Vec3{0, 0, 1}, normal));
    p.axis_y = Cross(p.axis_z, p.axis_x);
    return p;
  }
  void Ground(float z, float half_x, float half_y, int material, float texel) {
    Panel({0, 0, z}, {0, 0, 1}, 2 * half_x, 2 * half_y, material).texel = texel;
  }
  // An emitting box and its light, shining down.
  void CeilingLamp(Vec3 centre, float width, float length, Vec3 radiance, int body) {
    Standing(centre.x, centre.y, centre.z + 0.012F, {width + 0.06F, length + 0.06F, 0.05F}, body);
    Primitive& face = Panel(centre, {0, 0, -1}, width, length, body);
    face.emission = radiance;
    scene_.lights.push_back({centre - Vec3{0, 0, 0.01F},
                             radiance,
                             {width * 0.5F, 0, 0},
                             {0, length * 0.5F, 0},
                             {0, 0, -1}});
  }
  // A glowing ball that lights all round.
  void Globe(Vec3 centre, float radius, Vec3 radiance, int body) {
    Ball(centre, radius, body).emission = radiance;
    // Shadow rays end below it, or they would all meet the ball itself.
    const float half = radius * 0.886F;  // a square of the disc's area
    scene_.lights.push_back({centre - Vec3{0, 0, radius + 0.02F},
                             radiance,
                             {half, 0, 0},
                             {0, half, 0},
                             {0, 0, -1},
                             true});
  }
  void Tree(float x, float y, float height, float crown, int bark, int leaves, int more_leaves,
            int blobs) {
    Pole(x, y, 0.0F, 0.035F * height + 0.05F, height * 0.72F, bark);
    for (int i = 0; i < blobs; ++i) {
      const float angle = random.Range(0.0F, 2 * std::numbers::pi_v<float>);
      const float up = random.Range(-0.75F, 0.9F);
      const float out =
          crown * std::sqrt(std::max(0.0F, 1.0F - up * up)) * random.Range(0.2F, 0.8F);
      const Vec3 centre{x + out * std::cos(angle), y + out * std::sin(angle),
                        height - crown * (0.9F - 0.9F * up)};
      Ball(centre, crown * random.Range(0.24F, 0.46F), random.Index(2) == 0 ? leaves : more_leaves)
          .texel = 0.25F;
    }
  }
  // Whether something of this radius at (x, y) leaves the vehicle room.
  bool OffPath(float x, float y, float radius) const {
    return scene_.path.DistanceFrom(x, y) > radius + 0.75;
  }

 private:
  Scene& scene_;
  bool indoor_ = false;
  float texel_ = 0.15F;
};

// A smooth closed oval round the origin: its curvature never jumps. `squash` in [0, 1): 0 is a
// circle.
Path Oval(double length, double squash);

// Along +X with a slow weave of the given amplitude (metres) and wave length.
Path Weave(double start_x, double start_y, double length, double amplitude, double wave);

// A unit vector.
Vec3 Direction(float azimuth_deg, float elevation_deg);

struct OutdoorMaterials {
  int grass;
  int bark;
  int leaves;
  int dark_leaves;
};
OutdoorMaterials AddOutdoorMaterials(Builder& b);

// A house with windows and a gabled roof.
void House(Builder& b, float x, float y, Vec3 size, float yaw, int wall, int roof, int glass,
           int frame);

// A garage open towards +Y, black inside: the dark corner of a bright scene.
void Garage(Builder& b, float gx, float gy, int black, int planks);

// Multiplies every source of light: puts a scene's tones where exposures of 1 to 16 ms see them.
void ScaleLight(Scene& scene, float factor);

}  // namespace omnihdr::sim
