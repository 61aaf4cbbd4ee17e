#pragma once

#include <numbers>
#include <string>

#include "core/base/result.h"
#include "core/image/exr.h"
#include "core/sphere/sphere_grid.h"

namespace omnihdr {

// Our own attributes for projections that OpenEXR has no `envmap` value for.
inline constexpr char kProjectionAttribute[] = "omnihdrProjection";
inline constexpr char kZMinAttribute[] = "omnihdrZMin";
inline constexpr char kZMaxAttribute[] = "omnihdrZMax";

// The thesis's cylinder reaches from -kCylinderZ to kCylinderZ: 134 degrees high, a width by three
// quarters.
inline constexpr double kCylinderZ = 0.75 * std::numbers::pi;

// The grid of a picture to write: --size (a picture's width, of faces a face's), or 0 = as fine as
// `source`. Errors (kUsage): an odd width of a lat-long, more pixels than a picture may have.
Result<SphereGrid> GridToWrite(SphereGridKind kind, int size, const SphereGrid& source,
                               double z_min = -kCylinderZ, double z_max = kCylinderZ);

// A file's attributes with those that tell the grid's projection, and no others of that kind.
ExrAttributes AttributesFor(const SphereGrid& target, ExrAttributes attributes);

// For people: "latlong 2048x1024".
std::string Shown(const SphereGrid& grid);

}  // namespace omnihdr
