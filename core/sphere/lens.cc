#include "core/sphere/lens.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <utility>

namespace omnihdr {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr int kMaxSide = 1 << 16;
constexpr std::size_t kMaxGridNodes = std::size_t{1} << 24;
// Slope of the radial curve relative to the centre's below which a lens counts as folding back.
constexpr double kMinSlope = 0.01;
// The tangential terms may bend by this share of the least radial slope: their fixed point then
// halves its error in every step (Banach).
constexpr double kMaxTangentialShare = 0.5;
constexpr int kFixedPointSteps = 60;
constexpr double kSolved = 1e-12;  // in normalised image units
constexpr int kGridNewtonSteps = 20;
constexpr double kGridSolvedPx = 1e-9;

// c[0] + c[1]·s + c[2]·s² + …
using Polynomial = std::vector<double>;

double At(const Polynomial& p, double s) {
  double value = 0.0;
  for (std::size_t i = p.size(); i-- > 0;) value = value * s + p[i];
  return value;
}

// Where p changes its sign in (0, high), ascending: between two such places of its derivative it is
// monotone, and bisection finds the only one.
std::vector<double> SignChanges(const Polynomial& p, double high) {
  if (p.size() < 2) return {};
  Polynomial derivative;
  for (std::size_t i = 1; i < p.size(); ++i) derivative.push_back(static_cast<double>(i) * p[i]);
  std::vector<double> knots = SignChanges(derivative, high);
  knots.insert(knots.begin(), 0.0);
  knots.push_back(high);
  std::vector<double> changes;
  for (std::size_t i = 0; i + 1 < knots.size(); ++i) {
    double a = knots[i];
    double b = knots[i + 1];
    const bool rising = At(p, a) < 0.0;
    if (rising == (At(p, b) < 0.0)) continue;
    for (int step = 0; step < 200; ++step) {
      const double middle = 0.5 * (a + b);
      if (middle <= a || middle >= b) break;
      ((At(p, middle) < 0.0) == rising ? a : b) = middle;
    }
    changes.push_back(0.5 * (a + b));
  }
  return changes;
}

// Coefficients of r·(1 + …) beyond the 1, as polynomial of s = r²: k1 k2 k3 of pinhole's
// k1 k2 p1 p2 k3, all five of a fisheye's.
Polynomial RadialTerms(LensKind kind, const std::array<double, 5>& d) {
  if (kind == LensKind::kFisheye) return {1.0, d[0], d[1], d[2], d[3], d[4]};
  return {1.0, d[0], d[1], d[4]};
}

// Slope of r·p(r²) as polynomial of s = r².
Polynomial SlopeOf(Polynomial radial) {
  for (std::size_t i = 0; i < radial.size(); ++i) radial[i] *= 2.0 * static_cast<double>(i) + 1.0;
  return radial;
}

double LeastOn(const Polynomial& p, double high) {
  Polynomial derivative;
  for (std::size_t i = 1; i < p.size(); ++i) derivative.push_back(static_cast<double>(i) * p[i]);
  double least = std::min(At(p, 0.0), At(p, high));
  for (const double s : SignChanges(derivative, high)) least = std::min(least, At(p, s));
  return least;
}

struct RadialCurve {
  std::array<double, 5> k{};  // r·(1 + k0·r² + k1·r⁴ + …)
  double Value(double r) const {
    const double s = r * r;
    return r * (1.0 + s * (k[0] + s * (k[1] + s * (k[2] + s * (k[3] + s * k[4])))));
  }
  double Slope(double r) const {
    const double s = r * r;
    return 1.0 + s * (3.0 * k[0] +
                      s * (5.0 * k[1] + s * (7.0 * k[2] + s * (9.0 * k[3] + s * 11.0 * k[4]))));
  }
  // The r in [0, largest] with Value(r) = value: Newton, kept inside a bracket that only shrinks;
  // the curve rises there, so it cannot miss. `largest` when the value lies beyond.
  double Inverse(double value, double largest) const {
    double low = 0.0;
    double high = largest;
    if (value >= Value(high)) return high;
    double r = std::min(value, high);
    for (int step = 0; step < 100; ++step) {
      const double error = Value(r) - value;
      if (std::abs(error) <= 4e-16 * (1.0 + value)) break;
      (error > 0.0 ? high : low) = r;
      double next = r - error / Slope(r);
      if (!(next > low && next < high)) next = 0.5 * (low + high);
      if (next == r) break;
      r = next;
    }
    return r;
  }
};

RadialCurve CurveOf(LensKind kind, const std::array<double, 5>& d) {
  if (kind == LensKind::kFisheye) return {d};
  return {{d[0], d[1], d[4], 0.0, 0.0}};
}

// Brown's tangential shift with q = (p2, p1): 2(q·x)x + |x|²q. Its derivative is symmetric with
// eigenvalues within ±6|x||q|.
Eigen::Vector2d TangentialShift(const std::array<double, 5>& d, const Eigen::Vector2d& x) {
  const Eigen::Vector2d q(d[3], d[2]);
  return 2.0 * q.dot(x) * x + x.squaredNorm() * q;
}

Status CheckIntrinsics(int width, int height, const Eigen::Vector2d& focal,
                       const Eigen::Vector2d& centre) {
  if (width < 1 || height < 1 || width > kMaxSide || height > kMaxSide) {
    return Fail(ErrorKind::kData, "size {}x{}, expected 1 to {} pixels a side", width, height,
                kMaxSide);
  }
  if (!focal.allFinite() || !(focal.minCoeff() > 0.0) || focal.maxCoeff() > 1e9) {
    return Fail(ErrorKind::kData, "focal [{}, {}], expected positive pixels", focal.x(), focal.y());
  }
  if (!centre.allFinite() || centre.cwiseAbs().maxCoeff() > 1e9) {
    return Fail(ErrorKind::kData, "centre [{}, {}], expected finite pixels", centre.x(),
                centre.y());
  }
  return {};
}

Status CheckDistortion(LensKind kind, const std::array<double, 5>& distortion, double max_angle) {
  for (const double k : distortion) {
    if (!std::isfinite(k) || std::abs(k) > 1e6) {
      return Fail(ErrorKind::kData, "distortion {}, expected five finite coefficients", k);
    }
  }
  const double limit = kind == LensKind::kPinhole ? kPi / 2.0 : kPi;
  if (!(max_angle > 0.0 && max_angle < limit)) {
    return Fail(
        ErrorKind::kData,
        "fov_deg: {:.6g}, expected a field of view of more than 0 and less than {:g} for a {} "
        "lens",
        2.0 * max_angle * 180.0 / kPi, 2.0 * limit * 180.0 / kPi, ToString(kind));
  }
  const double unfolded = Lens::UnfoldedAngle(kind, distortion, max_angle);
  if (unfolded < max_angle) {
    return Fail(ErrorKind::kData,
                "distortion folds back {:.4g} degrees off the axis, expected not within half the "
                "field of view, {:.4g}",
                unfolded * 180.0 / kPi, max_angle * 180.0 / kPi);
  }
  if (kind == LensKind::kPinhole) {
    const double r = std::tan(max_angle);
    const double bend = 6.0 * r * std::hypot(distortion[2], distortion[3]);
    const double slope = LeastOn(SlopeOf(RadialTerms(kind, distortion)), r * r);
    if (!(bend <= kMaxTangentialShare * slope)) {
      return Fail(ErrorKind::kData,
                  "distortion p1 {:g}, p2 {:g}, expected at most {:.3g} within this field of view",
                  distortion[2], distortion[3], kMaxTangentialShare * slope / (6.0 * r));
    }
  }
  return {};
}

// The point of the other picture where (x, y) lies, and the derivative; nothing outside the nodes
// or where a node around is empty.
struct GridPoint {
  Eigen::Vector2d value;
  Eigen::Matrix2d derivative;
};

std::optional<GridPoint> LookUp(const LensGrid& grid, const Eigen::Vector2d& at) {
  const double gx = at.x() / grid.step_x;
  const double gy = at.y() / grid.step_y;
  if (!(gx >= 0.0 && gy >= 0.0 && gx <= grid.columns - 1 && gy <= grid.rows - 1)) {
    return std::nullopt;
  }
  const int j = std::min(static_cast<int>(gx), grid.columns - 2);
  const int i = std::min(static_cast<int>(gy), grid.rows - 2);
  const double u = gx - j;
  const double v = gy - i;
  const auto node = [&](int row, int column) -> Eigen::Vector2d {
    return grid
        .points[static_cast<std::size_t>(row) * static_cast<std::size_t>(grid.columns) +
                static_cast<std::size_t>(column)]
        .cast<double>();
  };
  const Eigen::Vector2d a = node(i, j);
  const Eigen::Vector2d b = node(i, j + 1);
  const Eigen::Vector2d c = node(i + 1, j);
  const Eigen::Vector2d d = node(i + 1, j + 1);
  GridPoint point;
  point.value = (1.0 - v) * ((1.0 - u) * a + u * b) + v * ((1.0 - u) * c + u * d);
  if (!point.value.allFinite()) return std::nullopt;
  point.derivative.col(0) = ((1.0 - v) * (b - a) + v * (d - c)) / grid.step_x;
  point.derivative.col(1) = ((1.0 - u) * (c - a) + u * (d - b)) / grid.step_y;
  return point;
}

Status CheckGrid(std::string_view name, const LensGrid& grid) {
  if (grid.columns < 2 || grid.rows < 2 ||
      static_cast<std::size_t>(grid.columns) >
          kMaxGridNodes / static_cast<std::size_t>(grid.rows)) {
    return Fail(ErrorKind::kData,
                "{}: {} columns, {} rows, expected at least 2 and at most {} nodes", name,
                grid.columns, grid.rows, kMaxGridNodes);
  }
  const std::size_t nodes =
      static_cast<std::size_t>(grid.columns) * static_cast<std::size_t>(grid.rows);
  if (grid.points.size() != nodes) {
    return Fail(ErrorKind::kData, "{}: {} nodes, expected {} ({} columns, {} rows)", name,
                grid.points.size(), nodes, grid.columns, grid.rows);
  }
  if (!(grid.step_x > 0.0 && grid.step_y > 0.0 && grid.step_x <= kMaxSide &&
        grid.step_y <= kMaxSide)) {
    return Fail(ErrorKind::kData, "{}: step [{}, {}], expected positive pixels", name, grid.step_x,
                grid.step_y);
  }
  const bool any = std::any_of(
      grid.points.begin(), grid.points.end(),
      [](const Eigen::Vector2f& p) { return std::isfinite(p.x()) && std::isfinite(p.y()); });
  if (!any) return Fail(ErrorKind::kData, "{}: no node has a point, expected some", name);
  return {};
}

}  // namespace

