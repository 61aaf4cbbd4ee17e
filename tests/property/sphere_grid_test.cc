#include "core/sphere/sphere_grid.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>
#include <vector>

#include "core/sphere/sphere_remap.h"
#include "tests/property/generators.h"

namespace omnihdr::sphere_grid_test {
namespace {

using testing::Between;

constexpr double kPi = std::numbers::pi;

// Any kind of grid, of a face (or a picture's height) in [least, most] pixels.
SphereGrid AnyGrid(int least, int most) {
  const int size = *rc::gen::inRange(least, most + 1);
  switch (*rc::gen::inRange(0, 5)) {
    case 0:
      return SphereGrid::Equirectangular(2 * size, size);
    case 1:
      return SphereGrid::Cylindrical(2 * size, size, *Between(-2.5, -0.2), *Between(0.2, 2.5));
    case 2:
      return SphereGrid::CubeCross(size);
    case 3:
      return SphereGrid::CubeStrip(size);
    default:
      return SphereGrid::RhombicDodecahedron(size);
  }
}

double AngleBetween(const Eigen::Vector3d& a, const Eigen::Vector3d& b) {
  return std::atan2(a.cross(b).norm(), a.dot(b));
}

Eigen::Vector3d RayOfPixel(const SphereGrid& grid, GridPixel pixel) {
  return *grid.RayFromPixel(pixel.x + 0.5, pixel.y + 0.5);
}

RC_GTEST_PROP(SphereGridLaw, APointComesBackThroughItsRay, ()) {
  const SphereGrid grid = AnyGrid(1, 4096);
  const Eigen::Vector2d point(*Between(0.0, grid.width()), *Between(0.0, grid.height()));
  const auto ray = grid.RayFromPixel(point.x(), point.y());
  RC_PRE(ray.has_value());
  // A pole is one direction, whatever its column.
  RC_PRE(grid.kind() != SphereGridKind::kEquirectangular || std::abs(ray->z()) < 1.0 - 1e-9);
  RC_ASSERT(std::abs(ray->norm() - 1.0) < 1e-12);
  const auto back = grid.PixelFromRay(*ray * *Between(1e-3, 1e3));
  RC_ASSERT(back.has_value());
  double dx = std::abs(back->x() - point.x());
  if (grid.faces() == 1) dx = std::min(dx, grid.width() - dx);
  // On a border of faces the point may come back on the other face: then its ray is the same.
  const bool is_same_point = std::hypot(dx, back->y() - point.y()) < 1e-5;
  const Eigen::Vector3d again = *grid.RayFromPixel(back->x(), back->y());
  RC_ASSERT(AngleBetween(again, *ray) < 1e-9);
  const double to_tile = std::min(std::abs(std::remainder(point.x(), grid.face_width())),
                                  std::abs(std::remainder(point.y(), grid.face_height())));
  RC_ASSERT(is_same_point || to_tile < 1e-6);
}

RC_GTEST_PROP(SphereGridLaw, ARayComesBackThroughItsPoint, ()) {
  const SphereGrid grid = AnyGrid(1, 4096);
  const Eigen::Vector3d ray = testing::AnyUnitVector();
  const auto point = grid.PixelFromRay(ray);
  if (grid.kind() != SphereGridKind::kCylindrical) RC_ASSERT(point.has_value());
  RC_PRE(point.has_value());
  RC_ASSERT(point->x() >= 0.0 && point->x() < grid.width());
  RC_ASSERT(point->y() >= 0.0 && point->y() < grid.height());
  RC_ASSERT(AngleBetween(*grid.RayFromPixel(point->x(), point->y()), ray) < 1e-9);
}

RC_GTEST_PROP(SphereGridLaw, SolidAnglesAddUpToWhatIsCovered, ()) {
  const SphereGrid grid = AnyGrid(1, 40);
  double sum = 0.0;
  for (int y = 0; y < grid.height(); ++y) {
    for (int x = 0; x < grid.width(); ++x) {
      const double pixel = grid.PixelSolidAngle(x, y);
      RC_ASSERT((pixel > 0.0) == grid.FaceOfPixel(x, y).has_value());
      sum += pixel;
    }
  }
  RC_ASSERT(std::abs(sum - grid.CoveredSolidAngle()) < 1e-9);
}

RC_GTEST_PROP(SphereGridLaw, APixelsSolidAngleIsTheShareOfRaysItGets, ()) {
  const SphereGrid grid = AnyGrid(1, 3);
  std::map<std::pair<int, int>, int> hits;
  constexpr int kRays = 20'000;  // a Fibonacci spiral: even over the sphere
  for (int k = 0; k < kRays; ++k) {
    const double z = 1.0 - (2.0 * k + 1.0) / kRays;
    const double angle = kPi * (3.0 - std::sqrt(5.0)) * k;
    const double rho = std::sqrt(1.0 - z * z);
    const auto point = grid.PixelFromRay({rho * std::cos(angle), rho * std::sin(angle), z});
    if (point) ++hits[{static_cast<int>(point->x()), static_cast<int>(point->y())}];
  }
  for (const auto& [pixel, count] : hits) {
    const double expected = grid.PixelSolidAngle(pixel.first, pixel.second) / (4.0 * kPi) * kRays;
    RC_ASSERT(std::abs(count - expected) < 6.0 + 0.03 * expected);
  }
}

RC_GTEST_PROP(SphereGridLaw, NeighboursLeadBack, ()) {
  const SphereGrid grid = AnyGrid(1, 30);
  for (int y = 0; y < grid.height(); ++y) {
    for (int x = 0; x < grid.width(); ++x) {
      for (const Side side : {Side::kLeft, Side::kRight, Side::kUp, Side::kDown}) {
        const auto next = grid.Neighbour(x, y, side);
        if (!next) {
          const bool at_rim = grid.kind() == SphereGridKind::kCylindrical &&
                              (side == Side::kUp ? y == 0 : y == grid.height() - 1);
          RC_ASSERT(at_rim || !grid.FaceOfPixel(x, y));
          continue;
        }
        RC_ASSERT(grid.FaceOfPixel(next->x, next->y).has_value());
        bool leads_back = false;
        for (const Side back : {Side::kLeft, Side::kRight, Side::kUp, Side::kDown}) {
          leads_back = leads_back || grid.Neighbour(next->x, next->y, back) == GridPixel{x, y};
        }
        RC_ASSERT(leads_back);
      }
    }
  }
}

RC_GTEST_PROP(SphereGridLaw, AcrossEveryBorderPixelsAreAsNearAsInside, ()) {
  const SphereGrid grid = AnyGrid(8, 60);
  // Away from the poles of an equirectangular picture, where columns crowd.
  const auto largest_step = [&grid](bool at_border) {
    double largest = 0.0;
    for (int y = 0; y < grid.height(); ++y) {
      for (int x = 0; x < grid.width(); ++x) {
        for (const Side side : {Side::kLeft, Side::kRight, Side::kUp, Side::kDown}) {
          const auto next = grid.Neighbour(x, y, side);
          if (!next) continue;
          const bool is_inside = std::abs(next->x - x) + std::abs(next->y - y) == 1 &&
                                 grid.FaceOfPixel(next->x, next->y) == grid.FaceOfPixel(x, y);
          if (is_inside == at_border) continue;
          largest =
              std::max(largest, AngleBetween(RayOfPixel(grid, {x, y}), RayOfPixel(grid, *next)));
        }
      }
    }
    return largest;
  };
  RC_ASSERT(largest_step(true) <= 1.001 * largest_step(false));
}

// A smooth scene whose slope is nowhere more than 3 per radian.
double Scene(const Eigen::Vector3d& v) {
  return 2.0 + v.x() * v.y() + v.z() * v.z() * v.x() - 0.5 * v.y() * v.z();
}

RC_GTEST_PROP(SphereRemapLaw, ASmoothSceneComesThroughWithoutSeams, ()) {
  const SphereGrid source = AnyGrid(40, 80);
  const SphereGrid target = AnyGrid(40, 80);
  Image<float> picture(source.width(), source.height(), 1, -100.0F);
  double coarsest = 0.0;
  for (int y = 0; y < source.height(); ++y) {
    for (int x = 0; x < source.width(); ++x) {
      if (!source.FaceOfPixel(x, y)) continue;
      picture.at(x, y) = static_cast<float>(Scene(RayOfPixel(source, {x, y})));
      coarsest = std::max(coarsest, std::sqrt(source.PixelSolidAngle(x, y)));
    }
  }
  Image<float> out(target.width(), target.height());
  SphereRemapOptions options;
  options.area = false;
  SphereRemap(target, source, options).Apply(picture, out.view());
  for (int y = 0; y < target.height(); ++y) {
    for (int x = 0; x < target.width(); ++x) {
      const auto ray = target.RayFromPixel(x + 0.5, y + 0.5);
      const auto point = ray ? source.PixelFromRay(*ray) : std::nullopt;
      if (!point) {
        RC_ASSERT(std::isnan(out.at(x, y)));
        continue;
      }
      const bool at_rim = source.kind() == SphereGridKind::kCylindrical &&
                          (point->y() < 0.5 || point->y() > source.height() - 0.5);
      // Bilinear: the error falls with the square of the step, at seams as well. A rim's clamped
      // half pixel, and a seam's gathered one, may cost a part of the slope.
      const double allowed = at_rim ? 1.5 * coarsest : 2.5 * coarsest * coarsest + 1e-5;
      RC_ASSERT(std::abs(out.at(x, y) - Scene(*ray)) < allowed);
    }
  }
}

RC_GTEST_PROP(SphereRemapLaw, AConstantStaysTheSameToTheLastBitInEveryType, ()) {
  const SphereGrid source = AnyGrid(1, 24);
  const SphereGrid target = AnyGrid(1, 24);
  const auto value = *rc::gen::inRange<std::uint16_t>(0, 65535);
  const Image<std::uint16_t> flat(source.width(), source.height(), 3, value);
  Image<std::uint16_t> out(target.width(), target.height(), 3);
  const Image<float> flat_f(source.width(), source.height(), 2, value * 0.25F);
  Image<float> out_f(target.width(), target.height(), 2);
  const SphereRemap remap(target, source);
  remap.Apply(flat, out.view());
  remap.Apply(flat_f, out_f.view());
  for (int y = 0; y < target.height(); ++y) {
    for (int x = 0; x < target.width(); ++x) {
      const auto ray = target.RayFromPixel(x + 0.5, y + 0.5);
      if (ray && source.PixelFromRay(*ray)) {
        RC_ASSERT(out.at(x, y, 1) == value || std::isnan(out_f.at(x, y, 0)));
        if (std::isnan(out_f.at(x, y, 0))) continue;  // less than half of it is covered
        RC_ASSERT(std::abs(out_f.at(x, y, 1) - value * 0.25F) <= value * 1e-6F);
      } else {
        RC_ASSERT(out.at(x, y, 2) == 0);
        RC_ASSERT(std::isnan(out_f.at(x, y, 1)));
      }
    }
  }
}

}  // namespace
}  // namespace omnihdr::sphere_grid_test
