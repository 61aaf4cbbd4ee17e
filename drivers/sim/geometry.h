#pragma once

#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

namespace omnihdr::sim {

// Three floats: a point or direction in metres in the world frame, or linear RGB. The renderer's
// inner loops use this instead of Eigen for its plain layout.
struct Vec3 {
  float x = 0.0F;
  float y = 0.0F;
  float z = 0.0F;
  constexpr Vec3 operator+(Vec3 o) const { return {x + o.x, y + o.y, z + o.z}; }
  constexpr Vec3 operator-(Vec3 o) const { return {x - o.x, y - o.y, z - o.z}; }
  constexpr Vec3 operator*(Vec3 o) const { return {x * o.x, y * o.y, z * o.z}; }
  constexpr Vec3 operator*(float s) const { return {x * s, y * s, z * s}; }
  constexpr Vec3 operator-() const { return {-x, -y, -z}; }
  Vec3& operator+=(Vec3 o) { return *this = *this + o; }
};
constexpr float Dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
constexpr Vec3 Cross(Vec3 a, Vec3 b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline float Length(Vec3 a) { return std::sqrt(Dot(a, a)); }
inline Vec3 Normalised(Vec3 a) { return a * (1.0F / Length(a)); }
constexpr Vec3 Lerp(Vec3 a, Vec3 b, float t) { return a + (b - a) * t; }

// Deterministic pseudo-random numbers (SplitMix64): the same on every machine and compiler.
class Random {
 public:
  explicit Random(std::uint64_t seed) : state_(seed) {}
  std::uint64_t Next() {
    std::uint64_t z = (state_ += 0x9e3779b97f4a7c15ULL);
    z = (z ^ (z >> 30U)) * 0xbf58476d1ce4e5b9ULL;
    z = (z ^ (z >> 27U)) * 0x94d049bb133111ebULL;
    return z ^ (z >> 31U);
  }
  // In [0, 1).
  float Unit() { return static_cast<float>(Next() >> 40U) * 0x1p-24F; }
  float Range(float low, float high) { return low + (high - low) * Unit(); }
  // In [0, count).
  int Index(int count) {
    return static_cast<int>(Next() % static_cast<std::uint64_t>(count < 1 ? 1 : count));
  }

 private:
  std::uint64_t state_;
};

enum class Shape : std::uint8_t {
  kQuad,  // seen from its +Z side only
  kBox,
  kSphere,    // radius half.x
  kCylinder,  // along local Z, radius half.x, height 2·half.z, with caps
};

// A solid with its own local frame (orthonormal axes in world coordinates).
struct Primitive {
  Shape shape = Shape::kBox;
  Vec3 centre;
  Vec3 axis_x{1, 0, 0};
  Vec3 axis_y{0, 1, 0};
  Vec3 axis_z{0, 0, 1};
  Vec3 half;            // half extents along the local axes
  int material = 0;     // index into the scene's materials
  Vec3 emission;        // radiance of the surface itself
  bool indoor = false;  // lit through the scene's openings instead of by the open sky
  float texel = 0.15F;  // wanted spacing of baked light, metres

  Vec3 ToLocal(Vec3 direction) const {
    return {Dot(direction, axis_x), Dot(direction, axis_y), Dot(direction, axis_z)};
  }
  Vec3 ToWorld(Vec3 local) const { return axis_x * local.x + axis_y * local.y + axis_z * local.z; }
};

// Where a ray met a surface.
struct Hit {
  float t = std::numeric_limits<float>::infinity();
  int primitive = -1;
  int face = 0;  // box: 2·axis + (1 on the positive side); cylinder: 0 side, 1 top, 2 bottom
  Vec3 local;    // hit point in the primitive's frame
  bool valid() const { return primitive >= 0; }
};

// Outward normal at a hit, in the primitive's frame.
Vec3 LocalNormal(const Primitive& primitive, const Hit& hit);

// A set of primitives with a bounding volume hierarchy over them. Immutable once built; any thread.
class Geometry {
 public:
  Geometry() = default;
  explicit Geometry(std::vector<Primitive> primitives);

  const std::vector<Primitive>& primitives() const { return primitives_; }
  // The first surface along origin + t·direction (unit length), 0 < t < t_max.
  Hit Intersect(Vec3 origin, Vec3 direction,
                float t_max = std::numeric_limits<float>::infinity()) const;
  // The same for one primitive alone.
  Hit IntersectOnly(int primitive, Vec3 origin, Vec3 direction) const;
  // Whether anything lies between.
  bool Occluded(Vec3 origin, Vec3 direction, float t_max) const;
  // Distance from a point to the nearest surface; 0 inside a solid.
  float Clearance(Vec3 point) const;

 private:
  struct Node {
    Vec3 low;
    std::int32_t first = 0;  // leaf: first index into order_; inner: index of the left child
    Vec3 high;
    std::int32_t count = 0;  // leaf: primitives; inner: 0
  };
  void Split(std::size_t node, std::size_t begin, std::size_t end);

  std::vector<Primitive> primitives_;
  std::vector<std::int32_t> order_;
  std::vector<Node> nodes_;
};

}  // namespace omnihdr::sim