std::string_view ToString(LensKind kind) {
  switch (kind) {
    case LensKind::kPinhole:
      return "pinhole";
    case LensKind::kFisheye:
      return "fisheye";
    case LensKind::kGrid:
      return "grid";
  }
  return "?";
}

std::optional<LensKind> LensKindFromString(std::string_view name) {
  if (name == "pinhole") return LensKind::kPinhole;
  if (name == "fisheye") return LensKind::kFisheye;
  if (name == "grid") return LensKind::kGrid;
  return std::nullopt;
}

double Lens::UnfoldedAngle(LensKind kind, const std::array<double, 5>& distortion, double limit) {
  const bool pinhole = kind == LensKind::kPinhole;
  const double r = pinhole ? std::tan(limit) : limit;
  Polynomial excess = SlopeOf(RadialTerms(kind, distortion));
  excess[0] -= kMinSlope;
  const std::vector<double> changes = SignChanges(excess, r * r);
  if (changes.empty()) return limit;
  const double fold = std::sqrt(changes.front());
  return std::min(limit, pinhole ? std::atan(fold) : fold);
}

Result<Lens> Lens::Pinhole(int width, int height, const Eigen::Vector2d& focal,
                           const Eigen::Vector2d& centre, const std::array<double, 5>& distortion,
                           double max_angle) {
  OMNIHDR_TRY(CheckIntrinsics(width, height, focal, centre));
  OMNIHDR_TRY(CheckDistortion(LensKind::kPinhole, distortion, max_angle));
  Lens lens;
  lens.kind_ = LensKind::kPinhole;
  lens.width_ = width;
  lens.height_ = height;
  lens.focal_ = focal;
  lens.centre_ = centre;
  lens.distortion_ = distortion;
  lens.max_angle_ = max_angle;
  return lens;
}

