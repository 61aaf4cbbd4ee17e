#include "drivers/sim/geometry.h"

#include <algorithm>
#include <array>
#include <numeric>
#include <utility>

namespace omnihdr::sim {
namespace {

constexpr float kNear = 1e-4F;
constexpr std::size_t kLeafSize = 3;

// Half extents of the axis-aligned box round a primitive.
Vec3 Extent(const Primitive& p) {
  if (p.shape == Shape::kSphere) return {p.half.x, p.half.x, p.half.x};
  const Vec3 half = p.shape == Shape::kCylinder ? Vec3{p.half.x, p.half.x, p.half.z} : p.half;
  const auto abs_scaled = [](Vec3 axis, float s) {
    return Vec3{std::abs(axis.x) * s, std::abs(axis.y) * s, std::abs(axis.z) * s};
  };
  return abs_scaled(p.axis_x, half.x) + abs_scaled(p.axis_y, half.y) +
         abs_scaled(p.axis_z, half.z) + Vec3{1e-4F, 1e-4F, 1e-4F};
}

void IntersectQuad(const Primitive& p, Vec3 o, Vec3 d, int index, Hit& hit) {
  const float dz = Dot(d, p.axis_z);
  if (dz >= 0.0F) return;
  const float t = -Dot(o, p.axis_z) / dz;
  if (!(t > kNear && t < hit.t)) return;
  const Vec3 at = o + d * t;
  const float x = Dot(at, p.axis_x);
  const float y = Dot(at, p.axis_y);
  if (std::abs(x) > p.half.x || std::abs(y) > p.half.y) return;
  hit = {t, index, 0, {x, y, 0.0F}};
}

void IntersectBox(const Primitive& p, Vec3 o, Vec3 d, int index, Hit& hit) {
  const Vec3 lo = p.ToLocal(o);
  const Vec3 ld = p.ToLocal(d);
  const std::array<float, 3> oo{lo.x, lo.y, lo.z};
  const std::array<float, 3> dd{ld.x, ld.y, ld.z};
  const std::array<float, 3> hh{p.half.x, p.half.y, p.half.z};
  float enter = -std::numeric_limits<float>::infinity();
  float leave = std::numeric_limits<float>::infinity();
  int enter_axis = 0;
  int leave_axis = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const auto a = static_cast<std::size_t>(axis);
    // A zero component would make 0·inf for an origin on the slab's plane.
    const float inverse = 1.0F / (dd[a] == 0.0F ? 1e-20F : dd[a]);
    float t0 = (-hh[a] - oo[a]) * inverse;
    float t1 = (hh[a] - oo[a]) * inverse;
    if (t0 > t1) std::swap(t0, t1);
    if (t0 > enter) {
      enter = t0;
      enter_axis = axis;
    }
    if (t1 < leave) {
      leave = t1;
      leave_axis = axis;
    }
  }
  if (enter > leave || leave <= kNear) return;
  const bool inside = enter <= kNear;
  const float t = inside ? leave : enter;
  if (t >= hit.t) return;
  const int axis = inside ? leave_axis : enter_axis;
  const Vec3 at = lo + ld * t;
  const float along = axis == 0 ? at.x : axis == 1 ? at.y : at.z;
  hit = {t, index, 2 * axis + (along > 0.0F ? 1 : 0), at};
}

void IntersectSphere(const Primitive& p, Vec3 o, Vec3 d, int index, Hit& hit) {
  const float b = Dot(o, d);
  // The distance of the ray from the centre, not |o|² − r²: that one cancels for far small spheres.
  const Vec3 closest = o - d * b;
  const float under_root = p.half.x * p.half.x - Dot(closest, closest);
  if (under_root <= 0.0F) return;
  const float root = std::sqrt(under_root);
  float t = -b - root;
  if (t <= kNear) t = -b + root;
  if (!(t > kNear && t < hit.t)) return;
  hit = {t, index, 0, p.ToLocal(o + d * t)};
}

void IntersectCylinder(const Primitive& p, Vec3 o, Vec3 d, int index, Hit& hit) {
  const Vec3 lo = p.ToLocal(o);
  const Vec3 ld = p.ToLocal(d);
  const float r = p.half.x;
  const float h = p.half.z;
  const float a = ld.x * ld.x + ld.y * ld.y;
  float enter = -std::numeric_limits<float>::infinity();
  float leave = std::numeric_limits<float>::infinity();
  int enter_face = 0;
  int leave_face = 0;
  if (a > 1e-12F) {
    const float t_closest = -(lo.x * ld.x + lo.y * ld.y) / a;
    const float cx = lo.x + ld.x * t_closest;
    const float cy = lo.y + ld.y * t_closest;
    const float under_root = (r * r - cx * cx - cy * cy) / a;
    if (under_root <= 0.0F) return;
    const float root = std::sqrt(under_root);
    enter = t_closest - root;
    leave = t_closest + root;
  } else if (lo.x * lo.x + lo.y * lo.y > r * r) {
    return;
  }
  const float inverse = 1.0F / (ld.z == 0.0F ? 1e-20F : ld.z);
  float t0 = (-h - lo.z) * inverse;
  float t1 = (h - lo.z) * inverse;
  const int first_cap = t0 <= t1 ? 2 : 1;
  if (t0 > t1) std::swap(t0, t1);
  if (t0 > enter) {
    enter = t0;
    enter_face = first_cap;
  }
  if (t1 < leave) {
    leave = t1;
    leave_face = 3 - first_cap;
  }
  if (enter > leave || leave <= kNear) return;
  const bool inside = enter <= kNear;
  const float t = inside ? leave : enter;
  if (t >= hit.t) return;
  hit = {t, index, inside ? leave_face : enter_face, lo + ld * t};
}

void IntersectPrimitive(const Primitive& p, Vec3 origin, Vec3 d, int index, Hit& hit) {
  const Vec3 o = origin - p.centre;
  switch (p.shape) {
    case Shape::kQuad:
      return IntersectQuad(p, o, d, index, hit);
    case Shape::kBox:
      return IntersectBox(p, o, d, index, hit);
    case Shape::kSphere:
      return IntersectSphere(p, o, d, index, hit);
    case Shape::kCylinder:
      return IntersectCylinder(p, o, d, index, hit);
  }
}

float DistanceTo(const Primitive& p, Vec3 point) {
  const Vec3 at = p.ToLocal(point - p.centre);
  switch (p.shape) {
    case Shape::kSphere:
      return std::max(0.0F, Length(at) - p.half.x);
    case Shape::kCylinder: {
      const float radial = std::max(0.0F, std::hypot(at.x, at.y) - p.half.x);
      const float axial = std::max(0.0F, std::abs(at.z) - p.half.z);
      return std::hypot(radial, axial);
    }
    case Shape::kQuad:
    case Shape::kBox:
      break;
  }
  const Vec3 outside{std::max(0.0F, std::abs(at.x) - p.half.x),
                     std::max(0.0F, std::abs(at.y) - p.half.y),
                     std::max(0.0F, std::abs(at.z) - p.half.z)};
  return Length(outside);
}

}  // namespace

