#include "drivers/sim/scene.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace omnihdr::sim {
namespace {

constexpr double kStep = 0.01;
constexpr float kPi = std::numbers::pi_v<float>;

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
      const float angle = random.Range(0.0F, 2 * kPi);
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
Path Oval(double length, double squash) {
  const auto curvature = [=](double s) {
    return 2 * std::numbers::pi / length *
           (1.0 - squash * std::cos(4 * std::numbers::pi * s / length));
  };
  // Half-turn symmetry: the centre is half-way between a point and the one half the length on.
  const Path trial({0, 0, 0}, length, true, curvature);
  const Path::Point opposite = trial.At(length / 2);
  return {{-opposite.x / 2, -opposite.y / 2, 0.0}, length, true, curvature};
}

// Along +X with a slow weave of the given amplitude (metres) and wave length.
Path Weave(double start_x, double start_y, double length, double amplitude, double wave) {
  const double k = 2 * std::numbers::pi / wave;
  const auto curvature = [=](double s) { return -amplitude * k * k * std::sin(k * s); };
  return {{start_x, start_y, std::atan(amplitude * k)}, length, false, curvature};
}

Vec3 Direction(float azimuth_deg, float elevation_deg) {
  const float a = azimuth_deg * kPi / 180.0F;
  const float e = elevation_deg * kPi / 180.0F;
  return {std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e)};
}

struct OutdoorMaterials {
  int grass;
  int bark;
  int leaves;
  int dark_leaves;
};

OutdoorMaterials AddOutdoorMaterials(Builder& b) {
  return {b.Mat(Pattern::kGrass, {0.10F, 0.20F, 0.04F}, {0.22F, 0.24F, 0.09F}),
          b.Mat(Pattern::kBark, {0.16F, 0.11F, 0.07F}),
          b.Mat(Pattern::kFoliage, {0.05F, 0.14F, 0.025F}, {0.20F, 0.32F, 0.07F}),
          b.Mat(Pattern::kFoliage, {0.025F, 0.08F, 0.02F}, {0.12F, 0.20F, 0.05F})};
}

// A house with windows and a gabled roof; `front` tells which side (±Y) has the door.
void House(Builder& b, float x, float y, Vec3 size, float yaw, int wall, int roof, int glass,
           int frame) {
  b.Standing(x, y, 0.0F, size, wall, yaw).texel = 0.3F;
  const float c = std::cos(yaw);
  const float s = std::sin(yaw);
  const auto at = [&](float lx, float ly, float z) {
    return Vec3{x + c * lx - s * ly, y + s * lx + c * ly, z};
  };
  // Two slanted slabs.
  const float pitch = 0.62F;
  const float run = size.y * 0.5F + 0.5F;
  const float slope = run / std::cos(pitch);
  for (const float side : {-1.0F, 1.0F}) {
    Primitive& slab = b.Add(
        Shape::kBox, at(0.0F, side * run * 0.5F, size.z + run * 0.5F * std::tan(pitch) - 0.25F),
        {size.x * 0.5F + 0.4F, slope * 0.5F, 0.09F}, roof, yaw);
    const Vec3 across = slab.axis_y;
    slab.axis_y = across * std::cos(pitch) - Vec3{0, 0, side * std::sin(pitch)};
    slab.axis_z = Cross(slab.axis_x, slab.axis_y);
    slab.texel = 0.3F;
  }
  const int columns = std::max(1, static_cast<int>(size.x / 2.4F));
  const int floors = std::max(1, static_cast<int>(size.z / 2.7F));
  for (int side = 0; side < 2; ++side) {
    const float ly = (side == 0 ? -1.0F : 1.0F) * (size.y * 0.5F + 0.02F);
    for (int floor = 0; floor < floors; ++floor) {
      for (int column = 0; column < columns; ++column) {
        const float lx =
            size.x * ((static_cast<float>(column) + 0.5F) / static_cast<float>(columns) - 0.5F);
        const float z = 1.7F + 2.7F * static_cast<float>(floor);
        b.Add(Shape::kBox, at(lx, ly, z), {0.55F, 0.03F, 0.72F}, frame, yaw);
        b.Add(Shape::kBox, at(lx, ly * 1.004F, z), {0.46F, 0.03F, 0.62F}, glass, yaw);
      }
    }
  }
}