Result<Lens> Lens::Fisheye(int width, int height, const Eigen::Vector2d& focal,
                           const Eigen::Vector2d& centre, const std::array<double, 5>& distortion,
                           double max_angle) {
  OMNIHDR_TRY(CheckIntrinsics(width, height, focal, centre));
  OMNIHDR_TRY(CheckDistortion(LensKind::kFisheye, distortion, max_angle));
  Lens lens;
  lens.kind_ = LensKind::kFisheye;
  lens.width_ = width;
  lens.height_ = height;
  lens.focal_ = focal;
  lens.centre_ = centre;
  lens.distortion_ = distortion;
  lens.max_angle_ = max_angle;
  return lens;
}

Result<Lens> Lens::Grid(int width, int height, const Eigen::Vector2d& focal,
                        const Eigen::Vector2d& centre, LensGrid raw_from_rectified,
                        LensGrid rectified_from_raw) {
  OMNIHDR_TRY(CheckIntrinsics(width, height, focal, centre));
  OMNIHDR_TRY(CheckGrid("raw_from_rectified", raw_from_rectified));
  OMNIHDR_TRY(CheckGrid("rectified_from_raw", rectified_from_raw));
  // The maps must be each other's inverse, as far as their steps allow; one read with rows and
  // columns exchanged, or of another sensor, is not.
  const double tolerance =
      std::max(2.0, 0.25 * std::max(rectified_from_raw.step_x, rectified_from_raw.step_y));
  std::size_t compared = 0;
  double largest_r2 = 0.0;
  for (int i = 0; i < raw_from_rectified.rows; ++i) {
    for (int j = 0; j < raw_from_rectified.columns; ++j) {
      const Eigen::Vector2d rectified(j * raw_from_rectified.step_x, i * raw_from_rectified.step_y);
      const std::size_t node =
          static_cast<std::size_t>(i) * static_cast<std::size_t>(raw_from_rectified.columns) +
          static_cast<std::size_t>(j);
      const Eigen::Vector2d raw = raw_from_rectified.points[node].cast<double>();
      if (!raw.allFinite() || raw.minCoeff() < 0.0 || raw.x() > width || raw.y() > height) continue;
      largest_r2 = std::max(largest_r2, (rectified - centre).cwiseQuotient(focal).squaredNorm());
      const std::optional<GridPoint> back = LookUp(rectified_from_raw, raw);
      if (!back) continue;
      ++compared;
      const double error = (back->value - rectified).norm();
      if (error > tolerance) {
        return Fail(ErrorKind::kData,
                    "the grids do not undo each other: ({:g}, {:g}) of the rectified picture comes "
                    "back {:.3g} pixels off, expected at most {:g}",
                    rectified.x(), rectified.y(), error, tolerance);
      }
    }
  }
  if (compared == 0) {
    return Fail(ErrorKind::kData,
                "the grids have no point in common, expected maps between one {}x{} sensor and its "
                "rectified picture",
                width, height);
  }
  Lens lens;
  lens.kind_ = LensKind::kGrid;
  lens.width_ = width;
  lens.height_ = height;
  lens.focal_ = focal;
  lens.centre_ = centre;
  lens.max_angle_ = std::atan(std::sqrt(largest_r2));
  lens.raw_from_rectified_ = std::make_shared<const LensGrid>(std::move(raw_from_rectified));
  lens.rectified_from_raw_ = std::make_shared<const LensGrid>(std::move(rectified_from_raw));
  return lens;
}