Vec3 LocalNormal(const Primitive& primitive, const Hit& hit) {
  switch (primitive.shape) {
    case Shape::kQuad:
      return {0, 0, 1};
    case Shape::kSphere:
      return Normalised(hit.local);
    case Shape::kCylinder:
      if (hit.face != 0) return {0, 0, hit.face == 1 ? 1.0F : -1.0F};
      return Normalised({hit.local.x, hit.local.y, 0.0F});
    case Shape::kBox:
      break;
  }
  const float sign = (hit.face & 1) != 0 ? 1.0F : -1.0F;
  const int axis = hit.face / 2;
  return {axis == 0 ? sign : 0.0F, axis == 1 ? sign : 0.0F, axis == 2 ? sign : 0.0F};
}

Geometry::Geometry(std::vector<Primitive> primitives) : primitives_(std::move(primitives)) {
  order_.resize(primitives_.size());
  std::iota(order_.begin(), order_.end(), 0);
  nodes_.reserve(2 * primitives_.size() + 1);
  nodes_.emplace_back();
  Split(0, 0, order_.size());
}

void Geometry::Split(std::size_t node, std::size_t begin, std::size_t end) {
  constexpr float kInf = std::numeric_limits<float>::infinity();
  struct Bounds {
    Vec3 low{kInf, kInf, kInf};
    Vec3 high{-kInf, -kInf, -kInf};
    void Add(Vec3 l, Vec3 h) {
      low = {std::min(low.x, l.x), std::min(low.y, l.y), std::min(low.z, l.z)};
      high = {std::max(high.x, h.x), std::max(high.y, h.y), std::max(high.z, h.z)};
    }
    float Area() const {
      const Vec3 d = high - low;
      return d.x * d.y + d.y * d.z + d.z * d.x;
    }
  };
  const auto add = [this](Bounds& bounds, std::int32_t index) {
    const Primitive& p = primitives_[static_cast<std::size_t>(index)];
    const Vec3 extent = Extent(p);
    bounds.Add(p.centre - extent, p.centre + extent);
  };
  Bounds all;
  for (std::size_t i = begin; i < end; ++i) add(all, order_[i]);
  nodes_[node].low = all.low;
  nodes_[node].high = all.high;
  nodes_[node].first = static_cast<std::int32_t>(begin);
  nodes_[node].count = static_cast<std::int32_t>(end - begin);
  if (end - begin <= 1) return;

  // Surface area heuristic over every split of every axis: the scenes are small enough.
  const auto coordinate = [this](std::int32_t index, int axis) {
    const Vec3 c = primitives_[static_cast<std::size_t>(index)].centre;
    return axis == 0 ? c.x : axis == 1 ? c.y : c.z;
  };
  const auto sort_along = [&](int axis) {
    std::sort(order_.begin() + static_cast<std::ptrdiff_t>(begin),
              order_.begin() + static_cast<std::ptrdiff_t>(end),
              [&](std::int32_t a, std::int32_t b) {
                const float ca = coordinate(a, axis);
                const float cb = coordinate(b, axis);
                return ca != cb ? ca < cb : a < b;
              });
  };
  float best_cost = kInf;
  int best_axis = 0;
  std::size_t best_middle = begin + (end - begin) / 2;
  std::vector<float> right_area(end - begin);
  for (int axis = 0; axis < 3; ++axis) {
    sort_along(axis);
    Bounds right;
    for (std::size_t i = end; i-- > begin;) {
      add(right, order_[i]);
      right_area[i - begin] = right.Area();
    }
    Bounds left;
    for (std::size_t i = begin; i + 1 < end; ++i) {
      add(left, order_[i]);
      const float cost = left.Area() * static_cast<float>(i + 1 - begin) +
                         right_area[i + 1 - begin] * static_cast<float>(end - i - 1);
      if (cost < best_cost) {
        best_cost = cost;
        best_axis = axis;
        best_middle = i + 1;
      }
    }
  }
  const float leaf_cost = all.Area() * (static_cast<float>(end - begin) - 0.7F);
  if (end - begin <= kLeafSize && leaf_cost <= best_cost) return;
  sort_along(best_axis);
  const std::size_t left_child = nodes_.size();
  nodes_[node].first = static_cast<std::int32_t>(left_child);
  nodes_[node].count = 0;
  nodes_.emplace_back();
  nodes_.emplace_back();
  Split(left_child, begin, best_middle);
  Split(left_child + 1, best_middle, end);
}

