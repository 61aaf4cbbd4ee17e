#include "core/sphere/sphere_grid.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

namespace omnihdr {
namespace {

using Eigen::Vector3d;

constexpr double kPi = std::numbers::pi;
constexpr double kSteepest = 1000.0;      // tangent of the elevation at a cylinder's rim
constexpr double kFaceAngle = kPi / 3.0;  // between opposite edges of a rhombus

struct Axis {
  int index = 0;
  int sign = 1;
};

constexpr Axis kForward = {0, 1};
constexpr Axis kBack = {0, -1};
constexpr Axis kLeftward = {1, 1};
constexpr Axis kRightward = {1, -1};
constexpr Axis kUpward = {2, 1};
constexpr Axis kDownward = {2, -1};

double Along(Axis axis, const Vector3d& v) { return axis.sign * v[axis.index]; }
void Add(Axis axis, double amount, Vector3d* v) { (*v)[axis.index] += axis.sign * amount; }

// A face of the cube as seen from inside, and its place among the tiles of the picture.
struct CubeFace {
  Axis centre;
  Axis right;
  Axis down;
  int column = 0;
  int row = 0;
};

constexpr std::array<CubeFace, 6> kCross = {{
    {kUpward, kRightward, kForward, 1, 0},
    {kLeftward, kForward, kDownward, 0, 1},
    {kForward, kRightward, kDownward, 1, 1},
    {kRightward, kBack, kDownward, 2, 1},
    {kBack, kLeftward, kDownward, 3, 1},
    {kDownward, kRightward, kBack, 1, 2},
}};

// OpenEXR's +X −X +Y −Y +Z −Z, whose X Y Z are our Y Z X (ImfEnvmap.h: +Y up, the middle of a
// lat-long map looks along +Z, its left quarter along +X).
constexpr std::array<CubeFace, 6> kStrip = {{
    {kLeftward, kForward, kDownward, 0, 0},
    {kRightward, kBack, kDownward, 0, 1},
    {kUpward, kLeftward, kBack, 0, 2},
    {kDownward, kLeftward, kForward, 0, 3},
    {kForward, kRightward, kDownward, 0, 4},
    {kBack, kLeftward, kDownward, 0, 5},
}};

const std::array<CubeFace, 6>& CubeFaces(SphereGridKind kind) {
  return kind == SphereGridKind::kCubeCross ? kCross : kStrip;
}

// The axes a and b of a rhombus; c = a × b, the centre lies between a and b.
struct Rhombus {
  Axis a;
  Axis b;
};

constexpr std::array<Rhombus, 12> kRhombi = {{
    {kForward, kLeftward},
    {kLeftward, kBack},
    {kBack, kRightward},
    {kRightward, kForward},
    {kForward, kUpward},
    {kLeftward, kUpward},
    {kBack, kUpward},
    {kRightward, kUpward},
    {kForward, kDownward},
    {kLeftward, kDownward},
    {kBack, kDownward},
    {kRightward, kDownward},
}};

constexpr Axis Cross(Axis a, Axis b) {
  const int index = 3 - a.index - b.index;
  const int cyclic = (a.index + 1) % 3 == b.index ? 1 : -1;
  return {index, a.sign * b.sign * cyclic};
}

// The ray at (s, t) is n(s) × m(t), n and m the great circles' normals, written out in (a, b, c).
Vector3d RhombusRay(const Rhombus& face, double s, double t) {
  const double p = std::sin((1.0 - s) * kFaceAngle);
  const double q = std::sin(s * kFaceAngle);
  const double u = std::sin((1.0 - t) * kFaceAngle);
  const double v = std::sin(t * kFaceAngle);
  Vector3d ray = Vector3d::Zero();
  Add(face.a, p * (u + v) + (p + q) * u, &ray);
  Add(face.b, (p + q) * v + q * (u + v), &ray);
  Add(Cross(face.a, face.b), p * v - q * u, &ray);
  return ray.normalized();
}

// Where the great circle of the pencil that holds a ray lies between the first and the last one;
// d0 and d1 are the ray's distances from those two.
double PencilPosition(double d0, double d1) {
  static const double sine = std::sin(kFaceAngle);
  return std::atan2(sine * d0, 0.5 * d0 - d1) / kFaceAngle;
}

double TriangleSolidAngle(const Vector3d& a, const Vector3d& b, const Vector3d& c) {
  // Differences of the corners keep the digits that the triple product of near directions loses.
  const double volume = a.dot((b - a).cross(c - a));
  return 2.0 * std::atan2(std::abs(volume), 1.0 + a.dot(b) + b.dot(c) + c.dot(a));
}

struct Edge {
  int face = 0;
  Side side = Side::kLeft;
  bool reversed = false;  // whether the counting along the edge turns round
};

struct EdgeTable {
  std::array<std::array<Edge, 4>, 12> edges;
};

constexpr std::array<Side, 4> kSides = {Side::kLeft, Side::kRight, Side::kUp, Side::kDown};

// A point of a face of size 1, at `along` of a side and `beyond` outside it.
FacePoint PointAtSide(int face, Side side, double along, double beyond) {
  switch (side) {
    case Side::kLeft:
      return {face, -beyond, along};
    case Side::kRight:
      return {face, 1.0 + beyond, along};
    case Side::kUp:
      return {face, along, -beyond};
    case Side::kDown:
      return {face, along, 1.0 + beyond};
  }
  return {};
}

// Which edges meet, by stepping over each of them. Faces mirror each other at their common edge, so
// that pixel k meets pixel k or the k-th from the end.
EdgeTable FindEdges(const SphereGrid& unit) {
  EdgeTable table;
  for (int face = 0; face < unit.faces(); ++face) {
    for (const Side side : kSides) {
      const auto landed = unit.FaceFromRay(unit.RayFromFace(PointAtSide(face, side, 0.3, 0.01)));
      const std::array<double, 4> gap = {landed->x, 1.0 - landed->x, landed->y, 1.0 - landed->y};
      const auto nearest = std::min_element(gap.begin(), gap.end()) - gap.begin();
      Edge& edge = table.edges[static_cast<std::size_t>(face)][static_cast<std::size_t>(side)];
      edge.face = landed->face;
      edge.side = kSides[static_cast<std::size_t>(nearest)];
      edge.reversed = (nearest < 2 ? landed->y : landed->x) > 0.5;
    }
  }
  return table;
}

const Edge& EdgeAt(SphereGridKind kind, int face, Side side) {
  static const EdgeTable cross = FindEdges(SphereGrid::CubeCross(1));
  static const EdgeTable strip = FindEdges(SphereGrid::CubeStrip(1));
  static const EdgeTable rhombi = FindEdges(SphereGrid::RhombicDodecahedron(1));
  const EdgeTable& table = kind == SphereGridKind::kCubeCross   ? cross
                           : kind == SphereGridKind::kCubeStrip ? strip
                                                                : rhombi;
  return table.edges[static_cast<std::size_t>(face)][static_cast<std::size_t>(side)];
}

// The largest coordinate that still belongs to the pixel before `end`.
double Before(double value, int end) { return std::min(value, std::nextafter(end, 0.0)); }

// Width of the coarsest pixels: at the equator, in the middle of a face.
double PixelAngle(const SphereGrid& grid) {
  switch (grid.kind()) {
    case SphereGridKind::kEquirectangular:
    case SphereGridKind::kCylindrical:
      break;
    case SphereGridKind::kCubeCross:
    case SphereGridKind::kCubeStrip:
      return 2.0 / grid.face_width();
    case SphereGridKind::kRhombicDodecahedron:
      return kFaceAngle * std::sqrt(3.0 / std::sqrt(8.0)) / grid.face_width();
  }
  return 2.0 * kPi / grid.width();
}

}  // namespace

std::string_view ToString(SphereGridKind kind) {
  switch (kind) {
    case SphereGridKind::kEquirectangular:
      return "latlong";
    case SphereGridKind::kCylindrical:
      return "cylinder";
    case SphereGridKind::kCubeCross:
      return "cube-cross";
    case SphereGridKind::kCubeStrip:
      return "cube-strip";
    case SphereGridKind::kRhombicDodecahedron:
      return "rdmap";
  }
  return "?";
}

std::optional<SphereGridKind> SphereGridKindFromString(std::string_view name) {
  for (const SphereGridKind kind :
       {SphereGridKind::kEquirectangular, SphereGridKind::kCylindrical, SphereGridKind::kCubeCross,
        SphereGridKind::kCubeStrip, SphereGridKind::kRhombicDodecahedron}) {
    if (ToString(kind) == name) return kind;
  }
  return std::nullopt;
}

SphereGrid::SphereGrid(const Projection& projection)
    : kind_(projection.kind() == ProjectionKind::kCylindrical ? SphereGridKind::kCylindrical
                                                              : SphereGridKind::kEquirectangular),
      width_(projection.width()),
      height_(projection.height()),
      face_width_(projection.width()),
      face_height_(projection.height()),
      band_(projection) {}

SphereGrid SphereGrid::Equirectangular(int width, int height) {
  return SphereGrid(Projection::Equirectangular(width, height));
}

SphereGrid SphereGrid::Cylindrical(int width, int height, double z_min, double z_max) {
  return SphereGrid(Projection::Cylindrical(width, height, z_min, z_max));
}

SphereGrid SphereGrid::OfFaces(SphereGridKind kind, int face_size, int columns, int rows) {
  SphereGrid grid;
  grid.kind_ = kind;
  grid.width_ = columns * face_size;
  grid.height_ = rows * face_size;
  grid.face_width_ = face_size;
  grid.face_height_ = face_size;
  return grid;
}

SphereGrid SphereGrid::CubeCross(int face_size) {
  return OfFaces(SphereGridKind::kCubeCross, face_size, 4, 3);
}

SphereGrid SphereGrid::CubeStrip(int face_size) {
  return OfFaces(SphereGridKind::kCubeStrip, face_size, 1, 6);
}

SphereGrid SphereGrid::RhombicDodecahedron(int face_size) {
  return OfFaces(SphereGridKind::kRhombicDodecahedron, face_size, 4, 3);
}

Result<SphereGrid> SphereGrid::OfPicture(SphereGridKind kind, int width, int height, double z_min,
                                         double z_max) {
  if (width < 1 || height < 1) {
    return Fail(ErrorKind::kData, "{}x{} pixels, expected at least 1x1", width, height);
  }
  const auto tiles = [&](int columns, int rows, std::string_view what) -> Status {
    if (width % columns == 0 && height % rows == 0 && width / columns == height / rows) return {};
    return Fail(ErrorKind::kData, "{}x{} pixels, expected {} of {}Nx{}N", width, height, what,
                columns, rows);
  };
  switch (kind) {
    case SphereGridKind::kEquirectangular:
      if (width != 2 * height) {
        return Fail(ErrorKind::kData, "{}x{} pixels, expected a lat-long panorama of 2NxN", width,
                    height);
      }
      return Equirectangular(width, height);
    case SphereGridKind::kCylindrical: {
      if (z_min == 0.0 && z_max == 0.0) {
        const double z = kPi * height / width;
        return Cylindrical(width, height, -z, z);
      }
      if (!(z_min >= -kSteepest && z_max <= kSteepest && z_min < z_max)) {
        return Fail(ErrorKind::kData,
                    "cylinder from z = {:g} to {:g}, expected two rising numbers in [-1000, 1000]",
                    z_min, z_max);
      }
      return Cylindrical(width, height, z_min, z_max);
    }
    case SphereGridKind::kCubeCross:
      OMNIHDR_TRY(tiles(4, 3, "a cross of cube faces"));
      return CubeCross(width / 4);
    case SphereGridKind::kCubeStrip:
      OMNIHDR_TRY(tiles(1, 6, "six cube faces one below the other"));
      return CubeStrip(width);
    case SphereGridKind::kRhombicDodecahedron:
      OMNIHDR_TRY(tiles(4, 3, "an RD-map of rhombic faces"));
      return RhombicDodecahedron(width / 4);
  }
  return Fail(ErrorKind::kSoftware, "unknown kind of grid");
}

int SphereGrid::faces() const {
  if (IsOneFace()) return 1;
  return kind_ == SphereGridKind::kRhombicDodecahedron ? 12 : 6;
}

GridPixel SphereGrid::FaceOrigin(int face) const {
  if (IsOneFace()) return {0, 0};
  if (kind_ == SphereGridKind::kRhombicDodecahedron) {
    return {face % 4 * face_width_, face / 4 * face_height_};
  }
  const CubeFace& cube = CubeFaces(kind_)[static_cast<std::size_t>(face)];
  return {cube.column * face_width_, cube.row * face_height_};
}

std::optional<int> SphereGrid::FaceOfPixel(int x, int y) const {
  if (x < 0 || y < 0 || x >= width_ || y >= height_) return std::nullopt;
  if (IsOneFace()) return 0;
  const int column = x / face_width_;
  const int row = y / face_height_;
  if (kind_ == SphereGridKind::kRhombicDodecahedron) return 4 * row + column;
  const std::array<CubeFace, 6>& cube = CubeFaces(kind_);
  for (std::size_t face = 0; face < cube.size(); ++face) {
    if (cube[face].column == column && cube[face].row == row) return static_cast<int>(face);
  }
  return std::nullopt;
}

std::optional<Vector3d> SphereGrid::RayFromPixel(double x, double y) const {
  if (!(x >= 0.0 && x <= width_ && y >= 0.0 && y <= height_)) return std::nullopt;
  if (IsOneFace()) return band_.RayFromPixel(x, y);
  const std::optional<int> face = FaceOfPixel(std::min(static_cast<int>(x), width_ - 1),
                                              std::min(static_cast<int>(y), height_ - 1));
  if (!face) return std::nullopt;
  const GridPixel origin = FaceOrigin(*face);
  return RayFromFace({*face, x - origin.x, y - origin.y});
}

std::optional<Eigen::Vector2d> SphereGrid::PixelFromRay(const Vector3d& ray) const {
  const std::optional<FacePoint> point = FaceFromRay(ray);
  if (!point) return std::nullopt;
  const GridPixel origin = FaceOrigin(point->face);
  return Eigen::Vector2d(Before(origin.x + point->x, origin.x + face_width_),
                         Before(origin.y + point->y, origin.y + face_height_));
}

Vector3d SphereGrid::RayFromFace(const FacePoint& point) const {
  if (IsOneFace()) return band_.RayFromPixel(point.x, point.y);
  const auto face = static_cast<std::size_t>(point.face);
  const double s = point.x / face_width_;
  const double t = point.y / face_height_;
  if (kind_ == SphereGridKind::kRhombicDodecahedron) return RhombusRay(kRhombi[face], s, t);
  const CubeFace& cube = CubeFaces(kind_)[face];
  Vector3d ray = Vector3d::Zero();
  Add(cube.centre, 1.0, &ray);
  Add(cube.right, 2.0 * s - 1.0, &ray);
  Add(cube.down, 2.0 * t - 1.0, &ray);
  return ray.normalized();
}

std::optional<FacePoint> SphereGrid::FaceFromRay(const Vector3d& ray) const {
  const double largest = ray.cwiseAbs().maxCoeff();
  if (!(largest > 0.0 && std::isfinite(largest)) || !ray.allFinite()) return std::nullopt;
  const Vector3d v = ray / largest;
  if (IsOneFace()) {
    const Eigen::Vector2d point = band_.PixelFromRay(v);
    if (!(point.y() >= 0.0 && point.y() <= height_)) return std::nullopt;
    return FacePoint{0, point.x(), point.y()};
  }
  FacePoint point;
  double s = 0.0;
  double t = 0.0;
  if (kind_ == SphereGridKind::kRhombicDodecahedron) {
    // The face whose centre is nearest: nearer than any other of ±x±y, ±x±z, ±y±z.
    double nearest = -1.0;
    for (std::size_t face = 0; face < kRhombi.size(); ++face) {
      const double closeness = Along(kRhombi[face].a, v) + Along(kRhombi[face].b, v);
      if (closeness <= nearest) continue;
      nearest = closeness;
      point.face = static_cast<int>(face);
    }
    const Rhombus& face = kRhombi[static_cast<std::size_t>(point.face)];
    const double a = Along(face.a, v);
    const double b = Along(face.b, v);
    const double c = Along(Cross(face.a, face.b), v);
    s = PencilPosition(b - c, -c - a);
    t = PencilPosition(b + c, c - a);
  } else {
    const std::array<CubeFace, 6>& cube = CubeFaces(kind_);
    for (std::size_t face = 0; face < cube.size(); ++face) {
      if (Along(cube[face].centre, v) < 1.0) continue;
      point.face = static_cast<int>(face);
      break;
    }
    const CubeFace& face = cube[static_cast<std::size_t>(point.face)];
    s = 0.5 + 0.5 * Along(face.right, v);
    t = 0.5 + 0.5 * Along(face.down, v);
  }
  point.x = face_width_ * std::clamp(s, 0.0, 1.0);
  point.y = face_height_ * std::clamp(t, 0.0, 1.0);
  return point;
}

double SphereGrid::PixelSolidAngle(int x, int y) const {
  if (IsOneFace()) return band_.PixelSolidAngle(y);
  const std::optional<int> face = FaceOfPixel(x, y);
  if (!face) return 0.0;
  const double u = x % face_width_;
  const double v = y % face_height_;
  const Vector3d a = RayFromFace({*face, u, v});
  const Vector3d b = RayFromFace({*face, u + 1.0, v});
  const Vector3d c = RayFromFace({*face, u + 1.0, v + 1.0});
  const Vector3d d = RayFromFace({*face, u, v + 1.0});
  return TriangleSolidAngle(a, b, c) + TriangleSolidAngle(a, c, d);
}

double SphereGrid::CoveredSolidAngle() const {
  if (kind_ != SphereGridKind::kCylindrical) return 4.0 * kPi;
  const auto sine = [](double z) { return z / std::sqrt(1.0 + z * z); };
  return 2.0 * kPi * (sine(z_max()) - sine(z_min()));
}

std::optional<GridPixel> SphereGrid::Neighbour(int x, int y, Side side) const {
  const std::optional<int> face = FaceOfPixel(x, y);
  if (!face) return std::nullopt;
  const int dx = side == Side::kLeft ? -1 : (side == Side::kRight ? 1 : 0);
  const int dy = side == Side::kUp ? -1 : (side == Side::kDown ? 1 : 0);
  if (IsOneFace()) {
    const GridPixel next = {(x + dx + width_) % width_, y + dy};
    if (next.y >= 0 && next.y < height_) return next;
    if (kind_ == SphereGridKind::kCylindrical) return std::nullopt;
    return GridPixel{(x + width_ / 2) % width_, y};
  }
  const GridPixel origin = FaceOrigin(*face);
  const int u = x - origin.x + dx;
  const int v = y - origin.y + dy;
  const int size = face_width_;
  if (u >= 0 && v >= 0 && u < size && v < size) return GridPixel{x + dx, y + dy};
  const Edge& edge = EdgeAt(kind_, *face, side);
  const int along = dx != 0 ? v : u;
  const int there = edge.reversed ? size - 1 - along : along;
  const GridPixel start = FaceOrigin(edge.face);
  switch (edge.side) {
    case Side::kLeft:
      return GridPixel{start.x, start.y + there};
    case Side::kRight:
      return GridPixel{start.x + size - 1, start.y + there};
    case Side::kUp:
      return GridPixel{start.x + there, start.y};
    case Side::kDown:
      return GridPixel{start.x + there, start.y + size - 1};
  }
  return std::nullopt;
}

SphereGrid GridOfSize(SphereGridKind kind, int size, double z_min, double z_max) {
  switch (kind) {
    case SphereGridKind::kEquirectangular:
      return SphereGrid::Equirectangular(size, std::max(size / 2, 1));
    case SphereGridKind::kCylindrical: {
      const auto height = static_cast<int>(std::lround(size * (z_max - z_min) / (2.0 * kPi)));
      return SphereGrid::Cylindrical(size, std::max(height, 1), z_min, z_max);
    }
    case SphereGridKind::kCubeCross:
      return SphereGrid::CubeCross(size);
    case SphereGridKind::kCubeStrip:
      return SphereGrid::CubeStrip(size);
    case SphereGridKind::kRhombicDodecahedron:
      return SphereGrid::RhombicDodecahedron(size);
  }
  return {};
}

SphereGrid GridAsFineAs(const SphereGrid& source, SphereGridKind kind, double z_min, double z_max) {
  const double unit = PixelAngle(GridOfSize(kind, 1, z_min, z_max));
  const double size = unit / PixelAngle(source);
  const bool is_even = kind == SphereGridKind::kEquirectangular;
  const int rounded =
      is_even ? 2 * static_cast<int>(std::lround(size / 2.0)) : static_cast<int>(std::lround(size));
  return GridOfSize(kind, std::max(rounded, is_even ? 2 : 1), z_min, z_max);
}

}  // namespace omnihdr