std::optional<Eigen::Vector2d> Lens::PixelFromRay(const Eigen::Vector3d& ray_in_lens) const {
  const double rho = std::hypot(ray_in_lens.x(), ray_in_lens.y());
  const double angle = std::atan2(rho, ray_in_lens.z());
  // Written so that NaN and the zero vector fail too.
  if (!(angle <= max_angle_ && (rho > 0.0 || ray_in_lens.z() > 0.0))) return std::nullopt;
  Eigen::Vector2d pixel;
  if (kind_ == LensKind::kFisheye) {
    const double scale = rho > 0.0 ? CurveOf(kind_, distortion_).Value(angle) / rho : 0.0;
    pixel = scale * focal_.cwiseProduct(ray_in_lens.head<2>()) + centre_;
  } else {
    const Eigen::Vector2d x = ray_in_lens.head<2>() / ray_in_lens.z();
    if (kind_ == LensKind::kPinhole) {
      const double r = x.norm();
      const double scale = r > 0.0 ? CurveOf(kind_, distortion_).Value(r) / r : 1.0;
      pixel = focal_.cwiseProduct(scale * x + TangentialShift(distortion_, x)) + centre_;
    } else {
      const std::optional<GridPoint> raw =
          LookUp(*raw_from_rectified_, focal_.cwiseProduct(x) + centre_);
      if (!raw) return std::nullopt;
      pixel = raw->value;
    }
  }
  if (!(pixel.minCoeff() >= 0.0 && pixel.x() <= width_ && pixel.y() <= height_)) {
    return std::nullopt;
  }
  return pixel;
}