namespace {

// Entry distance of a ray into a box, or infinity.
inline float Enter(Vec3 low, Vec3 high, Vec3 origin, Vec3 inverse, float t_max) {
  const float x0 = (low.x - origin.x) * inverse.x;
  const float x1 = (high.x - origin.x) * inverse.x;
  const float y0 = (low.y - origin.y) * inverse.y;
  const float y1 = (high.y - origin.y) * inverse.y;
  const float z0 = (low.z - origin.z) * inverse.z;
  const float z1 = (high.z - origin.z) * inverse.z;
  const float enter =
      std::max(std::max(std::min(x0, x1), std::min(y0, y1)), std::max(std::min(z0, z1), 0.0F));
  const float leave =
      std::min(std::min(std::max(x0, x1), std::max(y0, y1)), std::min(std::max(z0, z1), t_max));
  return enter <= leave ? enter : std::numeric_limits<float>::infinity();
}

Vec3 Inverse(Vec3 d) {
  const auto inverse = [](float v) {
    return 1.0F / (std::abs(v) < 1e-12F ? std::copysign(1e-12F, v) : v);
  };
  return {inverse(d.x), inverse(d.y), inverse(d.z)};
}

constexpr std::size_t kStack = 64;

}  // namespace

Hit Geometry::Intersect(Vec3 origin, Vec3 direction, float t_max) const {
  Hit hit;
  hit.t = t_max;
  if (primitives_.empty()) return hit;
  const Vec3 inverse = Inverse(direction);
  struct Entry {
    std::int32_t node;
    float enter;
  };
  std::array<Entry, kStack> stack;  // NOLINT(cppcoreguidelines-pro-type-member-init): hot
  std::size_t depth = 0;
  std::int32_t current = 0;
  while (true) {
    const Node& node = nodes_[static_cast<std::size_t>(current)];
    if (node.count > 0) {
      for (std::int32_t i = node.first; i < node.first + node.count; ++i) {
        const std::int32_t index = order_[static_cast<std::size_t>(i)];
        IntersectPrimitive(primitives_[static_cast<std::size_t>(index)], origin, direction, index,
                           hit);
      }
    } else {
      const Node& left = nodes_[static_cast<std::size_t>(node.first)];
      const Node& right = nodes_[static_cast<std::size_t>(node.first) + 1];
      const float enter_left = Enter(left.low, left.high, origin, inverse, hit.t);
      const float enter_right = Enter(right.low, right.high, origin, inverse, hit.t);
      const bool left_first = enter_left <= enter_right;
      const float near = left_first ? enter_left : enter_right;
      const float far = left_first ? enter_right : enter_left;
      const std::int32_t near_node = node.first + (left_first ? 0 : 1);
      if (far < hit.t && depth < kStack) {
        stack[depth++] = {node.first + (left_first ? 1 : 0), far};
      }
      if (near < hit.t) {
        current = near_node;
        continue;
      }
    }
    bool found = false;
    while (depth > 0) {
      const Entry entry = stack[--depth];
      if (entry.enter < hit.t) {
        current = entry.node;
        found = true;
        break;
      }
    }
    if (!found) return hit;
  }
}

