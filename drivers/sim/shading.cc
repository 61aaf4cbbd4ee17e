#include "drivers/sim/shading.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <numbers>

namespace omnihdr::sim {
namespace {

// Surface coordinates in metres for the texture.
SurfacePoint Surface(const Primitive& p, const Hit& hit) {
  SurfacePoint at;
  const Vec3 l = hit.local;
  at.local = l;
  at.seed = static_cast<std::uint32_t>(hit.primitive) * 2654435761U + 12345U;
  switch (p.shape) {
    case Shape::kQuad:
      at.u = l.x + p.half.x;
      at.v = l.y + p.half.y;
      return at;
    case Shape::kSphere:
      at.solid = true;
      return at;
    case Shape::kCylinder:
      if (hit.face == 0) {
        // Bark and stone go round without a seam; streaks along the axis need (u, v).
        at.u = std::atan2(l.y, l.x) * p.half.x;
        at.v = l.z + p.half.z;
      } else {
        at.u = l.x;
        at.v = l.y;
      }
      return at;
    case Shape::kBox:
      break;
  }
  at.seed += static_cast<std::uint32_t>(hit.face) * 40503U;
  switch (hit.face / 2) {
    case 0:
      at.u = l.y + p.half.y;
      at.v = l.z + p.half.z;
      break;
    case 1:
      at.u = l.x + p.half.x;
      at.v = l.z + p.half.z;
      break;
    default:
      at.u = l.x + p.half.x;
      at.v = l.y + p.half.y;
      break;
  }
  return at;
}

}  // namespace

Vec3 Shade(const std::vector<Material>& materials, const Geometry& geometry,
           const BakedLight& light, Vec3 direction, float pixel, const Hit& hit) {
  const Primitive& p = geometry.primitives()[static_cast<std::size_t>(hit.primitive)];
  const Material& material = materials[static_cast<std::size_t>(p.material)];
  SurfacePoint at = Surface(p, hit);
  const float cosine = std::abs(Dot(p.ToLocal(direction), LocalNormal(p, hit)));
  // Between the pixel's size across and along the line of sight, so that floors keep some detail.
  at.footprint = hit.t * pixel / std::sqrt(std::max(0.05F, cosine));
  const Vec3 albedo = Albedo(material, at);
  if (p.emission.x > 0.0F) {
    return material.pattern == Pattern::kLitRoom || material.pattern == Pattern::kPicture
               ? p.emission * albedo
               : p.emission;
  }
  return albedo * light.Irradiance(geometry, hit) * (1.0F / std::numbers::pi_v<float>);
}

}  // namespace omnihdr::sim
