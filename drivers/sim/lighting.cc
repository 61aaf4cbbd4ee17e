#include "drivers/sim/lighting.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

#include "core/base/parallel_for.h"

namespace omnihdr::sim {
namespace {

constexpr float kPi = std::numbers::pi_v<float>;
constexpr float kLift = 2e-3F;  // metres off the surface, so that a ray does not meet its own start
constexpr int kSunSamples = 3;
constexpr int kLightSamples = 2;
constexpr int kPortalSamples = 4;
constexpr int kGatherRays = 32;
constexpr float kLeast = 0.02F;    // irradiance in the darkest corner: nothing is truly black
constexpr float kFaintest = 4.0F;  // irradiance of a lamp below which it is left out
constexpr int kMaxSide = 288;      // texels along one face

int Faces(Shape shape) {
  switch (shape) {
    case Shape::kBox:
      return 6;
    case Shape::kCylinder:
      return 3;
    case Shape::kQuad:
    case Shape::kSphere:
      break;
  }
  return 1;
}

struct Extent2 {
  float width;
  float height;
};

Extent2 FaceSize(const Primitive& p, int face) {
  switch (p.shape) {
    case Shape::kQuad:
      return {2 * p.half.x, 2 * p.half.y};
    case Shape::kSphere:
      return {2 * kPi * p.half.x, kPi * p.half.x};
    case Shape::kCylinder:
      return face == 0 ? Extent2{2 * kPi * p.half.x, 2 * p.half.z}
                       : Extent2{2 * p.half.x, 2 * p.half.x};
    case Shape::kBox:
      break;
  }
  switch (face / 2) {
    case 0:
      return {2 * p.half.y, 2 * p.half.z};
    case 1:
      return {2 * p.half.x, 2 * p.half.z};
    default:
      return {2 * p.half.x, 2 * p.half.y};
  }
}

// Place on a face, each coordinate 0 … 1, of a hit.
std::pair<float, float> FaceCoordinates(const Primitive& p, const Hit& hit) {
  const Vec3 l = hit.local;
  const auto part = [](float v, float half) { return half > 0.0F ? 0.5F + 0.5F * v / half : 0.5F; };
  switch (p.shape) {
    case Shape::kQuad:
      return {part(l.x, p.half.x), part(l.y, p.half.y)};
    case Shape::kSphere:
      return {0.5F + std::atan2(l.y, l.x) / (2 * kPi),
              std::acos(std::clamp(-l.z / p.half.x, -1.0F, 1.0F)) / kPi};
    case Shape::kCylinder:
      if (hit.face == 0) return {0.5F + std::atan2(l.y, l.x) / (2 * kPi), part(l.z, p.half.z)};
      return {part(l.x, p.half.x), part(l.y, p.half.x)};
    case Shape::kBox:
      break;
  }
  switch (hit.face / 2) {
    case 0:
      return {part(l.y, p.half.y), part(l.z, p.half.z)};
    case 1:
      return {part(l.x, p.half.x), part(l.z, p.half.z)};
    default:
      return {part(l.x, p.half.x), part(l.y, p.half.y)};
  }
}

// The inverse: a point of the surface.
Hit PointOnFace(const Primitive& p, int index, int face, float s, float t) {
  Hit hit;
  hit.primitive = index;
  hit.face = face;
  hit.t = 0.0F;
  const float a = 2 * s - 1;
  const float b = 2 * t - 1;
  switch (p.shape) {
    case Shape::kQuad:
      hit.local = {a * p.half.x, b * p.half.y, 0};
      break;
    case Shape::kSphere: {
      const float theta = (s - 0.5F) * 2 * kPi;
      const float z = -std::cos(t * kPi);
      const float ring = std::sqrt(std::max(0.0F, 1 - z * z));
      hit.local = Vec3{ring * std::cos(theta), ring * std::sin(theta), z} * p.half.x;
      break;
    }
    case Shape::kCylinder:
      if (face == 0) {
        const float theta = (s - 0.5F) * 2 * kPi;
        hit.local = {p.half.x * std::cos(theta), p.half.x * std::sin(theta), b * p.half.z};
      } else {
        hit.local = {a * p.half.x, b * p.half.x, face == 1 ? p.half.z : -p.half.z};
      }
      break;
    case Shape::kBox: {
      const float sign = (face & 1) != 0 ? 1.0F : -1.0F;
      if (face / 2 == 0) hit.local = {sign * p.half.x, a * p.half.y, b * p.half.z};
      if (face / 2 == 1) hit.local = {a * p.half.x, sign * p.half.y, b * p.half.z};
      if (face / 2 == 2) hit.local = {a * p.half.x, b * p.half.y, sign * p.half.z};
      break;
    }
  }
  return hit;
}

Vec3 AnyPerpendicular(Vec3 n) {
  return Normalised(std::abs(n.z) < 0.9F ? Cross(n, {0, 0, 1}) : Cross(n, {1, 0, 0}));
}

}  // namespace

BakedLight::BakedLight(const Scene& scene, const Geometry& geometry) {
  Bake(scene, geometry, geometry, nullptr);
}

BakedLight::BakedLight(const Scene& scene, const Geometry& geometry, const BakedLight& light,
                       const Geometry& solids) {
  Bake(scene, solids, geometry, &light);
}

void BakedLight::Bake(const Scene& scene, const Geometry& lit, const Geometry& around,
                      const BakedLight* finished) {
  const std::vector<Primitive>& primitives = lit.primitives();
  struct Row {
    int primitive;
    int face;
    int row;
  };
  std::vector<Row> rows;
  std::size_t total = 0;
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    const Primitive& p = primitives[i];
    first_grid_.push_back(grids_.size());
    for (int face = 0; face < Faces(p.shape); ++face) {
      const Extent2 size = FaceSize(p, face);
      const bool wraps = p.shape == Shape::kSphere || (p.shape == Shape::kCylinder && face == 0);
      Grid grid;
      grid.wraps = wraps;
      grid.columns =
          std::clamp(static_cast<int>(std::ceil(size.width / p.texel)), wraps ? 8 : 1, kMaxSide);
      grid.rows = std::clamp(static_cast<int>(std::ceil(size.height / p.texel)),
                             p.shape == Shape::kSphere ? 5 : 1, kMaxSide);
      grid.offset = total;
      total += static_cast<std::size_t>(grid.columns) * static_cast<std::size_t>(grid.rows);
      for (int row = 0; row < grid.rows; ++row) rows.push_back({static_cast<int>(i), face, row});
      grids_.push_back(grid);
    }
  }
  std::vector<Vec3> direct(total);
  std::vector<Vec3> indirect(total);