Hit Geometry::IntersectOnly(int primitive, Vec3 origin, Vec3 direction) const {
  Hit hit;
  IntersectPrimitive(primitives_[static_cast<std::size_t>(primitive)], origin, direction, primitive,
                     hit);
  return hit;
}

bool Geometry::Occluded(Vec3 origin, Vec3 direction, float t_max) const {
  if (primitives_.empty()) return false;
  const Vec3 inverse = Inverse(direction);
  std::array<std::int32_t, kStack> stack;  // NOLINT(cppcoreguidelines-pro-type-member-init): hot
  std::size_t depth = 0;
  stack[depth++] = 0;
  Hit hit;
  hit.t = t_max;
  while (depth > 0) {
    const Node& node = nodes_[static_cast<std::size_t>(stack[--depth])];
    if (node.count > 0) {
      for (std::int32_t i = node.first; i < node.first + node.count; ++i) {
        const std::int32_t index = order_[static_cast<std::size_t>(i)];
        IntersectPrimitive(primitives_[static_cast<std::size_t>(index)], origin, direction, index,
                           hit);
        if (hit.valid()) return true;
      }
      continue;
    }
    for (std::int32_t child = node.first; child < node.first + 2; ++child) {
      const Node& box = nodes_[static_cast<std::size_t>(child)];
      if (depth < kStack && Enter(box.low, box.high, origin, inverse, t_max) < t_max) {
        stack[depth++] = child;
      }
    }
  }
  return false;
}

float Geometry::Clearance(Vec3 point) const {
  float nearest = std::numeric_limits<float>::infinity();
  for (const Primitive& p : primitives_) nearest = std::min(nearest, DistanceTo(p, point));
  return nearest;
}

}  // namespace omnihdr::sim
