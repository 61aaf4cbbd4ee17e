#include "core/sphere/sphere_grid.h"

#include <ImathBox.h>
#include <OpenEXR/ImfEnvmap.h>
#include <gtest/gtest.h>

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <string>
#include <utility>

namespace omnihdr::sphere_grid_test {
namespace {

using Eigen::Vector3d;

// Largest over smallest solid angle of a grid's pixels.
double Unevenness(const SphereGrid& grid) {
  double least = 1e9;
  double largest = 0.0;
  for (int y = 0; y < grid.height(); ++y) {
    for (int x = 0; x < grid.width(); ++x) {
      if (!grid.FaceOfPixel(x, y)) continue;
      const double pixel = grid.PixelSolidAngle(x, y);
      least = std::min(least, pixel);
      largest = std::max(largest, pixel);
    }
  }
  return largest / least;
}

TEST(SphereGrid, RdMapIsMoreEvenThanAnyOtherProjection) {
  // Limits for fine grids; the literature's: 3√3 for a gnomonic cube, 2√2 for a gnomonic rhombic
  // dodecahedron. Skew great circles: 9/(4√2), from the middle of a face to its four-valent corner.
  const double rd = Unevenness(SphereGrid::RhombicDodecahedron(128));
  const double cube = Unevenness(SphereGrid::CubeStrip(128));
  const double latlong = Unevenness(SphereGrid::Equirectangular(512, 256));
  RecordProperty("rd_map", std::to_string(rd));
  RecordProperty("cube", std::to_string(cube));
  RecordProperty("equirectangular", std::to_string(latlong));
  EXPECT_NEAR(rd, 9.0 / (4.0 * std::sqrt(2.0)), 0.02);
  EXPECT_NEAR(cube, 3.0 * std::sqrt(3.0), 0.1);
  EXPECT_LT(rd, 2.0 * std::sqrt(2.0));
  EXPECT_GT(latlong, 100.0);
}

// Mean and worst of longest over shortest edge of the pixels: 1 is a rhombus with equal sides.
TEST(SphereGrid, RdMapPixelsAreNotStretched) {
  const SphereGrid grid = SphereGrid::RhombicDodecahedron(32);
  double worst = 1.0;
  for (int y = 0; y < 32; ++y) {
    for (int x = 0; x < 32; ++x) {
      const double u = x;
      const double v = y;
      const Vector3d across =
          grid.RayFromFace({0, u + 1.0, v + 0.5}) - grid.RayFromFace({0, u, v + 0.5});
      const Vector3d down =
          grid.RayFromFace({0, u + 0.5, v + 1.0}) - grid.RayFromFace({0, u + 0.5, v});
      worst = std::max({worst, across.norm() / down.norm(), down.norm() / across.norm()});
    }
  }
  EXPECT_LT(worst, 1.25);
}

TEST(SphereGrid, RdMapFacesLieWhereTheConventionSays) {
  const SphereGrid grid = SphereGrid::RhombicDodecahedron(384);
  EXPECT_EQ(grid.width(), 1536);
  EXPECT_EQ(grid.height(), 1152);
  const std::array<Vector3d, 12> centres = {{{1, 1, 0},
                                             {-1, 1, 0},
                                             {-1, -1, 0},
                                             {1, -1, 0},
                                             {1, 0, 1},
                                             {0, 1, 1},
                                             {-1, 0, 1},
                                             {0, -1, 1},
                                             {1, 0, -1},
                                             {0, 1, -1},
                                             {-1, 0, -1},
                                             {0, -1, -1}}};
  for (int face = 0; face < 12; ++face) {
    const double x = 384.0 * (face % 4) + 192.0;
    const double y = 384.0 * (face / 4) + 192.0;
    const Vector3d expected = centres[static_cast<std::size_t>(face)].normalized();
    EXPECT_LT((*grid.RayFromPixel(x, y) - expected).norm(), 1e-12) << "face " << face;
  }
  // The corners of face 0 (+X, +Y): n(s) and m(t) written out from conventions' formulas.
  const Vector3d three_valent = Vector3d(1, 1, 1).normalized();
  EXPECT_LT((grid.RayFromFace({0, 0.0, 0.0}) - Vector3d(1, 0, 0)).norm(), 1e-12);
  EXPECT_LT((grid.RayFromFace({0, 384.0, 384.0}) - Vector3d(0, 1, 0)).norm(), 1e-12);
  EXPECT_LT((grid.RayFromFace({0, 0.0, 384.0}) - three_valent).norm(), 1e-12);
}

TEST(SphereGrid, RdMapRaysAreTheConventionsCrossProducts) {
  const SphereGrid grid = SphereGrid::RhombicDodecahedron(8);
  const Vector3d a = Vector3d::UnitY();  // face 7: (−Y, +Z)
  const Vector3d b = Vector3d::UnitZ();
  const Vector3d a7 = -a;
  const Vector3d c = a7.cross(b);
  const auto slerp = [](const Vector3d& p, const Vector3d& q, double s) {
    const double angle = std::acos(p.dot(q));
    return Vector3d((std::sin((1.0 - s) * angle) * p + std::sin(s * angle) * q) / std::sin(angle));
  };
  const double r = std::sqrt(0.5);
  for (int i = 0; i < 8; ++i) {
    for (int j = 0; j < 8; ++j) {
      const double s = (j + 0.5) / 8.0;
      const double t = (i + 0.5) / 8.0;
      const Vector3d n = slerp((c - b) * r, (c + a7) * r, s);
      const Vector3d m = slerp((b + c) * r, (c - a7) * r, t);
      Vector3d ray = n.cross(m).normalized();
      if (ray.dot(a7 + b) < 0.0) ray = -ray;
      const Vector3d got = *grid.RayFromPixel(8 * 3 + j + 0.5, 8 * 1 + i + 0.5);
      EXPECT_LT((got - ray).norm(), 1e-12) << i << ", " << j;
    }
  }
}

TEST(SphereGrid, TheCrossUnfoldsTheCubeAroundTheForwardFace) {
  const SphereGrid grid = SphereGrid::CubeCross(10);
  EXPECT_EQ(grid.width(), 40);
  EXPECT_EQ(grid.height(), 30);
  const auto at = [&grid](double x, double y) { return grid.RayFromPixel(x, y); };
  EXPECT_LT((*at(15, 15) - Vector3d(1, 0, 0)).norm(), 1e-12);   // F
  EXPECT_LT((*at(5, 15) - Vector3d(0, 1, 0)).norm(), 1e-12);    // L: +Y
  EXPECT_LT((*at(25, 15) - Vector3d(0, -1, 0)).norm(), 1e-12);  // R
  EXPECT_LT((*at(35, 15) - Vector3d(-1, 0, 0)).norm(), 1e-12);  // B
  EXPECT_LT((*at(15, 5) - Vector3d(0, 0, 1)).norm(), 1e-12);    // U
  EXPECT_LT((*at(15, 25) - Vector3d(0, 0, -1)).norm(), 1e-12);  // D
  for (const auto& [x, y] : {std::pair{5, 5}, {25, 5}, {35, 5}, {5, 25}, {25, 25}, {35, 25}}) {
    EXPECT_FALSE(at(x, y)) << x << ", " << y;
    EXPECT_FALSE(grid.FaceOfPixel(x, y));
    EXPECT_EQ(grid.PixelSolidAngle(x, y), 0.0);
    EXPECT_FALSE(grid.Neighbour(x, y, Side::kLeft));
  }
  // Along the four faces and over the forward face the picture is of one piece: no turn or mirror.
  for (int y = 0; y < 30; ++y) {
    for (int x = 0; x + 1 < 40; ++x) {
      if (!grid.FaceOfPixel(x, y) || !grid.FaceOfPixel(x + 1, y)) continue;
      EXPECT_EQ(grid.Neighbour(x, y, Side::kRight), (GridPixel{x + 1, y}));
    }
  }
  for (int y = 0; y + 1 < 30; ++y) {
    for (int x = 10; x < 20; ++x) {
      EXPECT_EQ(grid.Neighbour(x, y, Side::kDown), (GridPixel{x, y + 1}));
    }
  }
  EXPECT_EQ(grid.Neighbour(39, 14, Side::kRight), (GridPixel{0, 14}));  // round the back
}

TEST(SphereGrid, TheStripIsOpenExrsCubeMap) {
  constexpr int kSize = 16;
  const SphereGrid grid = SphereGrid::CubeStrip(kSize);
  const Imath::Box2i window({0, 0}, {kSize - 1, 6 * kSize - 1});
  for (int face = 0; face < 6; ++face) {
    const auto imf_face = static_cast<Imf::CubeMapFace>(face);
    for (int v = 0; v < kSize; ++v) {
      for (int u = 0; u < kSize; ++u) {
        // OpenEXR puts the face's edges on the centres of its outer pixels.
        const Imath::V2f in_face(static_cast<float>(u), static_cast<float>(v));
        const Imath::V3f there = Imf::CubeMap::direction(imf_face, window, in_face);
        const Imath::V2f pixel = Imf::CubeMap::pixelPosition(imf_face, window, in_face);
        const double x = pixel.x / (kSize - 1.0) * kSize;
        const double y = (pixel.y - face * kSize) / (kSize - 1.0) * kSize;
        const Vector3d expected = Vector3d(there.z, there.x, there.y).normalized();
        EXPECT_LT((grid.RayFromFace({face, x, y}) - expected).norm(), 1e-6)
            << "face " << face << " at " << x << ", " << y;
      }
    }
  }
}

TEST(SphereGrid, LatLongIsOpenExrsLatLongMap) {
  const SphereGrid grid = SphereGrid::Equirectangular(64, 32);
  const Imath::Box2i window({0, 0}, {64, 32});  // so that its edges are the picture's
  for (int y = 1; y < 32; ++y) {
    for (int x = 0; x < 64; ++x) {
      const Imath::V3f there = Imf::LatLongMap::direction(
          window, Imath::V2f(static_cast<float>(x), static_cast<float>(y)));
      const Vector3d expected(there.z, there.x, there.y);
      EXPECT_LT((*grid.RayFromPixel(x, y) - expected).norm(), 1e-6) << x << ", " << y;
    }
  }
}

TEST(SphereGrid, HasNoPointForWhatIsNoDirection) {
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  constexpr double kInf = std::numeric_limits<double>::infinity();
  for (const SphereGrid& grid :
       {SphereGrid::Equirectangular(8, 4), SphereGrid::Cylindrical(8, 4, -1, 1),
        SphereGrid::CubeCross(4), SphereGrid::CubeStrip(4), SphereGrid::RhombicDodecahedron(4)}) {
    EXPECT_FALSE(grid.PixelFromRay({0, 0, 0})) << ToString(grid.kind());
    EXPECT_FALSE(grid.PixelFromRay({kNan, 1, 0})) << ToString(grid.kind());
    EXPECT_FALSE(grid.PixelFromRay({1, 0, kNan})) << ToString(grid.kind());
    EXPECT_FALSE(grid.PixelFromRay({0, kInf, 0})) << ToString(grid.kind());
    EXPECT_TRUE(grid.PixelFromRay({1e-200, 1e-200, 0})) << ToString(grid.kind());
    EXPECT_FALSE(grid.RayFromPixel(-0.1, 1)) << ToString(grid.kind());
    EXPECT_FALSE(grid.RayFromPixel(kNan, 1)) << ToString(grid.kind());
    EXPECT_FALSE(grid.RayFromPixel(1, grid.height() + 0.1)) << ToString(grid.kind());
  }
}

TEST(SphereGrid, RefusesPicturesOfTheWrongShapeByName) {
  const auto message = [](SphereGridKind kind, int width, int height) {
    const Result<SphereGrid> grid = SphereGrid::OfPicture(kind, width, height);
    return grid ? std::string("accepted") : grid.error().message;
  };
  EXPECT_EQ(message(SphereGridKind::kEquirectangular, 64, 31),
            "64x31 pixels, expected a lat-long panorama of 2NxN");
  EXPECT_EQ(message(SphereGridKind::kCubeCross, 64, 64),
            "64x64 pixels, expected a cross of cube faces of 4Nx3N");
  EXPECT_EQ(message(SphereGridKind::kCubeStrip, 64, 383),
            "64x383 pixels, expected six cube faces one below the other of 1Nx6N");
  EXPECT_EQ(message(SphereGridKind::kRhombicDodecahedron, 40, 33),
            "40x33 pixels, expected an RD-map of rhombic faces of 4Nx3N");
  EXPECT_EQ(message(SphereGridKind::kCubeCross, 0, 0), "0x0 pixels, expected at least 1x1");
  EXPECT_EQ(message(SphereGridKind::kRhombicDodecahedron, 1536, 1152), "accepted");
  EXPECT_FALSE(SphereGrid::OfPicture(SphereGridKind::kCylindrical, 64, 32, 1.0, -1.0));
  constexpr double kHuge = std::numeric_limits<double>::max();
  constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
  EXPECT_FALSE(SphereGrid::OfPicture(SphereGridKind::kCylindrical, 64, 32, -kHuge, kHuge));
  EXPECT_FALSE(SphereGrid::OfPicture(SphereGridKind::kCylindrical, 64, 32, kNan, 1.0));
  const auto cylinder = SphereGrid::OfPicture(SphereGridKind::kCylindrical, 1536, 1152);
  ASSERT_TRUE(cylinder);
  EXPECT_NEAR(cylinder->z_max(), 2.356, 1e-3);  // the thesis's cylinder
  EXPECT_NEAR(cylinder->z_min(), -2.356, 1e-3);
}

TEST(SphereGrid, NamesComeBack) {
  for (const SphereGridKind kind :
       {SphereGridKind::kEquirectangular, SphereGridKind::kCylindrical, SphereGridKind::kCubeCross,
        SphereGridKind::kCubeStrip, SphereGridKind::kRhombicDodecahedron}) {
    EXPECT_EQ(SphereGridKindFromString(ToString(kind)), kind);
  }
  EXPECT_FALSE(SphereGridKindFromString("mercator"));
}

TEST(SphereGrid, AsFineAsMeansPixelsOfTheSameSize) {
  const SphereGrid source = SphereGrid::Equirectangular(2048, 1024);
  const double equator = source.PixelSolidAngle(0, 512);
  for (const SphereGridKind kind : {SphereGridKind::kCubeCross, SphereGridKind::kCubeStrip,
                                    SphereGridKind::kRhombicDodecahedron}) {
    const SphereGrid grid = GridAsFineAs(source, kind, 0.0, 0.0);
    double coarsest = 0.0;
    for (int y = 0; y < grid.face_height(); ++y) {
      const GridPixel face = grid.FaceOrigin(0);
      coarsest =
          std::max(coarsest, grid.PixelSolidAngle(face.x + grid.face_width() / 2, face.y + y));
    }
    EXPECT_NEAR(coarsest / equator, 1.0, 0.01) << ToString(kind);
    const SphereGrid back = GridAsFineAs(grid, SphereGridKind::kEquirectangular, 0.0, 0.0);
    EXPECT_NEAR(back.width(), 2048, 4) << ToString(kind);
    EXPECT_EQ(back.width(), 2 * back.height());
  }
  const SphereGrid cylinder = GridAsFineAs(source, SphereGridKind::kCylindrical, -2.356, 2.356);
  EXPECT_EQ(cylinder.width(), 2048);
  EXPECT_EQ(cylinder.height(), 1536);
}

}  // namespace
}  // namespace omnihdr::sphere_grid_test