  // `step` 2 computes every second texel of every second row and repeats it for its neighbours.
  const auto each_texel = [&](int step, const auto& light_at, std::vector<Vec3>& out) {
    ParallelFor(static_cast<int>(rows.size()), 4, [&](int begin, int end) {
      for (int i = begin; i < end; ++i) {
        const Row& row = rows[static_cast<std::size_t>(i)];
        const Primitive& p = primitives[static_cast<std::size_t>(row.primitive)];
        const Grid& grid = grids_[first_grid_[static_cast<std::size_t>(row.primitive)] +
                                  static_cast<std::size_t>(row.face)];
        if (row.row % step != 0) continue;
        const auto index = [&](int r, int c) {
          return grid.offset + static_cast<std::size_t>(r * grid.columns + c);
        };
        for (int column = 0; column < grid.columns; column += step) {
          const std::size_t at = index(row.row, column);
          Random random(0x51ed2701ULL + at * 0x2545f4914f6cdd1dULL);
          const Hit hit =
              PointOnFace(p, row.primitive, row.face,
                          (static_cast<float>(column) + 0.5F) / static_cast<float>(grid.columns),
                          (static_cast<float>(row.row) + 0.5F) / static_cast<float>(grid.rows));
          const Vec3 normal = p.ToWorld(LocalNormal(p, hit));
          const Vec3 point = p.centre + p.ToWorld(hit.local) + normal * kLift;
          const Vec3 light = light_at(p, point, normal, random);
          for (int r = row.row; r < std::min(row.row + step, grid.rows); ++r) {
            for (int c = column; c < std::min(column + step, grid.columns); ++c) {
              out[index(r, c)] = light;
            }
          }
        }
      }
    });
  };

