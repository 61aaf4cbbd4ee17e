#pragma once

#include <Eigen/Core>
#include <optional>
#include <string_view>

#include "core/base/result.h"

namespace omnihdr {

enum class ProjectionKind { kEquirectangular, kCylindrical };

std::string_view ToString(ProjectionKind kind);
std::optional<ProjectionKind> ProjectionKindFromString(std::string_view name);

// The mapping between pixels of a panorama and unit rays of its camera frame (X forward, Y left, Z
// up). Column: x = W·(π − θ)/2π with θ = atan2(Y, X) (thesis eqs. 3.4, 3.14). Row, equirectangular:
// y = H·φ/π with φ the angle from +Z; cylindrical: y = H·(z_max − z)/(z_max − z_min) with
// z = Z/√(X²+Y²) (thesis eq. 3.5). Pixel (column j, row i) has its centre at (j+0.5, i+0.5). Value
// type.
class Projection {
 public:
  Projection() = default;
  static Projection Equirectangular(int width, int height);
  static Projection Cylindrical(int width, int height, double z_min, double z_max);

  ProjectionKind kind() const { return kind_; }
  int width() const { return width_; }
  int height() const { return height_; }
  double z_min() const { return z_min_; }
  double z_max() const { return z_max_; }

  // Unit ray through image point (x, y).
  Eigen::Vector3d RayFromPixel(double x, double y) const;
  // Image point of a ray of any length; x in [0, W). A cylinder's y is outside [0, H] where the ray
  // leaves the covered band. The zero vector maps to an unspecified point.
  Eigen::Vector2d PixelFromRay(const Eigen::Vector3d& ray) const;
  // Whether the ray falls into the image.
  bool Covers(const Eigen::Vector3d& ray) const;
  // Solid angle of a pixel of row i, in steradians (the same for every column).
  double PixelSolidAngle(int row) const;
  // The same mapping on a grid of another size.
  Projection Resized(int width, int height) const;

  bool operator==(const Projection&) const = default;

 private:
  ProjectionKind kind_ = ProjectionKind::kEquirectangular;
  int width_ = 0;
  int height_ = 0;
  double z_min_ = 0.0;
  double z_max_ = 0.0;
};

}  // namespace omnihdr
