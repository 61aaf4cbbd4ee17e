#include "drivers/sim/scene_builder.h"

namespace omnihdr::sim {
namespace {

constexpr float kPi = std::numbers::pi_v<float>;

}  // namespace

Scene BuildYard(std::uint64_t seed) {
  Scene scene;
  scene.path = Oval(46.0, 0.6);
  scene.camera_height = 1.7;
  Builder b(scene, seed * 7919 + 211);
  Sky& sky = scene.sky;
  sky.zenith = {260, 520, 1250};
  sky.horizon = {1150, 1400, 1750};
  sky.below = {180, 200, 150};
  sky.cloud = {2100, 2120, 2200};
  sky.cloudiness = 0.48F;
  sky.sun_direction = Direction(b.random.Range(10.0F, 60.0F), b.random.Range(32.0F, 42.0F));
  sky.sun_irradiance = {9000, 8200, 6900};
  sky.glow = {900000, 840000, 730000};
  sky.seed = static_cast<std::uint32_t>(seed) * 23U + 5U;
  const OutdoorMaterials outdoor = AddOutdoorMaterials(b);
  const int brick = b.Mat(Pattern::kBrick, {0.38F, 0.18F, 0.12F}, {0.5F, 0.48F, 0.44F}, 0.26F);
  const int pale = b.Mat(Pattern::kPlain, {0.60F, 0.54F, 0.42F});
  const int plaster = b.Mat(Pattern::kPlaster, {0.52F, 0.50F, 0.47F});
  const int roof = b.Mat(Pattern::kRoof, {0.33F, 0.12F, 0.07F}, {0.1F, 0.05F, 0.04F}, 0.33F);
  const int slate = b.Mat(Pattern::kRoof, {0.15F, 0.16F, 0.18F}, {0.05F, 0.05F, 0.06F}, 0.28F);
  const int glass = b.Mat(Pattern::kPlain, {0.004F, 0.005F, 0.006F});
  const int frame = b.Mat(Pattern::kPlaster, {0.7F, 0.7F, 0.67F});
  const int planks = b.Mat(Pattern::kPlanks, {0.25F, 0.17F, 0.1F}, {0.06F, 0.04F, 0.03F}, 0.14F);
  const int gravel =
      b.Mat(Pattern::kAsphalt, {0.36F, 0.33F, 0.28F}, {0.2F, 0.2F, 0.2F}, 0.2F, 0.9F);
  const int stone = b.Mat(Pattern::kConcrete, {0.4F, 0.39F, 0.36F}, {0.3F, 0.3F, 0.3F}, 0.5F);
  const int black =
      b.Mat(Pattern::kPlanks, {0.011F, 0.010F, 0.010F}, {0.005F, 0.005F, 0.005F}, 0.2F);
  const int flowers = b.Mat(Pattern::kPicture, {0.6F, 0.1F, 0.2F}, {0.7F, 0.6F, 0.1F}, 0.06F);

  b.Ground(0.0F, 70.0F, 70.0F, outdoor.grass, 0.45F);
  // Gravel under the wheels.
  for (int i = 0; i < 46; ++i) {
    const Path::Point at = scene.path.At(i);
    b.SetTexel(0.3F);
    b.Standing(static_cast<float>(at.x), static_cast<float>(at.y), 0.0F,
               {1.25F, 1.5F, 0.010F + 0.001F * static_cast<float>(i % 2)}, gravel,
               static_cast<float>(at.heading));
  }
  b.SetTexel(0.15F);
  House(b, -3.0F, 13.5F, {13.0F, 8.0F, 5.6F}, 0.05F, brick, roof, glass, frame);
  House(b, -18.5F, 1.0F, {11.0F, 8.0F, 5.4F}, 1.5F, pale, slate, glass, frame);
  House(b, 9.0F, -15.0F, {10.0F, 7.0F, 3.4F}, 0.1F + b.random.Range(-0.1F, 0.1F), plaster, roof,
        glass, frame);
  House(b, 27.0F, 12.0F, {9.0F, 8.0F, 5.6F}, 0.9F, brick, slate, glass, frame);
  House(b, 24.0F, -22.0F, {9.0F, 8.0F, 5.6F}, 2.4F, pale, roof, glass, frame);
  const float gx = -9.0F;
  const float gy = -12.0F;
  Garage(b, gx, gy, black, planks);
  // A wooden fence round the garden.
  for (int i = 0; i < 26; ++i) {
    const float x = -24.0F + 2.0F * static_cast<float>(i);
    b.Standing(x, -19.5F, 0.0F, {1.94F, 0.05F, 1.5F}, planks);
    b.Standing(x + 1.0F, -19.45F, 0.0F, {0.1F, 0.1F, 1.7F}, planks);
  }
  // Trees inside the loop and round about.
  for (int i = 0; i < 26; ++i) {
    const bool inner = i < 5;
    const float x = inner ? b.random.Range(-6.5F, 6.5F) : b.random.Range(-30.0F, 34.0F);
    const float y = inner ? b.random.Range(-1.6F, 1.6F) : b.random.Range(-30.0F, 34.0F);
    const float height = inner ? b.random.Range(2.6F, 4.2F) : b.random.Range(4.0F, 8.5F);
    const float crown = height * 0.3F;
    if (!b.OffPath(x, y, inner ? 0.6F * crown : crown)) continue;
    const auto near = [&](float hx, float hy, float r) { return std::hypot(x - hx, y - hy) < r; };
    if (near(-3, 13.5F, 8.5F) || near(-18.5F, 1, 8) || near(9, -15, 7) || near(gx, gy - 2, 5) ||
        near(27, 12, 7) || near(24, -22, 7)) {
      continue;
    }
    b.Tree(x, y, height, crown, outdoor.bark, outdoor.leaves, outdoor.dark_leaves, inner ? 9 : 13);
  }
  // Hedges, flower beds, benches, stones.
  for (int i = 0; i < 12; ++i) {
    const float angle = 2 * kPi * static_cast<float>(i) / 12.0F + b.random.Range(-0.1F, 0.1F);
    const float x = 14.0F * std::cos(angle);
    const float y = 9.0F * std::sin(angle);
    if (!b.OffPath(x, y, 1.2F) || std::hypot(x - gx, y - gy) < 5.0F || y > 8.5F) continue;
    if (i % 3 == 0) {
      b.Standing(x, y, 0.0F, {2.4F, 0.7F, 1.1F}, outdoor.dark_leaves, angle);
    } else if (i % 3 == 1) {
      b.Standing(x, y, 0.0F, {1.8F, 0.9F, 0.25F}, flowers, angle);
    } else {
      b.Standing(x, y, 0.4F, {1.6F, 0.45F, 0.06F}, planks, angle);
      b.Standing(x, y, 0.0F, {0.1F, 0.4F, 0.4F}, stone, angle);
    }
  }
  for (int i = 0; i < 16; ++i) {
    const float x = b.random.Range(-12.0F, 12.0F);
    const float y = b.random.Range(-9.0F, 9.0F);
    const float r = b.random.Range(0.15F, 0.45F);
    if (!b.OffPath(x, y, r)) continue;
    b.Ball({x, y, 0.3F * r}, r, stone);
  }
  ScaleLight(scene, 0.14F);
  return scene;
}

}  // namespace omnihdr::sim