  const Vec3 sun_u = AnyPerpendicular(scene.sky.sun_direction);
  const Vec3 sun_v = Cross(scene.sky.sun_direction, sun_u);
  const bool has_sun = scene.sky.sun_irradiance.x > 0.0F && scene.sky.sun_direction.z > 0.0F;
  constexpr float kFar = 1e4F;

  each_texel(
      1,
      [&](const Primitive& p, Vec3 point, Vec3 normal, Random& random) {
        Vec3 sum;
        if (has_sun) {
          for (int i = 0; i < kSunSamples; ++i) {
            const Vec3 towards =
                Normalised(scene.sky.sun_direction + sun_u * random.Range(-0.012F, 0.012F) +
                           sun_v * random.Range(-0.012F, 0.012F));
            const float cosine = Dot(towards, normal);
            if (cosine > 0.0F && !around.Occluded(point, towards, kFar)) {
              sum += scene.sky.sun_irradiance * (cosine / kSunSamples);
            }
          }
        }
        for (const AreaLight& light : scene.lights) {
          const float area = 4.0F * Length(light.half_u) * Length(light.half_v);
          const Vec3 to_centre = light.centre - point;
          const float distance2 = Dot(to_centre, to_centre);
          // Lamps too far to matter cost rays and give nothing.
          const float most = std::max({light.radiance.x, light.radiance.y, light.radiance.z});
          if (area / (distance2 + 0.01F) * most < kFaintest) continue;
          for (int i = 0; i < kLightSamples; ++i) {
            const Vec3 to = light.centre + light.half_u * random.Range(-1.0F, 1.0F) +
                            light.half_v * random.Range(-1.0F, 1.0F) - point;
            const float r = Length(to);
            const Vec3 towards = to * (1.0F / r);
            const float cosine = Dot(towards, normal);
            const float emitted = light.both_sides ? 1.0F : -Dot(towards, light.normal);
            if (cosine <= 0.0F || emitted <= 0.0F) continue;
            if (around.Occluded(point, towards, r - 0.02F)) continue;
            sum += light.radiance * (cosine * emitted * area / (r * r + 0.02F) / kLightSamples);
          }
        }
        if (p.indoor) {
          for (const Portal& portal : scene.portals) {
            const float area = 4.0F * Length(portal.half_u) * Length(portal.half_v);
            if (Dot(portal.centre - point, portal.inward) > 0.0F) continue;
            for (int i = 0; i < kPortalSamples; ++i) {
              const float a = static_cast<float>(i % 2) + random.Unit() - 1.0F;
              const float b = static_cast<float>(i >> 1) + random.Unit() - 1.0F;
              const Vec3 to = portal.centre + portal.half_u * a + portal.half_v * b - point;
              const float r = Length(to);
              const Vec3 towards = to * (1.0F / r);
              const float cosine = Dot(towards, normal);
              const float emitted = -Dot(towards, portal.inward);
              if (cosine <= 0.0F || emitted <= 0.0F) continue;
              if (around.Occluded(point, towards, r)) continue;
              const Vec3 seen = scene.sky.Radiance(towards, false);
              sum += seen * (cosine * emitted * area / (r * r + 0.05F) / kPortalSamples);
            }
          }
        }
        return sum;
      },
      direct);
  Smooth(direct, 2);

  each_texel(
      2,
      [&](const Primitive& p, Vec3 point, Vec3 normal, Random& random) {
        const Vec3 u = AnyPerpendicular(normal);
        const Vec3 v = Cross(normal, u);
        const float turn = random.Unit();
        Vec3 sum;
        for (int i = 0; i < kGatherRays; ++i) {
          // Cosine-weighted directions on a spiral.
          const float r2 = (static_cast<float>(i) + random.Unit()) / kGatherRays;
          const float angle = 2 * kPi * (turn + 0.618034F * static_cast<float>(i));
          const float r = std::sqrt(r2);
          const Vec3 towards =
              u * (r * std::cos(angle)) + v * (r * std::sin(angle)) + normal * std::sqrt(1.0F - r2);
          const Hit hit = around.Intersect(point, towards);
          if (!hit.valid()) {
            // Indoors the openings were sampled as portals already.
            if (!p.indoor) sum += scene.sky.Radiance(towards, false) * kPi;
            continue;
          }
          const Primitive& other = around.primitives()[static_cast<std::size_t>(hit.primitive)];
          if (p.indoor && !other.indoor) continue;
          const Vec3 albedo = MeanAlbedo(scene.materials[static_cast<std::size_t>(other.material)]);
          sum += albedo * (finished == nullptr ? Lookup(direct, lit, hit)
                                               : finished->Irradiance(around, hit));
        }
        return sum * (1.0F / kGatherRays);
      },
      indirect);
  Smooth(indirect, 6);

