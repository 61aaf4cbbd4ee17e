#include "drivers/sim/scene_builder.h"

namespace omnihdr::sim {
namespace {

constexpr float kPi = std::numbers::pi_v<float>;

}  // namespace

Scene BuildTunnel(std::uint64_t seed) {
  Scene scene;
  scene.path = Weave(-12.0, 0.0, 60.0, 0.35, 24.0);
  scene.camera_height = 1.8;
  Builder b(scene, seed * 7919 + 307);
  Sky& sky = scene.sky;
  sky.zenith = {500, 850, 1700};
  sky.horizon = {2100, 2300, 2600};
  sky.below = {300, 320, 260};
  sky.cloud = {3600, 3600, 3700};
  sky.sun_direction = Direction(b.random.Range(18.0F, 40.0F), b.random.Range(38.0F, 48.0F));
  sky.sun_irradiance = {16000, 15000, 13000};
  sky.glow = {200000, 190000, 170000};
  sky.seed = static_cast<std::uint32_t>(seed) * 29U + 7U;
  const OutdoorMaterials outdoor = AddOutdoorMaterials(b);
  const int asphalt = b.Mat(Pattern::kAsphalt, {0.11F, 0.11F, 0.11F});
  const int concrete = b.Mat(Pattern::kConcrete, {0.34F, 0.33F, 0.31F}, {0.2F, 0.2F, 0.2F}, 1.2F);
  const int lining = b.Mat(Pattern::kBrick, {0.24F, 0.17F, 0.13F}, {0.3F, 0.29F, 0.27F}, 0.34F);
  const int tiles = b.Mat(Pattern::kTiles, {0.45F, 0.45F, 0.40F}, {0.15F, 0.15F, 0.14F}, 0.22F);
  const int rock = b.Mat(Pattern::kConcrete, {0.22F, 0.19F, 0.16F}, {0.1F, 0.1F, 0.1F}, 3.1F, 2.0F);
  const int paint = b.Mat(Pattern::kPlaster, {0.7F, 0.7F, 0.66F});
  const int pipe = b.Mat(Pattern::kBark, {0.3F, 0.15F, 0.1F});
  const int black =
      b.Mat(Pattern::kConcrete, {0.008F, 0.008F, 0.008F}, {0.005F, 0.005F, 0.005F}, 0.7F);
  const int sign = b.Mat(Pattern::kPicture, {0.6F, 0.5F, 0.1F}, {0.1F, 0.2F, 0.5F}, 0.14F);
  const int barrel = b.Mat(Pattern::kStripes, {0.5F, 0.16F, 0.05F}, {0.6F, 0.57F, 0.5F}, 0.3F);
  const int wood = b.Mat(Pattern::kPlanks, {0.26F, 0.18F, 0.11F}, {0.08F, 0.05F, 0.03F}, 0.12F);

  const float mouth = 0.0F;
  const float back = -46.0F;
  const float half_width = 3.3F;
  const float spring = 2.4F;  // height at which the arch begins
  b.Ground(-0.02F, 90.0F, 70.0F, outdoor.grass, 0.6F);
  b.SetTexel(0.2F);
  b.Block({0.0F, -2.7F, -0.3F}, {90.0F, 2.7F, 0.005F}, asphalt).texel = 0.3F;
  b.SetIndoor(true);
  b.Block({-46.0F, -2.7F, -0.3F}, {0.0F, 2.7F, 0.005F}, asphalt).texel = 0.2F;
  b.SetIndoor(false);
  for (int i = 0; i < 26; ++i) {
    b.Standing(-44.0F + 4.0F * static_cast<float>(i), 0.0F, 0.0F, {1.6F, 0.13F, 0.009F}, paint);
  }
  b.SetIndoor(true);
  scene.portals.push_back({{0.02F, 0.0F, 2.85F}, {0, half_width, 0}, {0, 0, 2.85F}, {-1, 0, 0}});
  // Side walls with pavements, the arch above in facets.
  const float length = mouth - back;
  const float middle = (mouth + back) / 2;
  const auto facet = [&](float y, float z, float ny, float nz, float height, int material) {
    Primitive& p = b.Panel({middle, y, z}, {0, ny, nz}, length, height, material);
    p.texel = 0.22F;
    p.axis_x = {1, 0, 0};
    p.axis_y = Cross(p.axis_z, p.axis_x);
  };
  for (const float side : {-1.0F, 1.0F}) {
    facet(side * half_width, 0.7F, -side, 0.0F, 1.4F, tiles);
    facet(side * half_width, 1.4F + (spring - 1.4F) / 2, -side, 0.0F, spring - 1.4F, lining);
    b.Block({back, side > 0 ? half_width - 0.6F : -half_width, 0.0F},
            {mouth, side > 0 ? half_width : -half_width + 0.6F, 0.16F}, concrete);
  }
  constexpr int kFacets = 10;
  for (int i = 0; i < kFacets; ++i) {
    const float a0 = kPi * static_cast<float>(i) / kFacets;
    const float a1 = kPi * static_cast<float>(i + 1) / kFacets;
    const float am = (a0 + a1) / 2;
    const float radius = half_width * std::cos((a1 - a0) / 2);
    facet(radius * std::cos(am), spring + radius * std::sin(am), -std::cos(am), -std::sin(am),
          2 * half_width * std::sin((a1 - a0) / 2) + 0.01F, lining);
  }
  b.Panel({back, 0.0F, 3.0F}, {1, 0, 0}, 7.0F, 6.2F, black);
  b.SetIndoor(false);
  // The hill above, the portal front in courses round the arch, wing walls.
  b.Block({back - 2.0F, -40.0F, spring + half_width + 0.5F}, {mouth - 0.6F, 40.0F, 9.5F}, rock)
      .texel = 0.8F;
  for (const float side : {-1.0F, 1.0F}) {
    const float y0 = side > 0 ? half_width + 0.05F : -40.0F;
    const float y1 = side > 0 ? 40.0F : -half_width - 0.05F;
    b.Block({back - 2.0F, y0, -0.5F}, {mouth - 0.6F, y1, spring + half_width + 0.5F}, rock).texel =
        0.8F;
    b.Block({mouth - 0.6F, side > 0 ? half_width : -half_width - 3.0F, 0.0F},
            {mouth, side > 0 ? half_width + 3.0F : -half_width, 7.2F}, concrete);
    for (int i = 0; i < 9; ++i) {
      const float x = 1.0F + 2.0F * static_cast<float>(i);
      b.Standing(x, side * (half_width + 1.6F + 0.22F * static_cast<float>(i)), 0.0F,
                 {2.0F, 0.5F, 5.0F - 0.45F * static_cast<float>(i)}, i % 3 == 2 ? lining : concrete,
                 side * 0.11F);
    }
  }
  for (int i = 0; i < 8; ++i) {  // courses that step round the arch
    const float z0 = spring + half_width * static_cast<float>(i) / 8.0F;
    const float z1 = spring + half_width * static_cast<float>(i + 1) / 8.0F;
    const float open =
        std::sqrt(std::max(0.0F, half_width * half_width - (z0 - spring) * (z0 - spring)));
    for (const float side : {-1.0F, 1.0F}) {
      b.Block({mouth - 0.6F, side > 0 ? open : -half_width, z0},
              {mouth, side > 0 ? half_width : -open, z1}, concrete);
    }
  }
  b.Block({mouth - 0.6F, -half_width, spring + half_width}, {mouth, half_width, 7.2F}, concrete);
  b.Block({mouth - 0.7F, -half_width - 3.2F, 7.2F}, {mouth + 0.15F, half_width + 3.2F, 7.5F},
          concrete);
  b.SetIndoor(true);
  // Inside: ribs, pipes, niches, dim lamps, things left behind.
  for (int i = 0; i < 11; ++i) {
    const float x = -2.0F - 4.0F * static_cast<float>(i);
    for (const float side : {-1.0F, 1.0F}) {
      b.Block({x - 0.18F, side > 0 ? half_width - 0.16F : -half_width, 0.0F},
              {x + 0.18F, side > 0 ? half_width : -half_width + 0.16F, spring}, concrete);
      b.Add(Shape::kBox, {x + 2.0F, side * (half_width - 0.01F), 1.05F}, {0.4F, 0.06F, 0.8F},
            black);
    }
    const Vec3 sodium{60000, 43000, 21000};
    b.CeilingLamp({x, 0.0F, spring + half_width - 0.35F}, 0.5F, 0.12F,
                  sodium * b.random.Range(0.6F, 1.3F), black);
  }
  for (const float z : {2.15F, 2.4F}) {
    Primitive& tube =
        b.Add(Shape::kCylinder, {middle, half_width - 0.12F, z}, {0.07F, 0.07F, length / 2}, pipe);
    tube.axis_z = {1, 0, 0};
    tube.axis_x = {0, 1, 0};
    tube.axis_y = {0, 0, 1};
  }
  Primitive& cable = b.Add(Shape::kCylinder, {middle, -half_width + 0.08F, 2.3F},
                           {0.035F, 0.035F, length / 2}, black);
  cable.axis_z = {1, 0, 0};
  cable.axis_x = {0, 1, 0};
  cable.axis_y = {0, 0, 1};
  for (int i = 0; i < 9; ++i) {
    const float x = b.random.Range(-30.0F, -2.0F);
    const float side = i % 2 == 0 ? 1.0F : -1.0F;
    const float y = side * (half_width - 0.42F);
    if (i % 3 == 0) {
      b.Pole(x, y, 0.16F, 0.27F, 0.85F, barrel);
    } else if (i % 3 == 1) {
      b.Standing(x, y, 0.16F, {0.7F, 0.5F, 0.5F}, wood, b.random.Range(-0.3F, 0.3F));
      b.Standing(x + 0.1F, y, 0.66F, {0.4F, 0.4F, 0.35F}, wood, b.random.Range(-0.3F, 0.3F));
    } else {
      b.Panel({x, side * (half_width - 0.02F), 1.9F}, {0, -side, 0}, 0.8F, 0.6F, sign);
    }
  }
  b.SetIndoor(false);
  // Outside: trees, a house, posts, barriers.
  for (int i = 0; i < 18; ++i) {
    const float x = b.random.Range(6.0F, 60.0F);
    const float y = (i % 2 == 0 ? 1.0F : -1.0F) * b.random.Range(7.5F, 26.0F);
    const float height = b.random.Range(4.5F, 9.0F);
    if (y < 0.0F && y > -13.0F) continue;  // the garages stand there
    b.Tree(x, y, height, height * 0.28F, outdoor.bark, outdoor.leaves, outdoor.dark_leaves, 12);
  }
  const int wall = b.Mat(Pattern::kPlaster, {0.6F, 0.55F, 0.45F});
  const int roof = b.Mat(Pattern::kRoof, {0.33F, 0.12F, 0.07F}, {0.1F, 0.05F, 0.04F}, 0.33F);
  const int glass = b.Mat(Pattern::kPlain, {0.005F, 0.006F, 0.007F});
  House(b, 34.0F, 14.0F, {10.0F, 8.0F, 5.4F}, 0.3F, wall, roof, glass, paint);
  const int pitch =
      b.Mat(Pattern::kPlanks, {0.007F, 0.007F, 0.007F}, {0.004F, 0.004F, 0.004F}, 0.2F);
  for (const float x : {17.0F, 31.0F, 46.0F}) Garage(b, x, -6.6F, pitch, wood);
  House(b, 66.0F, -3.0F, {12.0F, 9.0F, 5.4F}, 1.4F, lining, roof, glass, paint);
  for (int i = 0; i < 14; ++i) {
    for (const float side : {-1.0F, 1.0F}) {
      b.Standing(9.0F + 3.5F * static_cast<float>(i), side * 3.4F, 0.0F, {0.12F, 0.1F, 1.0F},
                 i % 2 == 0 ? paint : barrel);
    }
  }
  ScaleLight(scene, 1.3F);
  return scene;
}

}  // namespace omnihdr::sim
