#include "drivers/sim/scene.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace omnihdr::sim {
namespace {

constexpr double kStep = 0.01;
constexpr float kPi = std::numbers::pi_v<float>;

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

}  // namespace omnihdr::sim