  // Later bounces: as if every bounce gave half of the one before it indoors, a tenth outdoors.
  // Light that is finished already has them.
  irradiance_.resize(total);
  for (std::size_t i = 0; i < primitives.size(); ++i) {
    const float later = finished != nullptr ? 1.0F : (primitives[i].indoor ? 1.5F : 1.1F);
    const std::size_t end = i + 1 < primitives.size() ? grids_[first_grid_[i + 1]].offset : total;
    for (std::size_t at = grids_[first_grid_[i]].offset; at < end; ++at) {
      irradiance_[at] = direct[at] + indirect[at] * later + Vec3{kLeast, kLeast, kLeast};
    }
  }
}

Vec3 BakedLight::Lookup(const std::vector<Vec3>& texels, const Geometry& geometry,
                        const Hit& hit) const {
  const Grid& grid = GridOf(hit);
  const auto [s, t] =
      FaceCoordinates(geometry.primitives()[static_cast<std::size_t>(hit.primitive)], hit);
  const float x = s * static_cast<float>(grid.columns) - 0.5F;
  const float y =
      std::clamp(t * static_cast<float>(grid.rows) - 0.5F, 0.0F, static_cast<float>(grid.rows - 1));
  int x0 = static_cast<int>(std::floor(x));
  const float fx = grid.wraps ? x - static_cast<float>(x0)
                              : std::clamp(x, 0.0F, static_cast<float>(grid.columns - 1)) -
                                    static_cast<float>(std::clamp(x0, 0, grid.columns - 1));
  int x1 = x0 + 1;
  if (grid.wraps) {
    x0 = (x0 + grid.columns) % grid.columns;
    x1 = (x1 + grid.columns) % grid.columns;
  } else {
    x0 = std::clamp(x0, 0, grid.columns - 1);
    x1 = std::min(x0 + 1, grid.columns - 1);
  }
  const int y0 = static_cast<int>(y);
  const int y1 = std::min(y0 + 1, grid.rows - 1);
  const float fy = y - static_cast<float>(y0);
  const auto at = [&](int column, int row) {
    return texels[grid.offset + static_cast<std::size_t>(row * grid.columns + column)];
  };
  return Lerp(Lerp(at(x0, y0), at(x1, y0), fx), Lerp(at(x0, y1), at(x1, y1), fx), fy);
}

Vec3 BakedLight::Irradiance(const Geometry& geometry, const Hit& hit) const {
  return Lookup(irradiance_, geometry, hit);
}

void BakedLight::Smooth(std::vector<Vec3>& texels, int passes) const {
  std::vector<Vec3> before;
  for (int pass = 0; pass < passes; ++pass) {
    before = texels;
    ParallelFor(static_cast<int>(grids_.size()), 16, [&](int begin, int end) {
      for (int g = begin; g < end; ++g) {
        const Grid& grid = grids_[static_cast<std::size_t>(g)];
        for (int row = 0; row < grid.rows; ++row) {
          for (int column = 0; column < grid.columns; ++column) {
            Vec3 sum;
            float weight = 0.0F;
            for (int dy = -1; dy <= 1; ++dy) {
              for (int dx = -1; dx <= 1; ++dx) {
                int x = column + dx;
                const int y = row + dy;
                if (grid.wraps) x = (x + grid.columns) % grid.columns;
                if (x < 0 || x >= grid.columns || y < 0 || y >= grid.rows) continue;
                const float w = (dx == 0 ? 2.0F : 1.0F) * (dy == 0 ? 2.0F : 1.0F);
                sum += before[grid.offset + static_cast<std::size_t>(y * grid.columns + x)] * w;
                weight += w;
              }
            }
            texels[grid.offset + static_cast<std::size_t>(row * grid.columns + column)] =
                sum * (1.0F / weight);
          }
        }
      }
    });
  }
}

}  // namespace omnihdr::sim
