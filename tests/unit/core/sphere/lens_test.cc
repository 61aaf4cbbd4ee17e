#include "core/sphere/lens.h"

#include <gmock/gmock.h>
#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>
#include <random>

namespace omnihdr::lens_test {
namespace {

using ::testing::HasSubstr;

constexpr double kPi = std::numbers::pi;
constexpr double kDegree = kPi / 180.0;
constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr std::array<double, 5> kNone{};

// A wide barrel lens with some tangential error.
const std::array<double, 5> kBrown = {-0.28, 0.09, 0.0012, -0.0008, -0.012};
// Lens 1 of a consumer 360° camera.
const std::array<double, 5> kBrandt = {-4.9961069651427874e-02, -1.8462554546845877e-03,
                                       2.6920963465017350e-03, -1.1531536547291932e-03, 0.0};

Lens PinholeLens() {
  return *Lens::Pinhole(1024, 768, {400, 410}, {505, 390}, kBrown, 55 * kDegree);
}
Lens FisheyeLens() {
  return *Lens::Fisheye(1600, 1088, {547.4, 546.1}, {810, 552}, kBrandt, 95 * kDegree);
}

Eigen::Vector3d RayAt(double angle, double azimuth) {
  return {std::sin(angle) * std::cos(azimuth), std::sin(angle) * std::sin(azimuth),
          std::cos(angle)};
}

// Grids of a pinhole lens: rectified picture twice as large as the sensor.
struct Grids {
  LensGrid raw_from_rectified;
  LensGrid rectified_from_raw;
};
constexpr double kRectifiedFocal = 500.0;
const Eigen::Vector2d kRectifiedCentre(1000.0, 800.0);

Grids GridsOf(const Lens& lens, double step) {
  Grids grids;
  LensGrid& raw = grids.raw_from_rectified;
  raw.columns = static_cast<int>(2000 / step) + 1;
  raw.rows = static_cast<int>(1600 / step) + 1;
  raw.step_x = raw.step_y = step;
  const Eigen::Vector2f nothing = Eigen::Vector2f::Constant(std::nanf(""));
  for (int i = 0; i < raw.rows; ++i) {
    for (int j = 0; j < raw.columns; ++j) {
      const Eigen::Vector2d p =
          (Eigen::Vector2d(j * step, i * step) - kRectifiedCentre) / kRectifiedFocal;
      const auto pixel = lens.PixelFromRay({p.x(), p.y(), 1.0});
      raw.points.emplace_back(pixel ? pixel->cast<float>() : nothing);
    }
  }
  LensGrid& back = grids.rectified_from_raw;
  back.columns = static_cast<int>(lens.width() / step) + 1;
  back.rows = static_cast<int>(lens.height() / step) + 1;
  back.step_x = back.step_y = step;
  for (int i = 0; i < back.rows; ++i) {
    for (int j = 0; j < back.columns; ++j) {
      const auto ray = lens.RayFromPixel(j * step, i * step);
      back.points.emplace_back(
          ray ? Eigen::Vector2f(
                    (ray->head<2>() / ray->z() * kRectifiedFocal + kRectifiedCentre).cast<float>())
              : nothing);
    }
  }
  return grids;
}

Lens GridLens(double step = 8.0) {
  Grids grids = GridsOf(PinholeLens(), step);
  return *Lens::Grid(1024, 768, Eigen::Vector2d::Constant(kRectifiedFocal), kRectifiedCentre,
                     grids.raw_from_rectified, grids.rectified_from_raw);
}

TEST(Lens, KindsHaveNamesThatReadBack) {
  for (const LensKind kind : {LensKind::kPinhole, LensKind::kFisheye, LensKind::kGrid}) {
    EXPECT_EQ(LensKindFromString(ToString(kind)), kind);
  }
  EXPECT_EQ(LensKindFromString("Pinhole"), std::nullopt);
}

TEST(Lens, TheAxisFallsOnTheCentreAndXGoesRightAndYDown) {
  for (const Lens& lens : {PinholeLens(), FisheyeLens(), GridLens()}) {
    const Eigen::Vector2d axis = *lens.PixelFromRay({0.0, 0.0, 3.0});
    const Eigen::Vector2d right = *lens.PixelFromRay({0.1, 0.0, 1.0});
    const Eigen::Vector2d down = *lens.PixelFromRay({0.0, 0.1, 1.0});
    EXPECT_GT(right.x(), axis.x() + 20.0);
    EXPECT_GT(down.y(), axis.y() + 20.0);
    if (lens.kind() != LensKind::kGrid) {
      EXPECT_LT((axis - lens.centre()).norm(), 1e-9);
    }
  }
}

// By hand from the published equations, OpenCV's pixel (u, v) being (x - 0.5, y - 0.5) here:
// x' = 0.5, y' = -0.25, r² = 0.3125.
TEST(Lens, APinholeFollowsBrownsEquations) {
  const Eigen::Vector2d pixel = *PinholeLens().PixelFromRay({0.5, -0.25, 1.0});
  const double radial =
      1.0 - 0.28 * 0.3125 + 0.09 * 0.3125 * 0.3125 - 0.012 * 0.3125 * 0.3125 * 0.3125;
  const double x = 0.5 * radial + 2.0 * 0.0012 * 0.5 * -0.25 - 0.0008 * (0.3125 + 2.0 * 0.25);
  const double y = -0.25 * radial + 0.0012 * (0.3125 + 2.0 * 0.0625) - 2.0 * 0.0008 * 0.5 * -0.25;
  EXPECT_NEAR(pixel.x(), 400.0 * x + 505.0, 1e-9);
  EXPECT_NEAR(pixel.y(), 410.0 * y + 390.0, 1e-9);
}

// The factory file of the lens states half its field of view, 102°, and the radius of the image
// circle there, 772.245 pixels.
TEST(Lens, AFisheyeReachesTheImageCircleItsMakerStates) {
  // The curve is flat there and turns half a degree before.
  const double limit = 0.9999 * Lens::UnfoldedAngle(LensKind::kFisheye, kBrandt, 102.0 * kDegree);
  const Lens lens = *Lens::Fisheye(1600, 1088, {547.38169247087342, 547.38169247087342}, {800, 544},
                                   kBrandt, limit);
  const Eigen::Vector2d edge = *lens.PixelFromRay(RayAt(limit, 0.0));
  const double t = limit;
  const double by_hand = t + kBrandt[0] * std::pow(t, 3) + kBrandt[1] * std::pow(t, 5) +
                         kBrandt[2] * std::pow(t, 7) + kBrandt[3] * std::pow(t, 9);
  EXPECT_NEAR(edge.x() - 800.0, 547.38169247087342 * by_hand, 1e-9);
  EXPECT_NEAR(edge.x() - 800.0, 772.245, 0.1);
}

TEST(Lens, EveryPixelComesBackThroughItsRay) {
  std::mt19937 generator(7);
  for (const Lens& lens : {PinholeLens(), FisheyeLens(), GridLens()}) {
    std::uniform_real_distribution<double> x(0.0, lens.width());
    std::uniform_real_distribution<double> y(0.0, lens.height());
    int rays = 0;
    for (int k = 0; k < 20000; ++k) {
      const Eigen::Vector2d pixel(x(generator), y(generator));
      const auto ray = lens.RayFromPixel(pixel.x(), pixel.y());
      if (!ray) continue;
      ASSERT_NEAR(ray->norm(), 1.0, 1e-12);
      const auto back = lens.PixelFromRay(*ray * 5.0);
      if (!back && lens.kind() == LensKind::kGrid) continue;  // a rim node has no neighbour
      // On the rim of the field rounding may lose the ray.
      if (!back) {
        EXPECT_GT(std::acos(ray->z()), lens.max_angle() - 1e-9);
        continue;
      }
      ++rays;
      ASSERT_LT((*back - pixel).norm(), 1e-6) << ToString(lens.kind()) << " " << pixel.transpose();
    }
    EXPECT_GT(rays, 12000) << ToString(lens.kind());
  }
}

TEST(Lens, EveryRayComesBackUpToTheRimOfTheField) {
  for (const Lens& lens : {PinholeLens(), FisheyeLens()}) {
    int seen = 0;
    for (int a = 0; a <= 400; ++a) {
      for (int k = 0; k < 36; ++k) {
        const Eigen::Vector3d ray =
            RayAt(a / 400.0 * lens.max_angle() * (1.0 - 1e-12), 10.0 * k * kDegree);
        const auto pixel = lens.PixelFromRay(ray);
        if (!pixel) continue;
        ++seen;
        const auto back = lens.RayFromPixel(pixel->x(), pixel->y());
        ASSERT_TRUE(back) << a << " " << k;
        // At the rim the fisheye's curve is flat: a pixel's rounding is worth more angle there.
        ASSERT_LT((*back - ray).norm(), 1e-9) << a << " " << k;
      }
    }
    EXPECT_GT(seen, 5000);
  }
}

TEST(Lens, ARayOutsideTheFieldOrTheImageHasNoPixel) {
  const Lens pinhole = PinholeLens();
  EXPECT_FALSE(pinhole.PixelFromRay({0.0, 0.0, -1.0}));
  EXPECT_FALSE(pinhole.PixelFromRay({0.0, 0.0, 0.0}));
  EXPECT_FALSE(pinhole.PixelFromRay({kNan, 0.0, 1.0}));
  EXPECT_FALSE(pinhole.PixelFromRay(RayAt(56 * kDegree, 0.0)));
  EXPECT_FALSE(pinhole.PixelFromRay({-0.1, 0.0, -1.0}));
  const Lens fisheye = FisheyeLens();
  EXPECT_TRUE(fisheye.PixelFromRay(RayAt(91 * kDegree, 0.0)));
  EXPECT_FALSE(fisheye.PixelFromRay(RayAt(95.1 * kDegree, 0.0)));
  EXPECT_FALSE(fisheye.PixelFromRay(RayAt(91 * kDegree, 90 * kDegree)));  // below the picture
}

TEST(Lens, APixelOutsideTheFieldOrTheImageHasNoRay) {
  for (const Lens& lens : {PinholeLens(), FisheyeLens(), GridLens()}) {
    EXPECT_FALSE(lens.RayFromPixel(-0.1, 10.0));
    EXPECT_FALSE(lens.RayFromPixel(10.0, lens.height() + 0.1));
    EXPECT_FALSE(lens.RayFromPixel(kNan, 10.0));
  }
  // Corners of the fisheye's picture lie outside its image circle.
  EXPECT_FALSE(FisheyeLens().RayFromPixel(1.0, 1.0));
}

TEST(Lens, AGridAgreesWithTheLensItWasSampledFrom) {
  const Lens truth = PinholeLens();
  const Lens grid = GridLens(8.0);
  int compared = 0;
  for (double x = 40.0; x < 1000.0; x += 13.7) {
    for (double y = 40.0; y < 730.0; y += 11.3) {
      const auto expected = truth.RayFromPixel(x, y);
      const auto ray = grid.RayFromPixel(x, y);
      if (!expected || !ray) continue;
      ++compared;
      // 8-pixel bilinear steps of a smooth lens: some hundredths of a pixel of 1/400 rad.
      ASSERT_LT((*ray - *expected).norm() * 400.0, 0.02) << x << " " << y;
    }
  }
  EXPECT_GT(compared, 3000);
  EXPECT_NEAR(grid.max_angle(), truth.max_angle(), 2.0 * kDegree);
}

TEST(Lens, ADistortionThatFoldsBackIsRefusedWithTheAngle) {
  const auto fisheye = Lens::Fisheye(1600, 1088, {547, 547}, {800, 544}, kBrandt, 102 * kDegree);
  ASSERT_FALSE(fisheye);
  EXPECT_EQ(fisheye.error().kind, ErrorKind::kData);
  EXPECT_THAT(fisheye.error().message, HasSubstr("folds back 101"));
  // 1 - 3·0.4·r² = 0 at r = 0.913.
  const auto pinhole =
      Lens::Pinhole(640, 480, {300, 300}, {320, 240}, {-0.4, 0, 0, 0, 0}, 44 * kDegree);
  ASSERT_FALSE(pinhole);
  EXPECT_THAT(pinhole.error().message, HasSubstr("folds back 42"));
  EXPECT_TRUE(Lens::Pinhole(640, 480, {300, 300}, {320, 240}, {-0.4, 0, 0, 0, 0}, 42 * kDegree));
}

TEST(Lens, TheUnfoldedAngleIsWhereTheCurveTurns) {
  // θ - θ³/3 turns at θ = 1; its slope 1 - θ² is a hundredth at √0.99.
  EXPECT_NEAR(Lens::UnfoldedAngle(LensKind::kFisheye, {-1.0 / 3.0, 0, 0, 0, 0}, 2.0),
              std::sqrt(0.99), 1e-12);
  EXPECT_EQ(Lens::UnfoldedAngle(LensKind::kFisheye, kNone, 2.0), 2.0);
  // A dip that comes back up is found too: slope 1 - 2.4s + 1.5s² with s = θ² is negative between.
  EXPECT_LT(Lens::UnfoldedAngle(LensKind::kFisheye, {-0.9, 0.34, 0, 0, 0}, 2.5), 1.0);
}

TEST(Lens, ParametersThatMakeNoLensAreRefusedByName) {
  const auto message = [](const Result<Lens>& lens) {
    EXPECT_FALSE(lens);
    return lens ? std::string() : lens.error().message;
  };
  const double a = 40 * kDegree;
  EXPECT_THAT(message(Lens::Pinhole(0, 768, {400, 400}, {500, 400}, kNone, a)), HasSubstr("size"));
  EXPECT_THAT(message(Lens::Pinhole(1024, 1 << 20, {400, 400}, {500, 400}, kNone, a)),
              HasSubstr("size"));
  EXPECT_THAT(message(Lens::Pinhole(1024, 768, {400, 0}, {500, 400}, kNone, a)),
              HasSubstr("focal"));
  EXPECT_THAT(message(Lens::Pinhole(1024, 768, {400, kNan}, {500, 400}, kNone, a)),
              HasSubstr("focal"));
  EXPECT_THAT(message(Lens::Fisheye(1024, 768, {400, 400}, {kNan, 400}, kNone, a)),
              HasSubstr("centre"));
  EXPECT_THAT(message(Lens::Fisheye(1024, 768, {400, 400}, {500, 400}, {0, kNan, 0, 0, 0}, a)),
              HasSubstr("distortion"));
  EXPECT_THAT(message(Lens::Pinhole(1024, 768, {400, 400}, {500, 400}, kNone, 90 * kDegree)),
              HasSubstr("field of view"));
  EXPECT_THAT(message(Lens::Fisheye(1024, 768, {400, 400}, {500, 400}, kNone, kPi)),
              HasSubstr("field of view"));
  EXPECT_THAT(message(Lens::Fisheye(1024, 768, {400, 400}, {500, 400}, kNone, kNan)),
              HasSubstr("field of view"));
  EXPECT_THAT(message(Lens::Pinhole(1024, 768, {400, 400}, {500, 400}, {0, 0, 0.3, 0, 0}, a)),
              HasSubstr("p1"));
}

TEST(Lens, GridsThatDoNotUndoEachOtherAreRefused) {
  const Grids good = GridsOf(PinholeLens(), 16.0);
  const Eigen::Vector2d focal = Eigen::Vector2d::Constant(kRectifiedFocal);
  const auto message = [&](const Grids& grids) {
    const auto lens = Lens::Grid(1024, 768, focal, kRectifiedCentre, grids.raw_from_rectified,
                                 grids.rectified_from_raw);
    EXPECT_FALSE(lens);
    return lens ? std::string() : lens.error().message;
  };
  Grids exchanged = good;
  for (Eigen::Vector2f& p : exchanged.rectified_from_raw.points) std::swap(p.x(), p.y());
  EXPECT_THAT(message(exchanged), HasSubstr("do not undo each other"));
  Grids empty = good;
  for (Eigen::Vector2f& p : empty.raw_from_rectified.points) p.setConstant(std::nanf(""));
  EXPECT_THAT(message(empty), HasSubstr("no node has a point"));
  Grids elsewhere = good;
  for (Eigen::Vector2f& p : elsewhere.raw_from_rectified.points) p.array() += 5000.0F;
  EXPECT_THAT(message(elsewhere), HasSubstr("no point in common"));
  Grids lost = good;
  lost.raw_from_rectified.points.pop_back();
  EXPECT_THAT(message(lost), HasSubstr("nodes, expected"));
  Grids flat = good;
  flat.rectified_from_raw.step_y = 0.0;
  EXPECT_THAT(message(flat), HasSubstr("step"));
  Grids single = good;
  single.rectified_from_raw.rows = 1;
  EXPECT_THAT(message(single), HasSubstr("at least 2"));
}

}  // namespace
}  // namespace omnihdr::lens_test
