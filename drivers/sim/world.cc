#include "drivers/sim/world.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <mutex>
#include <numbers>
#include <utility>
#include <vector>

#include "core/base/parallel_for.h"
#include "drivers/sim/geometry.h"
#include "drivers/sim/lighting.h"
#include "drivers/sim/material.h"
#include "drivers/sim/movers.h"
#include "drivers/sim/scene.h"
#include "drivers/sim/shading.h"

namespace omnihdr::sim {
namespace {

constexpr std::array<std::pair<SceneKind, std::string_view>, 4> kSceneNames{{
    {SceneKind::kHall, "hall"},
    {SceneKind::kYard, "yard"},
    {SceneKind::kTunnel, "tunnel"},
    {SceneKind::kStreet, "street"},
}};

Scene Build(SceneKind kind, std::uint64_t seed) {
  switch (kind) {
    case SceneKind::kYard:
      return BuildYard(seed);
    case SceneKind::kTunnel:
      return BuildTunnel(seed);
    case SceneKind::kStreet:
      return BuildStreet(seed);
    case SceneKind::kHall:
      break;
  }
  return BuildHall(seed);
}

Vec3 ToVec3(const Eigen::Vector3d& v) {
  return {static_cast<float>(v.x()), static_cast<float>(v.y()), static_cast<float>(v.z())};
}

}  // namespace

std::string_view ToString(SceneKind kind) {
  for (const auto& [value, name] : kSceneNames) {
    if (value == kind) return name;
  }
  return "hall";
}

std::optional<SceneKind> SceneKindFromString(std::string_view name) {
  for (const auto& [value, known] : kSceneNames) {
    if (known == name) return value;
  }
  return std::nullopt;
}

Status MotionOptions::Validate() const {
  if (!(std::abs(yaw_deg_per_m) <= 720.0)) {
    return Fail(ErrorKind::kConfig, "yaw_deg_per_m: {}: expected -720 to 720", yaw_deg_per_m);
  }
  if (!(sway_deg >= 0.0 && sway_deg <= 10.0)) {
    return Fail(ErrorKind::kConfig, "sway_deg: {}: expected 0 to 10", sway_deg);
  }
  return {};
}

struct World::Impl {
  Scene scene;
  Geometry geometry;
  mutable std::once_flag light_once;
  mutable BakedLight light;  // valid after light_once
  std::array<double, 8> sway_phase{};

  // Radiance along a ray; `pixel` is the angle between neighbouring samples, radians.
  Vec3 Trace(Vec3 direction, float pixel, const Hit& hit) const {
    if (!hit.valid()) return scene.sky.Radiance(direction);
    return Shade(scene.materials, geometry, light, direction, pixel, hit);
  }

