#pragma once

#include <Eigen/Core>
#include <optional>
#include <string_view>

#include "core/base/result.h"
#include "core/sphere/projection.h"

namespace omnihdr {

enum class SphereGridKind {
  kEquirectangular,
  kCylindrical,
  kCubeCross,           // cross of 4 × 3 faces: U over F, L F R B, D below F (thesis fig. 3.5)
  kCubeStrip,           // OpenEXR's ENVMAP_CUBE: L R U D F B, one below the other
  kRhombicDodecahedron  // RD-map, 4 × 3 faces (Fu, Wan, Wong and Leung 2009)
};

// "latlong", "cylinder", "cube-cross", "cube-strip", "rdmap".
std::string_view ToString(SphereGridKind kind);
std::optional<SphereGridKind> SphereGridKindFromString(std::string_view name);

struct GridPixel {
  int x = 0;
  int y = 0;
  bool operator==(const GridPixel&) const = default;
};

// A point of one face, in pixels from the face's top left corner.
struct FacePoint {
  int face = 0;
  double x = 0.0;
  double y = 0.0;
};

enum class Side { kLeft, kRight, kUp, kDown };

// How the sphere lies on the pixels of a picture, for every projection the product knows: a
// picture is made of one or several faces, tiles in which neighbouring pixels are neighbours on the
// sphere, plus what they do not fill (the corners of a cross). Rays are of the camera frame (X
// forward, Y left, Z up); pixel (column j, row i) has its centre at (j+0.5, i+0.5).
//
// Equirectangular and cylindrical: one face, as Projection. Cube: 90° gnomonic faces seen from
// inside. RD-map: 12 rhombic faces, each cut by two pencils of great circles at equal angles ("skew
// great circles"), so that all pixels are nearly equal: largest over smallest solid angle at most
// 9/(4√2) = 1.59, of a gnomonic cube 3√3 = 5.20, of an equirectangular picture without bound. Value
// type; thread-safe to read.
class SphereGrid {
 public:
  SphereGrid() = default;
  explicit SphereGrid(const Projection& projection);
  static SphereGrid Equirectangular(int width, int height);
  static SphereGrid Cylindrical(int width, int height, double z_min, double z_max);
  static SphereGrid CubeCross(int face_size);
  static SphereGrid CubeStrip(int face_size);
  static SphereGrid RhombicDodecahedron(int face_size);
  // For a picture from outside, whose size is checked against the kind (a cylinder: against its
  // band, [-z, z] with square pixels at the horizon when z_min and z_max are both 0).
  static Result<SphereGrid> OfPicture(SphereGridKind kind, int width, int height,
                                      double z_min = 0.0, double z_max = 0.0);

  SphereGridKind kind() const { return kind_; }
  int width() const { return width_; }
  int height() const { return height_; }
  double z_min() const { return band_.z_min(); }  // of a cylinder
  double z_max() const { return band_.z_max(); }
  int faces() const;
  int face_width() const { return face_width_; }
  int face_height() const { return face_height_; }
  // Top left pixel of a face.
  GridPixel FaceOrigin(int face) const;
  // Nothing for a pixel that shows no part of the sphere.
  std::optional<int> FaceOfPixel(int x, int y) const;

  // Unit ray through a picture point; nothing where the picture shows no part of the sphere.
  std::optional<Eigen::Vector3d> RayFromPixel(double x, double y) const;
  // Picture point of a ray of any length, within the pixel that shows it; nothing when the picture
  // does not show it, or for a ray that is zero or not finite.
  std::optional<Eigen::Vector2d> PixelFromRay(const Eigen::Vector3d& ray) const;

  // The same by faces. A point outside the face continues the face's own coordinate lines, a short
  // way beyond its border. Requires a valid face.
  Eigen::Vector3d RayFromFace(const FacePoint& point) const;
  // The face that shows the ray, and where; x in [0, W], y in [0, H] of the face.
  std::optional<FacePoint> FaceFromRay(const Eigen::Vector3d& ray) const;

  // Solid angle of a pixel in steradians; 0 where the picture shows nothing. Exact: pixels of cube
  // and RD-map are spherical quadrilaterals (Van Oosterom and Strackee 1983).
  double PixelSolidAngle(int x, int y) const;
  // What all pixels cover: 4π, or a cylinder's band.
  double CoveredSolidAngle() const;

  // The pixel next to a used pixel on the sphere, across the borders of faces and round the back;
  // nothing beyond a cylinder's rim. Over the pole of an equirectangular picture it is the pixel
  // half a turn away. Law: neighbours' neighbours lead back.
  std::optional<GridPixel> Neighbour(int x, int y, Side side) const;

  bool operator==(const SphereGrid&) const = default;

 private:
  static SphereGrid OfFaces(SphereGridKind kind, int face_size, int columns, int rows);
  bool IsOneFace() const {
    return kind_ == SphereGridKind::kEquirectangular || kind_ == SphereGridKind::kCylindrical;
  }

  SphereGridKind kind_ = SphereGridKind::kEquirectangular;
  int width_ = 0;
  int height_ = 0;
  int face_width_ = 0;
  int face_height_ = 0;
  Projection band_;  // of equirectangular and cylindrical
};

// The grid of a kind whose coarsest pixels are about as fine as those of `source`, so that nothing
// is lost: the default size of a conversion. A cylinder gets the band [z_min, z_max] and square
// pixels at the horizon.
SphereGrid GridAsFineAs(const SphereGrid& source, SphereGridKind kind, double z_min, double z_max);
// The grid of a kind of a given size: the picture's width (equirectangular, cylinder), or a face's.
SphereGrid GridOfSize(SphereGridKind kind, int size, double z_min, double z_max);

}  // namespace omnihdr