// A garage open towards +Y, black inside: the dark corner of a bright scene.
void Garage(Builder& b, float gx, float gy, int black, int planks) {
  b.Block({gx - 2.4F, gy - 5.4F, 0}, {gx + 2.4F, gy - 5.2F, 2.7F}, black);
  b.Block({gx - 2.4F, gy - 5.4F, 0}, {gx - 2.2F, gy, 2.7F}, black);
  b.Block({gx + 2.2F, gy - 5.4F, 0}, {gx + 2.4F, gy, 2.7F}, black);
  b.Block({gx - 2.8F, gy - 5.8F, 2.6F}, {gx + 2.8F, gy + 0.5F, 2.8F}, black);
  b.Block({gx - 2.2F, gy - 5.2F, -0.1F}, {gx + 2.2F, gy, 0.015F}, black);
  b.Block({gx - 2.65F, gy - 5.6F, 0}, {gx - 2.4F, gy + 0.1F, 2.7F}, planks);
  b.Block({gx + 2.4F, gy - 5.6F, 0}, {gx + 2.65F, gy + 0.1F, 2.7F}, planks);
  b.Block({gx - 2.4F, gy - 0.15F, 2.2F}, {gx + 2.4F, gy + 0.05F, 2.6F}, planks);
  b.Standing(gx - 1.2F, gy - 4.4F, 0.0F, {1.2F, 0.7F, 1.1F}, black);
}

// Multiplies every source of light: puts a scene's tones where exposures of 1 to 16 ms see them.
void ScaleLight(Scene& scene, float factor) {
  Sky& sky = scene.sky;
  for (Vec3* light :
       {&sky.zenith, &sky.horizon, &sky.below, &sky.cloud, &sky.sun_irradiance, &sky.glow}) {
    *light = *light * factor;
  }
  for (Primitive& p : scene.primitives) p.emission = p.emission * factor;
  for (AreaLight& light : scene.lights) light.radiance = light.radiance * factor;
}

}  // namespace

Path::Path(Point start, double length, bool closed,
           const std::function<double(double s)>& curvature)
    : length_(length), closed_(closed) {
  const auto count = static_cast<std::size_t>(std::lround(length / kStep)) + 1;
  points_.reserve(count);
  Point at = start;
  for (std::size_t i = 0; i < count; ++i) {
    points_.push_back(at);
    const double s = (static_cast<double>(i) + 0.5) * kStep;
    const double turn = curvature(s) * kStep;
    at.x += kStep * std::cos(at.heading + turn / 2);
    at.y += kStep * std::sin(at.heading + turn / 2);
    at.heading += turn;
  }
}

Path::Point Path::At(double s) const {
  if (points_.size() < 2) return {};
  double turns = 0.0;
  if (closed_) {
    turns = std::floor(s / length_);
    s -= turns * length_;
  } else {
    s = std::fmod(std::abs(s), 2 * length_);
    if (s > length_) s = 2 * length_ - s;
  }
  const double index = std::clamp(s / kStep, 0.0, static_cast<double>(points_.size() - 1));
  const auto i = std::min(static_cast<std::size_t>(index), points_.size() - 2);
  const double f = index - static_cast<double>(i);
  const Point& a = points_[i];
  const Point& b = points_[i + 1];
  const double full_turn = points_.back().heading - points_.front().heading;
  return {a.x + f * (b.x - a.x), a.y + f * (b.y - a.y),
          a.heading + f * (b.heading - a.heading) + turns * full_turn};
}

double Path::DistanceFrom(double x, double y) const {
  double nearest = 1e30;
  for (std::size_t i = 0; i < points_.size(); i += 10) {
    const double dx = points_[i].x - x;
    const double dy = points_[i].y - y;
    nearest = std::min(nearest, dx * dx + dy * dy);
  }
  return std::sqrt(nearest);
}

Vec3 Sky::Radiance(Vec3 d, bool with_disc) const {
  if (d.z < 0.0F) {
    return Lerp(horizon * 0.6F, below, std::min(1.0F, -d.z * 12.0F));
  }
  const float up = std::pow(d.z, 0.55F);
  Vec3 radiance = Lerp(horizon, zenith, up);
  // Clouds on a plane above, fading into the haze.
  const float height = d.z + 0.12F;
  SurfacePoint at;
  at.u = d.x / height;
  at.v = d.y / height;
  float cover = 0.0F;
  float amplitude = 1.0F;
  float frequency = 1.1F;
  for (std::uint32_t octave = 0; octave < 5; ++octave) {
    cover += amplitude * ValueNoise(at.u * frequency, at.v * frequency, seed + octave * 131U);
    amplitude *= 0.55F;
    frequency *= 2.1F;
  }
  const float density = std::clamp((cover + 2.0F * cloudiness - 1.0F) * 1.1F, 0.0F, 1.0F) *
                        std::min(1.0F, d.z * 7.0F);
  const float towards_sun = Dot(d, sun_direction);
  const float silver = 1.0F + 1.2F * std::pow(std::max(0.0F, towards_sun), 6.0F);
  radiance = Lerp(radiance, cloud * silver, 0.85F * density);
  const float angle = std::acos(std::clamp(towards_sun, -1.0F, 1.0F));
  const float wide = 0.006F * std::exp(-angle / 0.35F);
  const float close = 1.0F / (1.0F + 350.0F * angle * angle);
  radiance += glow * (wide + close * close);
  if (with_disc && angle < disc_radius) {
    radiance += sun_irradiance * (1.0F / (kPi * disc_radius * disc_radius));
  }
  return radiance;
}

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