  // Draws movers over a finished view. `ray_at(x, y, u, v)`: the unit ray through a point of a
  // pixel; `angle_at(x, y)`: the angle one of its side × side samples stands for. A pixel they do
  // not touch keeps its bits.
  template <typename RayAt, typename AngleAt>
  void AddMovers(const MoverGroup& movers, Vec3 origin, int side, const RayAt& ray_at,
                 const AngleAt& angle_at, RenderedView* view) const {
    const int width = view->radiance.width();
    const int height = view->radiance.height();
    view->background = view->radiance.Clone();
    view->background_distance = view->distance.Clone();
    view->movers = Image<float>(width, height);
    const auto step = 1.0F / static_cast<float>(side);
    ParallelFor(height, 16, [&](int begin, int end) {
      for (int y = begin; y < end; ++y) {
        for (int x = 0; x < width; ++x) {
          const float behind = view->background_distance.at(x, y);
          if (std::isnan(behind)) continue;
          const Vec3 centre = ray_at(x, y, 0.5F, 0.5F);
          const float angle = angle_at(x, y);
          if (!movers.MayMeet(origin, centre, 2.0F * angle * static_cast<float>(side))) continue;
          int covered = 0;
          Vec3 sum;
          for (int k = 0; k < side * side; ++k) {
            const int column = k % side;
            const int row = k / side;
            const auto u = (static_cast<float>(column) + 0.5F) * step;
            const auto v = (static_cast<float>(row) + 0.5F) * step;
            const Vec3 direction = ray_at(x, y, u, v);
            const Hit hit = geometry.Intersect(origin, direction);
            const Hit mover = movers.Intersect(origin, direction, hit.t);
            covered += mover.valid() ? 1 : 0;
            sum += mover.valid() ? movers.Radiance(direction, angle, mover)
                                 : Trace(direction, angle, hit);
          }
          const Hit nearest = movers.Intersect(origin, centre, behind);
          if (nearest.valid()) view->distance.at(x, y) = nearest.t;
          if (covered == 0) continue;
          view->movers.at(x, y) = static_cast<float>(covered) * step * step;
          float* out = view->radiance.pixel(x, y);
          out[0] = sum.x * step * step;
          out[1] = sum.y * step * step;
          out[2] = sum.z * step * step;
        }
      }
    });
  }
};

World::World(SceneKind scene, std::uint64_t seed)
    : scene_(scene), seed_(seed), impl_(std::make_unique<Impl>()) {
  impl_->scene = Build(scene, seed);
  impl_->geometry = Geometry(std::move(impl_->scene.primitives));
  Random random(seed * 131 + 17);
  for (double& phase : impl_->sway_phase) phase = 2 * std::numbers::pi * random.Unit();
}

World::~World() = default;

void World::PrepareLight() const {
  std::call_once(impl_->light_once,
                 [this] { impl_->light = BakedLight(impl_->scene, impl_->geometry); });
}

std::shared_ptr<const World> World::Create(SceneKind scene, std::uint64_t seed) {
  return std::shared_ptr<const World>(new World(scene, seed));
}

std::vector<Walk> World::PlanWalks(const MoverOptions& options, double start_m) const {
  return sim::PlanWalks(impl_->scene, impl_->geometry, options, seed_, start_m);
}

MoverGroup World::MoversAt(const std::vector<Walk>& walks, double walked_m) const {
  if (walks.empty()) return {};
  PrepareLight();
  return {impl_->scene, impl_->geometry, impl_->light, walks, walked_m, seed_};
}

RenderedView World::Render(const Pose& world_from_camera, const Projection& projection, int samples,
                           const MoverGroup* movers) const {
  PrepareLight();
  const int width = projection.width();
  const int height = projection.height();
  const int side = std::clamp(static_cast<int>(std::sqrt(static_cast<double>(samples))), 1, 8);
  RenderedView view{Image<float>(width, height, 3), Image<float>(width, height, 1)};
  const Eigen::Matrix3d rotation = world_from_camera.rotation.toRotationMatrix();
  const Vec3 origin = ToVec3(world_from_camera.translation);
  const float inverse_samples = 1.0F / static_cast<float>(side * side);
  const Impl& impl = *impl_;

  // A ray is separable in both projections: the sines and cosines of columns, once.
  const int fine_width = width * side;
  std::vector<std::pair<float, float>> column_direction(static_cast<std::size_t>(fine_width));
  std::vector<std::pair<float, float>> centre_direction(static_cast<std::size_t>(width));
  const auto direction_of_column = [&](double x) {
    const double theta = std::numbers::pi - 2 * std::numbers::pi * x / width;
    return std::pair{static_cast<float>(std::cos(theta)), static_cast<float>(std::sin(theta))};
  };
  for (int i = 0; i < fine_width; ++i) {
    column_direction[static_cast<std::size_t>(i)] = direction_of_column((i + 0.5) / side);
  }
  for (int i = 0; i < width; ++i) {
    centre_direction[static_cast<std::size_t>(i)] = direction_of_column(i + 0.5);
  }
  const Vec3 axis_x = ToVec3(rotation.col(0));
  const Vec3 axis_y = ToVec3(rotation.col(1));
  const Vec3 axis_z = ToVec3(rotation.col(2));
  // Radius in the horizontal plane and height of the unit ray of a row.
  const auto row_of = [&](double y) {
    const Eigen::Vector3d ray = projection.RayFromPixel(0.5 * width, y);
    return std::pair{static_cast<float>(std::hypot(ray.x(), ray.y())), static_cast<float>(ray.z())};
  };
  const auto towards = [&](std::pair<float, float> row, std::pair<float, float> column) {
    return axis_x * (row.first * column.first) + axis_y * (row.first * column.second) +
           axis_z * row.second;
  };

  ParallelFor(height, 16, [&](int begin, int end) {
    // Centre hits of these rows and the ones next to them.
    const int first_row = std::max(0, begin - 1);
    const int last_row = std::min(height, end + 1);
    std::vector<Hit> hits(static_cast<std::size_t>(last_row - first_row) *
                          static_cast<std::size_t>(width));
    const auto hit_at = [&](int x, int y) -> Hit& {
      return hits[static_cast<std::size_t>(y - first_row) * static_cast<std::size_t>(width) +
                  static_cast<std::size_t>((x + width) % width)];
    };
    for (int y = first_row; y < last_row; ++y) {
      const auto row = row_of(y + 0.5);
      for (int x = 0; x < width; ++x) {
        hit_at(x, y) = impl.geometry.Intersect(
            origin, towards(row, centre_direction[static_cast<std::size_t>(x)]));
      }
    }
    for (int y = begin; y < end; ++y) {
      std::array<std::pair<float, float>, 8> fine_rows{};
      for (int i = 0; i < side; ++i) {
        fine_rows[static_cast<std::size_t>(i)] = row_of(y + (i + 0.5) / side);
      }
      // Angle a sample stands for: the geometric mean of the pixel's sides.
      const float pixel =
          static_cast<float>(std::sqrt(std::max(1e-12, projection.PixelSolidAngle(y)))) /
          static_cast<float>(side);
      float* radiance = view.radiance.row(y);
      float* distance = view.distance.row(y);
      for (int x = 0; x < width; ++x) {
        const Hit& centre = hit_at(x, y);
        distance[x] = centre.valid() ? centre.t : std::numeric_limits<float>::infinity();
        const auto same_surface = [&](const Hit& other) {
          return other.primitive == centre.primitive && other.face == centre.face;
        };
        // Where the neighbours see the same face nothing lies between: their rays need no search.
        const bool inside = same_surface(hit_at(x - 1, y)) && same_surface(hit_at(x + 1, y)) &&
                            (y == first_row || same_surface(hit_at(x, y - 1))) &&
                            (y + 1 == last_row || same_surface(hit_at(x, y + 1)));
        Vec3 sum;
        for (int sy = 0; sy < side; ++sy) {
          for (int sx = 0; sx < side; ++sx) {
            const Vec3 direction =
                towards(fine_rows[static_cast<std::size_t>(sy)],
                        column_direction[static_cast<std::size_t>(x * side + sx)]);
            Hit hit;
            if (!inside) {
              hit = impl.geometry.Intersect(origin, direction);
            } else if (centre.valid()) {
              hit = impl.geometry.IntersectOnly(centre.primitive, origin, direction);
              // A round solid's rim, or a rectangle's, may pass between the samples.
              if (!hit.valid()) hit = impl.geometry.Intersect(origin, direction);
            }
            sum += impl.Trace(direction, pixel, hit);
          }
        }
        sum = sum * inverse_samples;
        radiance[3 * x] = sum.x;
        radiance[3 * x + 1] = sum.y;
        radiance[3 * x + 2] = sum.z;
      }
    }
  });
  if (movers != nullptr && !movers->empty()) {
    impl.AddMovers(
        *movers, origin, side,
        [&](int x, int y, float u, float v) {
          return towards(row_of(y + static_cast<double>(v)),
                         direction_of_column(x + static_cast<double>(u)));
        },
        [&](int, int y) {
          return static_cast<float>(std::sqrt(std::max(1e-12, projection.PixelSolidAngle(y)))) /
                 static_cast<float>(side);
        },
        &view);
  }
  return view;
}

RenderedView World::RenderRays(const Pose& world_from_camera, ImageView<const float> corner_rays,
                               int samples, const MoverGroup* movers) const {
  PrepareLight();
  const int width = corner_rays.width() - 1;
  const int height = corner_rays.height() - 1;
  const int side = std::clamp(static_cast<int>(std::sqrt(static_cast<double>(samples))), 1, 8);
  RenderedView view{Image<float>(width, height, 3), Image<float>(width, height, 1)};
  const Eigen::Matrix3d rotation = world_from_camera.rotation.toRotationMatrix();
  const Vec3 axis_x = ToVec3(rotation.col(0));
  const Vec3 axis_y = ToVec3(rotation.col(1));
  const Vec3 axis_z = ToVec3(rotation.col(2));
  const Vec3 origin = ToVec3(world_from_camera.translation);
  const float inverse_samples = 1.0F / static_cast<float>(side * side);
  const Impl& impl = *impl_;
  const auto corner = [&](int x, int y) {
    const float* p = corner_rays.pixel(x, y);
    return Vec3{p[0], p[1], p[2]};
  };
  const auto seen = [&](int x, int y) {
    const Vec3 sum = corner(x, y) + corner(x + 1, y) + corner(x, y + 1) + corner(x + 1, y + 1);
    return std::isfinite(sum.x + sum.y + sum.z);
  };
  // Unit ray, in the world, through a point (u, v) of a pixel.
  const auto towards = [&](int x, int y, float u, float v) {
    const Vec3 d = Lerp(Lerp(corner(x, y), corner(x + 1, y), u),
                        Lerp(corner(x, y + 1), corner(x + 1, y + 1), u), v);
    return Normalised(axis_x * d.x + axis_y * d.y + axis_z * d.z);
  };
  // Angle a sample stands for: the geometric mean of the pixel's sides.
  const auto angle_of = [&](int x, int y) {
    const Vec3 middle = towards(x, y, 0.5F, 0.5F);
    return std::sqrt(Length(Cross(towards(x, y, 1.0F, 0.5F) - middle,
                                  towards(x, y, 0.5F, 1.0F) - middle)) *
                     4.0F) /
           static_cast<float>(side);
  };

  ParallelFor(height, 16, [&](int begin, int end) {
    const int first_row = std::max(0, begin - 1);
    const int last_row = std::min(height, end + 1);
    std::vector<Hit> hits(static_cast<std::size_t>(last_row - first_row) *
                          static_cast<std::size_t>(width));
    const auto hit_at = [&](int x, int y) -> Hit& {
      return hits[static_cast<std::size_t>(y - first_row) * static_cast<std::size_t>(width) +
                  static_cast<std::size_t>(x)];
    };
    for (int y = first_row; y < last_row; ++y) {
      for (int x = 0; x < width; ++x) {
        if (seen(x, y)) {
          hit_at(x, y) = impl.geometry.Intersect(origin, towards(x, y, 0.5F, 0.5F));
        }
      }
    }
    for (int y = begin; y < end; ++y) {
      float* radiance = view.radiance.row(y);
      float* distance = view.distance.row(y);
      for (int x = 0; x < width; ++x) {
        if (!seen(x, y)) {
          distance[x] = std::numeric_limits<float>::quiet_NaN();
          continue;
        }
        const Hit& centre = hit_at(x, y);
        distance[x] = centre.valid() ? centre.t : std::numeric_limits<float>::infinity();
        const auto same_surface = [&](int other_x, int other_y) {
          const Hit& other = hit_at(other_x, other_y);
          return other.primitive == centre.primitive && other.face == centre.face;
        };
        // Where the neighbours see the same face nothing lies between: their rays need no search.
        const bool inside = x > 0 && x + 1 < width && y > first_row && y + 1 < last_row &&
                            same_surface(x - 1, y) && same_surface(x + 1, y) &&
                            same_surface(x, y - 1) && same_surface(x, y + 1);
        const float pixel = angle_of(x, y);
        Vec3 sum;
        for (int sy = 0; sy < side; ++sy) {
          for (int sx = 0; sx < side; ++sx) {
            const Vec3 direction =
                towards(x, y, (static_cast<float>(sx) + 0.5F) / static_cast<float>(side),
                        (static_cast<float>(sy) + 0.5F) / static_cast<float>(side));
            Hit hit;
            if (!inside) {
              hit = impl.geometry.Intersect(origin, direction);
            } else if (centre.valid()) {
              hit = impl.geometry.IntersectOnly(centre.primitive, origin, direction);
              if (!hit.valid()) hit = impl.geometry.Intersect(origin, direction);
            }
            sum += impl.Trace(direction, pixel, hit);
          }
        }
        sum = sum * inverse_samples;
        radiance[3 * x] = sum.x;
        radiance[3 * x + 1] = sum.y;
        radiance[3 * x + 2] = sum.z;
      }
    }
  });
  if (movers != nullptr && !movers->empty())
    impl.AddMovers(*movers, origin, side, towards, angle_of, &view);
  return view;
}

Pose World::PoseAt(double distance_m, const MotionOptions& motion) const {
  const Path::Point at = impl_->scene.path.At(distance_m);
  const auto& phase = impl_->sway_phase;
  const auto wave = [&](std::size_t index, double length) {
    return std::sin(2 * std::numbers::pi * distance_m / length + phase[index]);
  };
  const double sway = motion.sway_deg * std::numbers::pi / 180.0;
  const double pitch = sway * (0.6 * wave(0, 5.3) + 0.4 * wave(1, 2.1));
  const double roll = sway * (0.6 * wave(2, 6.7) + 0.4 * wave(3, 2.9));
  const double yaw = at.heading + motion.yaw_deg_per_m * distance_m * std::numbers::pi / 180.0;
  Pose pose;
  pose.rotation = (Eigen::AngleAxisd(yaw, Eigen::Vector3d::UnitZ()) *
                   Eigen::AngleAxisd(pitch, Eigen::Vector3d::UnitY()) *
                   Eigen::AngleAxisd(roll, Eigen::Vector3d::UnitX()))
                      .normalized();
  pose.translation = {at.x, at.y,
                      impl_->scene.camera_height + 0.015 * wave(4, 3.7) + 0.01 * wave(5, 1.9)};
  return pose;
}

bool World::IsClear(const Eigen::Vector3d& place, const Eigen::Vector3d& surface) const {
  const Eigen::Vector3d towards = surface - place;
  const double length = towards.norm();
  // Short of the surface itself, which is seen at a slant.
  const double reach = 0.995 * length - 0.01;
  return !(reach > 0.0) || !impl_->geometry.Occluded(ToVec3(place), ToVec3(towards / length),
                                                     static_cast<float>(reach));
}

double World::Clearance(const Eigen::Vector3d& point_in_world) const {
  return impl_->geometry.Clearance(ToVec3(point_in_world));
}

}  // namespace omnihdr::sim
