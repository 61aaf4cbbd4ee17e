#include "core/sphere/projection.h"

#include <cmath>
#include <numbers>

namespace omnihdr {
namespace {
constexpr double kPi = std::numbers::pi;
}  // namespace

std::string_view ToString(ProjectionKind kind) {
  switch (kind) {
    case ProjectionKind::kEquirectangular:
      return "equirectangular";
    case ProjectionKind::kCylindrical:
      return "cylindrical";
  }
  return "?";
}

std::optional<ProjectionKind> ProjectionKindFromString(std::string_view name) {
  if (name == "equirectangular") return ProjectionKind::kEquirectangular;
  if (name == "cylindrical") return ProjectionKind::kCylindrical;
  return std::nullopt;
}

Projection Projection::Equirectangular(int width, int height) {
  Projection p;
  p.kind_ = ProjectionKind::kEquirectangular;
  p.width_ = width;
  p.height_ = height;
  return p;
}

Projection Projection::Cylindrical(int width, int height, double z_min, double z_max) {
  Projection p;
  p.kind_ = ProjectionKind::kCylindrical;
  p.width_ = width;
  p.height_ = height;
  p.z_min_ = z_min;
  p.z_max_ = z_max;
  return p;
}

Eigen::Vector3d Projection::RayFromPixel(double x, double y) const {
  const double theta = kPi - 2.0 * kPi * x / width_;
  if (kind_ == ProjectionKind::kEquirectangular) {
    const double phi = kPi * y / height_;
    return {std::sin(phi) * std::cos(theta), std::sin(phi) * std::sin(theta), std::cos(phi)};
  }
  const double z = z_max_ - y * (z_max_ - z_min_) / height_;
  const double s = 1.0 / std::sqrt(1.0 + z * z);
  return {s * std::cos(theta), s * std::sin(theta), s * z};
}

Eigen::Vector2d Projection::PixelFromRay(const Eigen::Vector3d& ray) const {
  const double theta = std::atan2(ray.y(), ray.x());
  double x = width_ * (kPi - theta) / (2.0 * kPi);
  if (x >= width_) x -= width_;
  if (x < 0.0) x = 0.0;
  const double rho = std::hypot(ray.x(), ray.y());
  if (kind_ == ProjectionKind::kEquirectangular) {
    return {x, height_ * std::atan2(rho, ray.z()) / kPi};
  }
  // Straight up or down lies at infinity: far outside, but finite.
  const double z = ray.z() / std::max(rho, 1e-12 * std::abs(ray.z()) + 1e-300);
  return {x, height_ * (z_max_ - z) / (z_max_ - z_min_)};
}

bool Projection::Covers(const Eigen::Vector3d& ray) const {
  const double y = PixelFromRay(ray).y();
  return y >= 0.0 && y <= height_;
}

double Projection::PixelSolidAngle(int row) const {
  const double d_theta = 2.0 * kPi / width_;
  if (kind_ == ProjectionKind::kEquirectangular) {
    return d_theta * (std::cos(kPi * row / height_) - std::cos(kPi * (row + 1) / height_));
  }
  const auto sine = [this](double y) {  // sine of the elevation
    const double z = z_max_ - y * (z_max_ - z_min_) / height_;
    return z / std::sqrt(1.0 + z * z);
  };
  return d_theta * (sine(row) - sine(row + 1));
}

Projection Projection::Resized(int width, int height) const {
  Projection p = *this;
  p.width_ = width;
  p.height_ = height;
  return p;
}

}  // namespace omnihdr
