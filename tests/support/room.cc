#include "tests/support/room.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <random>

namespace omnihdr::testing {
namespace {

// A number in 0..1 from a lattice point, always the same.
double Hash(std::int64_t x, std::int64_t y, std::int64_t z) {
  auto h = static_cast<std::uint64_t>(x * 73856093) ^ static_cast<std::uint64_t>(y * 19349663) ^
           static_cast<std::uint64_t>(z * 83492791);
  h += 0x9E3779B97F4A7C15ULL;
  h = (h ^ (h >> 30U)) * 0xBF58476D1CE4E5B9ULL;
  h = (h ^ (h >> 27U)) * 0x94D049BB133111EBULL;
  return static_cast<double>((h ^ (h >> 31U)) >> 11U) / 9007199254740992.0;
}

// Trilinear value noise of unit cells, 0..1.
double Noise(const Eigen::Vector3d& p) {
  const Eigen::Vector3d base = p.array().floor();
  const Eigen::Vector3d f = p - base;
  const auto ix = static_cast<std::int64_t>(base.x());
  const auto iy = static_cast<std::int64_t>(base.y());
  const auto iz = static_cast<std::int64_t>(base.z());
  double sum = 0.0;
  for (int k = 0; k < 8; ++k) {
    const int dx = k & 1;
    const int dy = (k >> 1) & 1;
    const int dz = k >> 2;
    const double w = (dx == 1 ? f.x() : 1.0 - f.x()) * (dy == 1 ? f.y() : 1.0 - f.y()) *
                     (dz == 1 ? f.z() : 1.0 - f.z());
    sum += w * Hash(ix + dx, iy + dy, iz + dz);
  }
  return sum;
}

}  // namespace

Room::Hit Room::Look(const Eigen::Vector3d& from, const Eigen::Vector3d& ray) const {
  Hit hit;
  hit.distance = std::numeric_limits<double>::infinity();
  for (int axis = 0; axis < 3; ++axis) {
    if (std::abs(ray[axis]) < 1e-12) continue;
    const double wall = ray[axis] > 0.0 ? high[axis] : low[axis];
    hit.distance = std::min(hit.distance, (wall - from[axis]) / ray[axis]);
  }
  float factor = 1.0F;
  for (const Ball& ball : balls) {
    const Eigen::Vector3d to_centre = ball.centre - from;
    const double along = to_centre.dot(ray);
    const double inside = ball.radius * ball.radius - (to_centre.squaredNorm() - along * along);
    if (inside <= 0.0) continue;
    const double distance = along - std::sqrt(inside);
    if (distance <= 0.0 || distance >= hit.distance) continue;
    hit.distance = distance;
    factor = ball.brightness;
  }
  if (!textured) {
    hit.radiance.setConstant(brightness * factor);
    return hit;
  }
  const Eigen::Vector3d p =
      from + hit.distance * ray + Eigen::Vector3d::Constant(17.3 + texture_shift);
  // Reflectance: cells with sharp borders (corners to find) over smooth ones, and a tint.
  const double coarse = Noise(p / detail_m);
  const double fine = Noise(p / (0.37 * detail_m) + Eigen::Vector3d::Constant(5.7));
  const double step =
      Noise(p / (0.8 * detail_m) + Eigen::Vector3d::Constant(31.1)) > 0.5 ? 1.0 : 0.0;
  const double reflectance = 0.15 + 0.35 * coarse + 0.3 * fine + 0.45 * step;
  const double light =
      std::pow(10.0, static_cast<double>(range_decades) *
                         (Noise(p / 2.9 + Eigen::Vector3d::Constant(80.2)) - 0.5) * 1.4);
  const double tint = 0.5 + Noise(p / (1.7 * detail_m) + Eigen::Vector3d::Constant(55.5));
  const double e = static_cast<double>(brightness * factor) * reflectance * light;
  hit.radiance = Eigen::Vector3d(e * tint, e, e * (2.0 - tint)).cast<float>();
  return hit;
}

Truth Render(const Room& room, const Projection& projection, const Pose& world_from_camera) {
  Truth truth;
  truth.radiance = Image<float>(projection.width(), projection.height(), 3);
  truth.distance = Image<float>(projection.width(), projection.height());
  const auto look = [&](double x, double y) {
    return room.Look(world_from_camera.translation,
                     world_from_camera.rotation * projection.RayFromPixel(x, y));
  };
  for (int y = 0; y < projection.height(); ++y) {
    for (int x = 0; x < projection.width(); ++x) {
      Eigen::Vector3f sum = Eigen::Vector3f::Zero();
      for (int k = 0; k < 4; ++k) {
        sum += look(x + 0.25 + 0.5 * (k & 1), y + 0.25 + 0.5 * (k >> 1)).radiance;
      }
      for (int c = 0; c < 3; ++c) truth.radiance.at(x, y, c) = 0.25F * sum[c];
      truth.distance.at(x, y) = static_cast<float>(look(x + 0.5, y + 0.5).distance);
    }
  }
  return truth;
}

DecodedImage Expose(const Image<float>& radiance, double seconds, std::uint32_t seed,
                    const NoiseModel& noise, bool with_noise) {
  std::mt19937 generator(seed);
  std::normal_distribution<double> gaussian;
  Image<std::uint8_t> out(radiance.width(), radiance.height(), 3);
  for (std::size_t k = 0; k < radiance.size(); ++k) {
    double z = 128.0 * static_cast<double>(radiance.values()[k]) * seconds;
    if (with_noise) z += gaussian(generator) * std::sqrt(noise.VarianceOfValue(z) - 1.0 / 12.0);
    out.values()[k] = static_cast<std::uint8_t>(std::clamp(z + 0.5, 0.0, 255.0));
  }
  return {std::move(out)};
}

}  // namespace omnihdr::testing
