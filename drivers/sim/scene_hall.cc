#include "drivers/sim/scene_builder.h"

namespace omnihdr::sim {
namespace {

constexpr float kPi = std::numbers::pi_v<float>;

}  // namespace

Scene BuildHall(std::uint64_t seed) {
  Scene scene;
  scene.path = Oval(30.0, 0.72);
  scene.camera_height = 1.55;
  Builder b(scene, seed * 7919 + 101);
  Sky& sky = scene.sky;
  sky.zenith = {420, 700, 1350};
  sky.horizon = {1700, 1850, 2050};
  sky.below = {260, 290, 200};
  sky.cloud = {2900, 2900, 2950};
  sky.sun_direction = Direction(b.random.Range(60.0F, 100.0F), b.random.Range(36.0F, 46.0F));
  sky.sun_irradiance = {15000, 13800, 11800};
  sky.glow = {90000, 85000, 76000};
  sky.seed = static_cast<std::uint32_t>(seed) * 17U + 3U;

  const float lx = 9.0F;
  const float ly = 5.2F;
  const float lz = 4.4F;
  const int plaster = b.Mat(Pattern::kPlain, {0.62F, 0.59F, 0.52F});
  const int plaster_grain = b.Mat(Pattern::kPlaster, {0.52F, 0.40F, 0.33F});
  const int ceiling = b.Mat(Pattern::kPlain, {0.74F, 0.74F, 0.72F});
  const int brick = b.Mat(Pattern::kBrick, {0.36F, 0.17F, 0.11F}, {0.45F, 0.43F, 0.4F}, 0.24F);
  const int parquet = b.Mat(Pattern::kPlanks, {0.34F, 0.21F, 0.11F}, {0.08F, 0.05F, 0.03F}, 0.09F);
  const int oak = b.Mat(Pattern::kPlanks, {0.38F, 0.24F, 0.13F}, {0.1F, 0.07F, 0.04F}, 0.16F);
  const int dark_wood =
      b.Mat(Pattern::kPlanks, {0.085F, 0.05F, 0.032F}, {0.03F, 0.02F, 0.01F}, 0.12F);
  const int books = b.Mat(Pattern::kBooks, {0.3F, 0.16F, 0.1F}, {0.25F, 0.15F, 0.08F}, 0.045F);
  const int picture = b.Mat(Pattern::kPicture, {0.6F, 0.45F, 0.2F}, {0.15F, 0.25F, 0.45F}, 0.16F);
  const int picture2 = b.Mat(Pattern::kPicture, {0.55F, 0.2F, 0.15F}, {0.1F, 0.3F, 0.2F}, 0.09F);
  const int rug = b.Mat(Pattern::kCarpet, {0.38F, 0.07F, 0.05F}, {0.42F, 0.34F, 0.2F}, 0.32F);
  const int rug2 = b.Mat(Pattern::kCarpet, {0.07F, 0.11F, 0.25F}, {0.48F, 0.44F, 0.36F}, 0.22F);
  const int sofa = b.Mat(Pattern::kCarpet, {0.13F, 0.2F, 0.17F}, {0.2F, 0.27F, 0.22F}, 0.06F, 0.7F);
  const int curtain = b.Mat(Pattern::kStripes, {0.5F, 0.13F, 0.1F}, {0.3F, 0.06F, 0.05F}, 0.14F);
  const int soot =
      b.Mat(Pattern::kBrick, {0.007F, 0.0065F, 0.006F}, {0.005F, 0.005F, 0.005F}, 0.24F);
  const int lacquer = b.Mat(Pattern::kPlain, {0.003F, 0.003F, 0.0035F});
  const int stone = b.Mat(Pattern::kConcrete, {0.48F, 0.45F, 0.4F}, {0.3F, 0.3F, 0.3F}, 0.6F);
  const int metal = b.Mat(Pattern::kPlaster, {0.22F, 0.22F, 0.23F});
  const int white = b.Mat(Pattern::kPlaster, {0.72F, 0.71F, 0.68F});
  const int pot = b.Mat(Pattern::kPlaster, {0.42F, 0.2F, 0.12F});
  const OutdoorMaterials outdoor = AddOutdoorMaterials(b);

  // Outside, seen through the windows.
  const int house_wall = b.Mat(Pattern::kBrick, {0.4F, 0.22F, 0.16F}, {0.5F, 0.48F, 0.45F}, 0.3F);
  const int house_pale = b.Mat(Pattern::kPlaster, {0.62F, 0.57F, 0.46F});
  const int roof = b.Mat(Pattern::kRoof, {0.34F, 0.12F, 0.07F}, {0.12F, 0.06F, 0.05F}, 0.35F);
  const int glass = b.Mat(Pattern::kPlain, {0.005F, 0.006F, 0.007F});
  const int frame = b.Mat(Pattern::kPlaster, {0.7F, 0.7F, 0.66F});
  b.Ground(-0.3F, 60.0F, 60.0F, outdoor.grass, 0.6F);
  for (int i = 0; i < 5; ++i) {
    House(b, -24.0F + 12.0F * static_cast<float>(i), 24.0F + b.random.Range(-3.0F, 3.0F),
          {8.0F, 7.0F, b.random.Range(4.0F, 6.0F)}, b.random.Range(-0.2F, 0.2F),
          i % 2 == 0 ? house_wall : house_pale, roof, glass, frame);
  }
  House(b, 26.0F, 2.0F, {9.0F, 8.0F, 5.5F}, kPi / 2, house_pale, roof, glass, frame);
  for (int i = 0; i < 5; ++i) {
    b.Tree(-15.0F + 7.0F * static_cast<float>(i) + b.random.Range(-2.0F, 2.0F),
           b.random.Range(10.5F, 15.0F), b.random.Range(4.0F, 6.0F), 1.6F, outdoor.bark,
           outdoor.leaves, outdoor.dark_leaves, 9);
  }

  b.SetIndoor(true);
  b.SetTexel(0.10F);
  b.Panel({0, 0, 0}, {0, 0, 1}, 2 * lx, 2 * ly, parquet).texel = 0.07F;
  b.Panel({0, 0, lz}, {0, 0, -1}, 2 * lx, 2 * ly, ceiling).texel = 0.16F;
  // Roof slab, so that no sun falls through.
  b.Block({-lx - 0.4F, -ly - 0.4F, lz + 0.01F}, {lx + 0.4F, ly + 0.4F, lz + 0.3F}, white).texel =
      0.6F;
  const float thick = 0.35F;
  // A wall along X with openings at the given x ranges.
  struct Opening {
    float low;
    float high;
    float sill;
    float top;
  };
  const auto wall_y = [&](float y0, float y1, const std::vector<Opening>& openings, int material) {
    float x = -lx - thick;
    for (const Opening& o : openings) {
      b.Block({x, y0, 0}, {o.low, y1, lz}, material);
      if (o.sill > 0.0F) b.Block({o.low, y0, 0}, {o.high, y1, o.sill}, material);
      b.Block({o.low, y0, o.top}, {o.high, y1, lz}, material);
      x = o.high;
    }
    b.Block({x, y0, 0}, {lx + thick, y1, lz}, material);
  };
  std::vector<Opening> windows;
  for (int i = 0; i < 4; ++i) {
    const float c = -6.3F + 4.2F * static_cast<float>(i) + b.random.Range(-0.25F, 0.25F);
    windows.push_back({c - 0.95F, c + 0.95F, 0.85F, 3.3F});
  }
  wall_y(ly, ly + thick, windows, plaster);
  for (const Opening& o : windows) {
    const float c = (o.low + o.high) / 2;
    b.Block({c - 0.04F, ly + 0.15F, o.sill}, {c + 0.04F, ly + 0.22F, o.top}, white);
    b.Block({o.low, ly + 0.15F, 2.35F}, {o.high, ly + 0.22F, 2.43F}, white);
    b.Block({o.low - 0.1F, ly - 0.12F, o.sill - 0.07F}, {o.high + 0.1F, ly, o.sill}, white);
    b.Block({o.low - 0.55F, ly - 0.16F, 0.15F}, {o.low - 0.1F, ly - 0.06F, 3.5F}, curtain);
    b.Block({o.high + 0.1F, ly - 0.16F, 0.15F}, {o.high + 0.55F, ly - 0.06F, 3.5F}, curtain);
    scene.portals.push_back({{c, ly + 0.08F, (o.sill + o.top) / 2},
                             {0.95F, 0, 0},
                             {0, 0, (o.top - o.sill) / 2},
                             {0, -1, 0}});
  }
  // The far side: plain wall with a deep dark alcove and a dim door recess.
  wall_y(-ly - thick, -ly, {{-7.9F, -5.9F, 0.0F, 2.3F}, {4.6F, 5.8F, 0.0F, 2.2F}}, plaster_grain);
  // The alcove: a sooty tunnel of a room.
  b.Block({-8.2F, -ly - 3.4F, -0.05F}, {-5.6F, -ly - 3.2F, 2.6F}, soot);
  b.Block({-8.1F, -ly - 3.4F, -0.05F}, {-7.9F, -ly - thick, 2.6F}, soot);
  b.Block({-5.9F, -ly - 3.4F, -0.05F}, {-5.7F, -ly - thick, 2.6F}, soot);
  b.Block({-8.1F, -ly - 3.4F, 2.3F}, {-5.7F, -ly - thick, 2.6F}, soot);
  b.Block({-8.1F, -ly - 3.4F, -0.2F}, {-5.7F, -ly, 0.01F}, soot);
  b.Standing(-7.0F, -ly - 2.4F, 0.0F, {1.2F, 0.6F, 0.9F}, soot);
  b.Block({4.6F, -ly - thick - 0.12F, 0.0F}, {5.8F, -ly - 0.25F, 2.2F}, dark_wood);
  // End walls: brick with one window, and one with the fireplace.
  b.Block({lx, -ly - thick, 0}, {lx + thick, -1.1F, lz}, brick);
  b.Block({lx, 1.1F, 0}, {lx + thick, ly + thick, lz}, brick);
  b.Block({lx, -1.1F, 0}, {lx + thick, 1.1F, 0.9F}, brick);
  b.Block({lx, -1.1F, 3.2F}, {lx + thick, 1.1F, lz}, brick);
  b.Block({lx + 0.15F, -0.04F, 0.9F}, {lx + 0.22F, 0.04F, 3.2F}, white);
  b.Block({lx + 0.15F, -1.1F, 2.2F}, {lx + 0.22F, 1.1F, 2.28F}, white);
  scene.portals.push_back({{lx + 0.08F, 0, 2.05F}, {0, 1.1F, 0}, {0, 0, 1.15F}, {-1, 0, 0}});
  b.Block({-lx - thick, -ly - thick, 0}, {-lx, -0.8F, lz}, brick);
  b.Block({-lx - thick, 0.8F, 0}, {-lx, ly + thick, lz}, brick);
  b.Block({-lx - thick, -0.8F, 1.3F}, {-lx, 0.8F, lz}, brick);
  b.Block({-lx - 1.2F, -1.0F, 0}, {-lx - 1.0F, 1.0F, 1.6F}, soot);
  b.Block({-lx - 1.0F, -1.0F, 0}, {-lx - thick + 0.02F, -0.8F, 1.6F}, soot);
  b.Block({-lx - 1.0F, 0.8F, 0}, {-lx - thick + 0.02F, 1.0F, 1.6F}, soot);
  b.Block({-lx - 1.0F, -0.8F, 1.3F}, {-lx - thick, 0.8F, 1.6F}, soot);
  b.Block({-lx - 1.2F, -1.0F, -0.2F}, {-lx, 1.0F, 0.012F}, soot);
  b.Block({-lx, -1.3F, 1.35F}, {-lx + 0.25F, 1.3F, 1.45F}, oak);
  for (int i = 0; i < 5; ++i) {
    const float y = -1.1F + 0.5F * static_cast<float>(i) + b.random.Range(-0.1F, 0.1F);
    b.Pole(-lx + 0.12F, y, 1.45F, b.random.Range(0.04F, 0.09F), b.random.Range(0.15F, 0.4F),
           i % 2 == 0 ? pot : metal);
  }
  // Beams, columns, lamps.
  for (int i = 0; i < 7; ++i) {
    const float x = -7.5F + 2.5F * static_cast<float>(i);
    b.Block({x - 0.12F, -ly, lz - 0.3F}, {x + 0.12F, ly, lz}, oak);
  }
  for (const float x : {-6.9F, -2.4F, 2.4F, 6.9F}) {
    for (const float y : {-4.1F, 4.1F}) {
      if (!b.OffPath(x, y, 0.25F)) continue;
      b.Standing(x, y, 0.0F, {0.6F, 0.6F, 0.25F}, stone);
      b.Pole(x, y, 0.25F, 0.2F, lz - 0.5F, stone);
      b.Standing(x, y, lz - 0.25F, {0.6F, 0.6F, 0.25F}, stone);
    }
  }
  for (int i = 0; i < 4; ++i) {
    for (const float y : {-2.7F, 0.4F}) {
      const float x = -6.3F + 4.2F * static_cast<float>(i) + b.random.Range(-0.2F, 0.2F);
      const Vec3 warm = Vec3{15000, 12000, 7800} * b.random.Range(0.7F, 1.2F);
      b.Pole(x, y, 3.3F, 0.015F, lz - 3.3F, metal);
      b.Globe({x, y, 3.15F}, 0.19F, warm, white);
    }
  }
  // Furniture. Along the -Y wall.
  for (int i = 0; i < 3; ++i) {
    const float x = -4.2F + 2.6F * static_cast<float>(i);
    b.Block({x - 1.0F, -ly, 0.0F}, {x + 1.0F, -ly + 0.36F, 2.25F}, i == 1 ? oak : books);
    if (i == 1) {
      b.Panel({x, -ly + 0.365F, 1.6F}, {0, 1, 0}, 1.5F, 1.0F, picture);
      b.Standing(x, -ly + 0.5F, 0.0F, {1.4F, 0.3F, 0.5F}, dark_wood);
    }
  }
  b.Panel({3.6F, -ly + 0.02F, 2.0F}, {0, 1, 0}, 1.4F, 1.0F, picture2);
  b.Panel({7.4F, -ly + 0.02F, 1.9F}, {0, 1, 0}, 1.8F, 1.2F, picture);
  b.Panel({-lx + 0.02F, 3.0F, 2.2F}, {1, 0, 0}, 1.5F, 1.1F, picture2);
  b.Panel({-lx + 0.02F, -3.0F, 2.2F}, {1, 0, 0}, 1.2F, 1.5F, picture);
  b.Panel({lx - 0.02F, 3.1F, 2.0F}, {-1, 0, 0}, 1.3F, 0.9F, picture);
  b.Panel({lx - 0.02F, -3.2F, 2.1F}, {-1, 0, 0}, 1.6F, 1.2F, picture2);
  // Rugs lie under the path; they are flat.
  b.Standing(0.0F, 0.0F, 0.0F, {5.2F, 2.6F, 0.012F}, rug);
  b.Standing(-5.8F, 2.2F, 0.0F, {2.4F, 1.7F, 0.012F}, rug2, 0.2F);
  b.Standing(5.9F, -1.9F, 0.0F, {2.2F, 1.6F, 0.012F}, rug2, -0.15F);
  const auto table = [&](float x, float y, float w, float d, float h, float yaw) {
    b.Standing(x, y, h - 0.05F, {w, d, 0.05F}, oak, yaw);
    const float c = std::cos(yaw);
    const float s = std::sin(yaw);
    for (const float sx : {-1.0F, 1.0F}) {
      for (const float sy : {-1.0F, 1.0F}) {
        const float px = sx * (w / 2 - 0.07F);
        const float py = sy * (d / 2 - 0.07F);
        b.Pole(x + c * px - s * py, y + s * px + c * py, 0.0F, 0.035F, h - 0.05F, dark_wood);
      }
    }
    for (int i = 0; i < 3; ++i) {
      b.Pole(x + c * b.random.Range(-w / 3, w / 3), y + s * b.random.Range(-w / 3, w / 3), h,
             b.random.Range(0.03F, 0.08F), b.random.Range(0.08F, 0.3F), i == 0 ? white : pot);
    }
  };
  const auto sofa_at = [&](float x, float y, float yaw) {
    const float c = std::cos(yaw);
    const float s = std::sin(yaw);
    const auto part = [&](float px, float py, float z, Vec3 size) {
      b.Standing(x + c * px - s * py, y + s * px + c * py, z, size, sofa, yaw);
    };
    part(0, 0, 0.12F, {1.9F, 0.85F, 0.3F});
    part(0, -0.36F, 0.42F, {1.9F, 0.16F, 0.42F});
    part(-0.88F, 0, 0.42F, {0.16F, 0.85F, 0.2F});
    part(0.88F, 0, 0.42F, {0.16F, 0.85F, 0.2F});
  };
  const auto chair = [&](float x, float y, float yaw) {
    const float c = std::cos(yaw);
    const float s = std::sin(yaw);
    b.Standing(x, y, 0.42F, {0.45F, 0.45F, 0.05F}, oak, yaw);
    b.Standing(x - s * 0.21F * -1, y - c * 0.21F, 0.47F, {0.45F, 0.04F, 0.5F}, oak, yaw);
    for (const float sx : {-0.19F, 0.19F}) {
      for (const float sy : {-0.19F, 0.19F}) {
        b.Pole(x + c * sx - s * sy, y + s * sx + c * sy, 0.0F, 0.022F, 0.42F, dark_wood);
      }
    }
  };
  // A black grand piano and a black cabinet.
  b.Standing(-5.0F, 0.1F, 0.62F, {1.5F, 1.4F, 0.36F}, lacquer, 0.3F);
  b.Standing(-5.0F, 0.95F, 0.0F, {0.9F, 0.35F, 0.48F}, lacquer, 0.3F);
  for (const Vec3 leg : {Vec3{-5.4F, -0.4F, 0}, Vec3{-4.6F, -0.3F, 0}, Vec3{-5.0F, 0.55F, 0}}) {
    b.Pole(leg.x, leg.y, 0.0F, 0.06F, 0.62F, lacquer);
  }
  b.Standing(4.3F, -0.1F, 0.0F, {0.5F, 1.2F, 1.0F}, lacquer, -0.2F);
  table(b.random.Range(-0.3F, 0.3F), 0.0F, 2.2F, 0.9F, 0.75F, b.random.Range(-0.1F, 0.1F));
  sofa_at(-2.6F, 0.1F, -kPi / 2 + b.random.Range(-0.2F, 0.2F));
  sofa_at(2.8F, -0.1F, kPi / 2 + b.random.Range(-0.2F, 0.2F));
  for (int i = 0; i < 14; ++i) {
    const float x = b.random.Range(-lx + 0.9F, lx - 0.9F);
    const float y = (i % 2 == 0 ? 1.0F : -1.0F) * b.random.Range(3.6F, ly - 0.75F);
    const float yaw = b.random.Range(0.0F, 2 * kPi);
    if (!b.OffPath(x, y, 0.6F)) continue;
    switch (i % 4) {
      case 0:
        chair(x, y, yaw);
        break;
      case 1:
        b.Pole(x, y, 0.0F, 0.2F, 0.4F, pot);
        for (int leaf = 0; leaf < 6; ++leaf) {
          b.Ball({x + b.random.Range(-0.25F, 0.25F), y + b.random.Range(-0.25F, 0.25F),
                  b.random.Range(0.6F, 1.3F)},
                 b.random.Range(0.12F, 0.26F),
                 leaf % 2 == 0 ? outdoor.leaves : outdoor.dark_leaves);
        }
        break;
      case 2:
        table(x, y, 0.7F, 0.7F, 0.6F, yaw);
        break;
      default:
        b.Standing(x, y, 0.0F, {0.5F, 0.4F, b.random.Range(0.5F, 1.0F)}, dark_wood, yaw);
        break;
    }
  }
  ScaleLight(scene, 2.8F);
  return scene;
}

}  // namespace omnihdr::sim