std::optional<Eigen::Vector3d> Lens::RayFromPixel(double x, double y) const {
  if (!(x >= 0.0 && y >= 0.0 && x <= width_ && y <= height_)) return std::nullopt;
  const Eigen::Vector2d pixel(x, y);
  if (kind_ == LensKind::kGrid) {
    const std::optional<GridPoint> start = LookUp(*rectified_from_raw_, pixel);
    if (!start) return std::nullopt;
    // The sampled inverse starts; the forward map decides, so that the two directions agree.
    Eigen::Vector2d rectified = start->value;
    bool solved = false;
    for (int step = 0; step < kGridNewtonSteps && !solved; ++step) {
      const std::optional<GridPoint> raw = LookUp(*raw_from_rectified_, rectified);
      if (!raw) break;
      const Eigen::Vector2d error = raw->value - pixel;
      solved = error.norm() < kGridSolvedPx;
      const Eigen::Matrix2d& d = raw->derivative;
      const double determinant = d(0, 0) * d(1, 1) - d(0, 1) * d(1, 0);
      if (!(std::abs(determinant) > 1e-9)) break;
      rectified -= Eigen::Vector2d(d(1, 1) * error.x() - d(0, 1) * error.y(),
                                   d(0, 0) * error.y() - d(1, 0) * error.x()) /
                   determinant;
    }
    if (!solved) rectified = start->value;
    const Eigen::Vector2d p = (rectified - centre_).cwiseQuotient(focal_);
    return Eigen::Vector3d(p.x(), p.y(), 1.0).normalized();
  }
  const Eigen::Vector2d target = (pixel - centre_).cwiseQuotient(focal_);
  const RadialCurve curve = CurveOf(kind_, distortion_);
  if (kind_ == LensKind::kFisheye) {
    const double value = target.norm();
    if (value > curve.Value(max_angle_) * (1.0 + kSolved)) return std::nullopt;
    if (value == 0.0) return Eigen::Vector3d(0.0, 0.0, 1.0);
    const double angle = curve.Inverse(value, max_angle_);
    const double sine = std::sin(angle) / value;
    return Eigen::Vector3d(sine * target.x(), sine * target.y(), std::cos(angle));
  }
  const double largest = std::tan(max_angle_);
  const bool tangential = distortion_[2] != 0.0 || distortion_[3] != 0.0;
  Eigen::Vector2d solution = Eigen::Vector2d::Zero();
  for (int step = 0; step < kFixedPointSteps; ++step) {
    const Eigen::Vector2d straight = target - TangentialShift(distortion_, solution);
    const double value = straight.norm();
    const Eigen::Vector2d next =
        value > 0.0 ? Eigen::Vector2d(straight * (curve.Inverse(value, largest) / value))
                    : Eigen::Vector2d::Zero();
    const double change = (next - solution).norm();
    solution = next;
    if (!tangential || change < 1e-15) break;
  }
  const double r = solution.norm();
  const double scale = r > 0.0 ? curve.Value(r) / r : 1.0;
  const Eigen::Vector2d error = scale * solution + TangentialShift(distortion_, solution) - target;
  if (!(error.norm() <= kSolved * (1.0 + target.norm()))) return std::nullopt;
  return Eigen::Vector3d(solution.x(), solution.y(), 1.0).normalized();
}

}  // namespace omnihdr
