#pragma once

#include <Eigen/Core>
#include <array>
#include <memory>
#include <optional>
#include <string_view>
#include <vector>

#include "core/base/result.h"

namespace omnihdr {

enum class LensKind {
  kPinhole,  // pinhole with radial-tangential distortion (Brown 1966; OpenCV's k1 k2 p1 p2 k3)
  kFisheye,  // Kannala and Brandt 2006, eq. 6: r = θ·(1 + k1θ² + k2θ⁴ + k3θ⁶ + k4θ⁸ + k5θ¹⁰)
  kGrid,  // pinhole in a rectified picture, and sampled maps rectified ↔ raw (factory files)
};

std::string_view ToString(LensKind kind);
std::optional<LensKind> LensKindFromString(std::string_view name);

// Sampled mapping between a rectified picture and the raw sensor, as factory files carry it: the
// value at node (column j, row i) is where the point (j·step_x, i·step_y) of one picture lies in
// the other, in pixels; between nodes bilinear. NaN where there is nothing.
struct LensGrid {
  int columns = 0;
  int rows = 0;
  double step_x = 0.0;
  double step_y = 0.0;
  std::vector<Eigen::Vector2f> points;  // row-major, columns·rows
};

// How directions become pixels of one sensor, distortion included. Lens frame: Z out along the
// axis, X to the right (columns), Y down (rows); pixel (column j, row i) has its centre at
// (j+0.5, i+0.5). Value type; thread-safe to read.
class Lens {
 public:
  Lens() = default;
  // `focal` in pixels; `distortion` k1 k2 p1 p2 k3 (pinhole) or k1 … k5 (fisheye). `max_angle`:
  // half the field of view in radians, beyond which a ray has no pixel; pinhole < π/2, fisheye < π.
  // Errors (kData, naming the parameter and what was expected): sizes and focal lengths that are
  // not positive, values that are not finite, a distortion that folds back within max_angle, a
  // tangential part so large that its inverse could not be promised.
  static Result<Lens> Pinhole(int width, int height, const Eigen::Vector2d& focal,
                              const Eigen::Vector2d& centre,
                              const std::array<double, 5>& distortion, double max_angle);
  static Result<Lens> Fisheye(int width, int height, const Eigen::Vector2d& focal,
                              const Eigen::Vector2d& centre,
                              const std::array<double, 5>& distortion, double max_angle);
  // focal and centre are those of the rectified picture. max_angle is that of the outermost node.
  // Errors besides those above: fewer than 2×2 nodes, no valid node, two grids that are not each
  // other's inverse (more than 2 pixels, or a quarter of a step when that is more).
  static Result<Lens> Grid(int width, int height, const Eigen::Vector2d& focal,
                           const Eigen::Vector2d& centre, LensGrid raw_from_rectified,
                           LensGrid rectified_from_raw);

  // Largest angle off the axis, at most `limit`, up to which the radial curve rises (by at least a
  // hundredth of its slope at the axis): what max_angle may be. Not for grids.
  static double UnfoldedAngle(LensKind kind, const std::array<double, 5>& distortion, double limit);

  LensKind kind() const { return kind_; }
  int width() const { return width_; }
  int height() const { return height_; }
  const Eigen::Vector2d& focal() const { return focal_; }
  const Eigen::Vector2d& centre() const { return centre_; }
  const std::array<double, 5>& distortion() const { return distortion_; }
  double max_angle() const { return max_angle_; }
  const std::shared_ptr<const LensGrid>& raw_from_rectified() const { return raw_from_rectified_; }
  const std::shared_ptr<const LensGrid>& rectified_from_raw() const { return rectified_from_raw_; }

  // Image point of a ray of any length; nothing when the ray is outside max_angle or the image.
  std::optional<Eigen::Vector2d> PixelFromRay(const Eigen::Vector3d& ray_in_lens) const;
  // Unit ray through an image point; nothing outside the image and where no ray within max_angle
  // lands. Inverse of PixelFromRay to rounding (pinhole, fisheye: Newton in a bracket on the radial
  // curve, which rises within max_angle; so it always converges) and to 1e-9 pixels (grid, where
  // the sampled maps allow it).
  std::optional<Eigen::Vector3d> RayFromPixel(double x, double y) const;

 private:
  LensKind kind_ = LensKind::kPinhole;
  int width_ = 0;
  int height_ = 0;
  Eigen::Vector2d focal_ = Eigen::Vector2d::Zero();
  Eigen::Vector2d centre_ = Eigen::Vector2d::Zero();
  std::array<double, 5> distortion_{};
  double max_angle_ = 0.0;
  std::shared_ptr<const LensGrid> raw_from_rectified_;
  std::shared_ptr<const LensGrid> rectified_from_raw_;
};

}  // namespace omnihdr
