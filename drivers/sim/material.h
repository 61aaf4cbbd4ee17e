#pragma once

#include <cstdint>

#include "drivers/sim/geometry.h"

namespace omnihdr::sim {

// Procedural surface patterns. Lengths are metres on the surface.
enum class Pattern : std::uint8_t {
  kPlain,     // one colour with a faint stain: a wall with nothing for stereo to hold on to
  kPlaster,   // faint grain and stains
  kBrick,     // bricks of `size` in running bond, mortar in the second colour
  kPlanks,    // boards of width `size` along u, wood grain
  kTiles,     // square tiles of `size`, grout in the second colour
  kCarpet,    // a woven pattern of period `size` in two colours
  kGrass,     // blades and patches
  kFoliage,   // leaves, light and dark
  kBark,      // streaks along v
  kAsphalt,   // fine stones, cracks and patches
  kConcrete,  // stains, pores and formwork seams every `size`
  kBooks,     // book backs of about `size` standing in rows
  kPicture,   // a painting: patches of unrelated colours
  kRoof,      // rows of roof tiles of `size`
  kStripes,   // soft stripes along v (curtains, corrugated sheet)
  kLitRoom,   // what is seen through a lit window; used with emission
};

struct Material {
  Pattern pattern = Pattern::kPlain;
  Vec3 colour{0.5F, 0.5F, 0.5F};  // albedo, linear RGB
  Vec3 second{0.3F, 0.3F, 0.3F};
  float size = 0.2F;
  float contrast = 1.0F;  // scales the noise
};

// A point of a surface as textures see it.
struct SurfacePoint {
  float u = 0.0F;  // metres along the face
  float v = 0.0F;
  Vec3 local;              // metres in the primitive's frame, for curved surfaces
  bool solid = false;      // use `local` instead of (u, v)
  float footprint = 0.0F;  // size of a pixel on the surface, metres: finer detail is left out
  std::uint32_t seed = 0;  // makes equal materials differ from object to object
};

// Albedo at a point, each channel in [0, 0.95]. Any thread.
Vec3 Albedo(const Material& material, const SurfacePoint& at);
// The albedo without pattern, for indirect light.
Vec3 MeanAlbedo(const Material& material);

// Smooth noise of unit period, about −1 … 1.
float ValueNoise(float x, float y, std::uint32_t seed);
float ValueNoise(float x, float y, float z, std::uint32_t seed);

}  // namespace omnihdr::sim
