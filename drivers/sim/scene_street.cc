#include <array>

#include "drivers/sim/scene_builder.h"

namespace omnihdr::sim {
namespace {

constexpr float kPi = std::numbers::pi_v<float>;

}  // namespace

Scene BuildStreet(std::uint64_t seed) {
  Scene scene;
  scene.path = Weave(-32.0, -1.4, 64.0, 0.4, 30.0);
  scene.camera_height = 1.7;
  Builder b(scene, seed * 7919 + 401);
  Sky& sky = scene.sky;
  sky.zenith = {6, 9, 22};
  sky.horizon = {60, 42, 38};
  sky.below = {2, 2, 2};
  sky.cloud = {16, 14, 19};
  sky.cloudiness = 0.5F;
  sky.sun_direction = Direction(b.random.Range(170.0F, 195.0F), -2.0F);
  sky.glow = {500, 220, 80};
  sky.seed = static_cast<std::uint32_t>(seed) * 31U + 9U;
  const OutdoorMaterials outdoor = AddOutdoorMaterials(b);
  const int asphalt = b.Mat(Pattern::kAsphalt, {0.075F, 0.075F, 0.08F});
  const int pavement =
      b.Mat(Pattern::kTiles, {0.26F, 0.25F, 0.24F}, {0.1F, 0.1F, 0.1F}, 0.4F, 1.4F);
  const int paint = b.Mat(Pattern::kPlaster, {0.66F, 0.66F, 0.62F});
  const int iron = b.Mat(Pattern::kPlaster, {0.05F, 0.055F, 0.05F});
  const int stone = b.Mat(Pattern::kConcrete, {0.36F, 0.34F, 0.31F}, {0.2F, 0.2F, 0.2F}, 0.45F);
  const int frame = b.Mat(Pattern::kPlaster, {0.6F, 0.58F, 0.54F});
  const int dark_glass = b.Mat(Pattern::kPlain, {0.0035F, 0.004F, 0.005F});
  const int lit = b.Mat(Pattern::kLitRoom, {0.9F, 0.8F, 0.6F}, {0.35F, 0.22F, 0.12F}, 0.95F);
  const int shop = b.Mat(Pattern::kPicture, {0.8F, 0.7F, 0.5F}, {0.4F, 0.4F, 0.5F}, 0.35F);
  const int door = b.Mat(Pattern::kPlanks, {0.12F, 0.07F, 0.04F}, {0.03F, 0.02F, 0.02F}, 0.16F);
  const int roof = b.Mat(Pattern::kRoof, {0.17F, 0.10F, 0.08F}, {0.06F, 0.05F, 0.05F}, 0.33F);
  const int black = b.Mat(Pattern::kPlain, {0.012F, 0.012F, 0.012F});
  const int poster = b.Mat(Pattern::kPicture, {0.6F, 0.2F, 0.2F}, {0.2F, 0.3F, 0.6F}, 0.12F);
  std::array<int, 5> walls{
      b.Mat(Pattern::kBrick, {0.34F, 0.16F, 0.11F}, {0.42F, 0.4F, 0.37F}, 0.25F),
      b.Mat(Pattern::kPlain, {0.5F, 0.43F, 0.32F}),
      b.Mat(Pattern::kConcrete, {0.38F, 0.36F, 0.33F}, {0.2F, 0.2F, 0.2F}, 0.9F),
      b.Mat(Pattern::kBrick, {0.28F, 0.23F, 0.17F}, {0.36F, 0.34F, 0.3F}, 0.3F),
      b.Mat(Pattern::kPlaster, {0.44F, 0.33F, 0.27F})};

  b.Ground(-0.16F, 90.0F, 60.0F, stone, 1.2F);
  b.SetTexel(0.22F);
  b.Standing(0.0F, 0.0F, -0.4F, {130.0F, 7.6F, 0.40F}, asphalt).texel = 0.25F;
  for (const float side : {-1.0F, 1.0F}) {
    b.Standing(0.0F, side * 5.3F, -0.4F, {130.0F, 3.0F, 0.52F}, pavement).texel = 0.25F;
    b.Standing(0.0F, side * 3.74F, -0.4F, {130.0F, 0.14F, 0.535F}, stone);
  }
  for (int i = 0; i < 28; ++i) {
    b.Standing(-54.0F + 4.0F * static_cast<float>(i), 0.25F, 0.0F, {1.8F, 0.12F, 0.008F}, paint);
  }
  // House fronts on both sides.
  for (const float side : {-1.0F, 1.0F}) {
    float x = -60.0F;
    int number = 0;
    while (x < 58.0F) {
      const float width = b.random.Range(8.0F, 14.0F);
      const float height = b.random.Range(7.0F, 12.5F);
      const float y = side * (6.8F + 5.0F);
      const float face = side * 6.8F;
      const int wall = walls[static_cast<std::size_t>((number + b.random.Index(2)) % 5)];
      b.Standing(x + width / 2, y, 0.0F, {width - 0.04F, 10.0F, height}, wall).texel = 0.3F;
      b.Standing(x + width / 2, side * 6.75F, height - 0.1F, {width, 0.5F, 0.3F}, stone);
      b.Standing(x + width / 2, y, height + 0.2F, {width - 0.5F, 8.5F, 1.4F}, roof).texel = 0.6F;
      b.Standing(x + width / 2, side * 6.78F, 0.0F, {width - 0.02F, 0.12F, 0.6F}, stone);
      const int columns = std::max(2, static_cast<int>(width / 2.6F));
      const int floors = static_cast<int>((height - 0.8F) / 2.9F);
      for (int floor = 0; floor < floors; ++floor) {
        for (int column = 0; column < columns; ++column) {
          const float wx =
              x + width * (static_cast<float>(column) + 0.5F) / static_cast<float>(columns);
          const float wz = 1.9F + 2.9F * static_cast<float>(floor);
          if (floor == 0 && column == number % columns) {
            b.Standing(wx, face - side * 0.03F, 0.1F, {1.1F, 0.1F, 2.3F}, door);
            continue;
          }
          b.Add(Shape::kBox, {wx, face, wz}, {0.62F, 0.07F, 0.86F}, frame);
          b.Add(Shape::kBox, {wx, face - side * 0.08F, wz - 0.9F}, {0.7F, 0.14F, 0.05F}, stone);
          const float chance = b.random.Unit();
          const bool is_shop = floor == 0 && number % 3 == 1;
          const Vec3 centre{wx, face - side * 0.075F, wz};
          Primitive& pane = b.Panel(centre, {0, -side, 0}, 1.0F, 1.5F,
                                    is_shop         ? shop
                                    : chance < 0.4F ? lit
                                                    : dark_glass);
          if (is_shop || chance < 0.4F) {
            pane.emission = is_shop ? Vec3{1700, 1550, 1300}
                                    : Vec3{300, 205, 100} * b.random.Range(0.35F, 1.4F);
            if (is_shop) pane.half.x = 0.58F;
            scene.lights.push_back({centre - Vec3{0, side * 0.02F, 0},
                                    pane.emission * (is_shop ? 0.2F : 0.45F),
                                    {pane.half.x, 0, 0},
                                    {0, 0, pane.half.y},
                                    {0, -side, 0}});
          }
        }
      }
      if (number % 2 == 0) {
        b.Panel({x + 0.9F, face - side * 0.09F, 2.2F}, {0, -side, 0}, 0.7F, 1.0F, poster);
      }
      x += width + (number % 4 == 3 ? 2.2F : 0.0F);
      ++number;
    }
  }
  b.Panel({62.0F, 0.0F, 5.0F}, {-1, 0, 0}, 26.0F, 10.0F, walls[0]).texel = 0.5F;
  b.Panel({-64.0F, 0.0F, 4.0F}, {1, 0, 0}, 26.0F, 8.0F, walls[2]).texel = 0.5F;
  // Street lamps, alternating sides.
  for (int i = 0; i < 14; ++i) {
    const float x = -52.0F + 8.0F * static_cast<float>(i);
    const float side = i % 2 == 0 ? 1.0F : -1.0F;
    const float y = side * 4.15F;
    b.Pole(x, y, 0.0F, 0.07F, 4.9F, iron);
    b.Standing(x, y - side * 0.6F, 4.85F, {0.08F, 1.3F, 0.08F}, iron);
    b.Standing(x, y - side * 1.15F, 4.78F, {0.62F, 0.40F, 0.1F}, iron);
    b.Globe({x, y - side * 1.15F, 4.55F}, 0.32F,
            Vec3{24000, 16500, 7800} * b.random.Range(0.8F, 1.2F), paint);
  }
  // Parked cars, trees, bins, bollards.
  for (int i = 0; i < 12; ++i) {
    const float x = -48.0F + 8.6F * static_cast<float>(i) + b.random.Range(-1.0F, 1.0F);
    const float y = 2.75F;
    if (!b.OffPath(x, y, 0.95F)) continue;
    const Vec3 colour{b.random.Range(0.04F, 0.5F), b.random.Range(0.04F, 0.4F),
                      b.random.Range(0.04F, 0.45F)};
    const int body = b.Mat(Pattern::kPlain, colour);
    b.Standing(x, y, 0.28F, {4.1F, 1.68F, 0.55F}, body);
    b.Standing(x - 0.2F, y, 0.83F, {2.2F, 1.5F, 0.52F}, dark_glass);
    b.Standing(x - 0.2F, y, 1.35F, {2.0F, 1.45F, 0.06F}, body);
    for (const float wx : {-1.3F, 1.3F}) {
      for (const float wy : {-0.78F, 0.78F}) {
        Primitive& wheel =
            b.Add(Shape::kCylinder, {x + wx, y + wy, 0.31F}, {0.31F, 0.31F, 0.09F}, black);
        wheel.axis_z = {0, 1, 0};
        wheel.axis_x = {1, 0, 0};
        wheel.axis_y = Cross(wheel.axis_z, wheel.axis_x);
      }
    }
  }
  for (int i = 0; i < 10; ++i) {
    const float x = -46.0F + 11.5F * static_cast<float>(i) + b.random.Range(-1.0F, 1.0F);
    const float side = i % 2 == 0 ? -1.0F : 1.0F;
    b.Tree(x, side * 5.0F, 4.6F, 1.15F, outdoor.bark, outdoor.leaves, outdoor.dark_leaves, 9);
    b.Pole(x + 3.4F, side * 4.3F, 0.12F, 0.24F, 0.8F, iron);
    b.Pole(x + 5.4F, -side * 4.1F, 0.12F, 0.08F, 0.85F, stone);
  }
  ScaleLight(scene, 6.0F);
  return scene;
}

}  // namespace omnihdr::sim
