#include "drivers/sim/movers.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <optional>

#include "drivers/sim/shading.h"

namespace omnihdr::sim {
namespace {

constexpr float kPi = std::numbers::pi_v<float>;
constexpr double kOffPath = 0.9;     // metres between a walk and the vehicle's path
constexpr float kElbowRoom = 0.32F;  // clearance of a walk's middle line
constexpr int kTries = 600;
constexpr int kPlacesOfWalk = 11;  // at which a walk is looked at

// The ground below a point at breast height.
std::optional<float> GroundBelow(const Geometry& geometry, float x, float y) {
  const Hit hit = geometry.Intersect({x, y, 1.0F}, {0, 0, -1});
  if (!hit.valid() || hit.t > 1.5F) return std::nullopt;
  return 1.0F - hit.t;
}

// The least clearance along a walk; less than 0 where it cannot be walked at all.
float RoomAlong(const Scene& scene, const Geometry& geometry, Walk* walk) {
  float room = 1e9F;
  std::optional<float> level;
  for (int k = 0; k < kPlacesOfWalk; ++k) {
    const float share = static_cast<float>(k) / (kPlacesOfWalk - 1);
    const Vec3 at = Lerp(walk->from, walk->to, share);
    if (scene.path.DistanceFrom(at.x, at.y) < kOffPath) return -1.0F;
    const std::optional<float> ground = GroundBelow(geometry, at.x, at.y);
    if (!ground) return -1.0F;
    if (!level) level = ground;
    if (std::abs(*ground - *level) > 0.05F) return -1.0F;
    for (const float height : {0.4F, 0.9F, 1.5F}) {
      room = std::min(room, geometry.Clearance({at.x, at.y, *ground + height}));
    }
  }
  walk->from.z = walk->to.z = *level;
  return room;
}

// Where somebody is who has walked so far.
Vec3 PlaceOn(const Walk& walk, double walked_m) {
  const double length = std::max(0.01, static_cast<double>(Length(walk.to - walk.from)));
  double way = std::fmod(std::abs(walked_m + static_cast<double>(walk.start)), 2 * length);
  if (way > length) way = 2 * length - way;
  return Lerp(walk.from, walk.to, static_cast<float>(way / length));
}

}  // namespace

Status MoverOptions::Validate() const {
  if (count < 0 || count > 16) {
    return Fail(ErrorKind::kConfig, "movers: {}: expected 0 to 16", count);
  }
  if (!(speed >= 0.0 && speed <= 100.0)) {
    return Fail(ErrorKind::kConfig, "mover_speed: {}: expected 0 to 100", speed);
  }
  return {};
}

std::vector<Walk> PlanWalks(const Scene& scene, const Geometry& geometry,
                            const MoverOptions& options, std::uint64_t seed, double start_m) {
  std::vector<Walk> walks;
  for (int i = 0; i < options.count; ++i) {
    Random random(seed * 977 + static_cast<std::uint64_t>(i) * 7919 + 4241);
    Walk best;
    float most_room = -1.0F;
    for (int attempt = 0; attempt < kTries && most_room < kElbowRoom; ++attempt) {
      const Path::Point on_path =
          scene.path.At(start_m + static_cast<double>(random.Range(-0.5F, 3.5F)));
      const auto heading = static_cast<float>(on_path.heading);
      const float aside = random.Range(1.3F, 3.2F) * (random.Index(2) == 0 ? 1.0F : -1.0F);
      const Vec3 middle{static_cast<float>(on_path.x) - aside * std::sin(heading),
                        static_cast<float>(on_path.y) + aside * std::cos(heading), 0.0F};
      const float angle = random.Range(0.0F, 2 * kPi);
      const float half = random.Range(0.8F, 2.0F);
      const Vec3 along{half * std::cos(angle), half * std::sin(angle), 0.0F};
      Walk walk{middle - along, middle + along, random.Range(0.0F, 4 * half)};
      const float room = RoomAlong(scene, geometry, &walk);
      if (room <= most_room) continue;
      best = walk;
      most_room = room;
    }
    if (most_room >= 0.0F) walks.push_back(best);
  }
  return walks;
}

MoverGroup::MoverGroup(const Scene& scene, const Geometry& geometry, const BakedLight& light,
                       const std::vector<Walk>& walks, double walked_m, std::uint64_t seed) {
  if (walks.empty()) return;
  std::vector<Primitive> primitives;
  for (std::size_t i = 0; i < walks.size(); ++i) {
    Random random(seed * 131 + i * 104729 + 77);
    const Vec3 feet = PlaceOn(walks[i], walked_m);
    const Hit ground = geometry.Intersect(feet + Vec3{0, 0, 1.0F}, {0, 0, -1});
    const bool indoor =
        ground.valid() && geometry.primitives()[static_cast<std::size_t>(ground.primitive)].indoor;
    const float size = random.Range(0.93F, 1.05F);
    const auto material = [&](Pattern pattern, Vec3 colour, Vec3 second, float period) {
      materials_.push_back({pattern, colour, second, period, 1.0F});
      return static_cast<int>(materials_.size()) - 1;
    };
    const auto colour = [&](float least, float most) {
      return Vec3{random.Range(least, most), random.Range(least, most), random.Range(least, most)};
    };
    const int trousers = material(Pattern::kPlaster, colour(0.03F, 0.25F), {}, 0.2F);
    const bool is_striped = random.Index(2) == 0;
    const int shirt = material(is_striped ? Pattern::kTiles : Pattern::kCarpet, colour(0.08F, 0.8F),
                               colour(0.05F, 0.6F), 0.09F);
    const int skin =
        material(Pattern::kPlaster, Vec3{0.55F, 0.38F, 0.30F} * random.Range(0.4F, 1.2F), {}, 0.2F);
    const auto add = [&](Shape shape, float bottom, float top, float radius, int of) {
      Primitive p;
      p.shape = shape;
      p.centre = feet + Vec3{0, 0, 0.5F * (bottom + top) * size};
      p.half = Vec3{radius, radius, 0.5F * (top - bottom)} * size;
      p.material = of;
      p.indoor = indoor;
      p.texel = 0.12F;
      primitives.push_back(p);
    };
    add(Shape::kCylinder, 0.0F, 0.85F, 0.17F, trousers);
    add(Shape::kCylinder, 0.85F, 1.48F, 0.25F, shirt);
    add(Shape::kSphere, 1.45F, 1.75F, 0.14F, skin);
    balls_.push_back({feet + Vec3{0, 0, 0.88F * size}, 0.95F * size});
  }
  geometry_ = Geometry(std::move(primitives));
  light_ = BakedLight(scene, geometry, light, geometry_);
}

bool MoverGroup::MayMeet(Vec3 origin, Vec3 direction, float margin) const {
  return std::any_of(balls_.begin(), balls_.end(), [&](const Ball& ball) {
    const Vec3 to = ball.centre - origin;
    const float along = Dot(to, direction);
    const float reach = ball.radius + margin * Length(to);
    return along > -reach && Dot(to, to) - along * along < reach * reach;
  });
}

Vec3 MoverGroup::Radiance(Vec3 direction, float pixel, const Hit& hit) const {
  return Shade(materials_, geometry_, light_, direction, pixel, hit);
}

}  // namespace omnihdr::sim
