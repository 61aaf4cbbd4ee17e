#pragma once

#include <vector>

#include "drivers/sim/geometry.h"
#include "drivers/sim/lighting.h"
#include "drivers/sim/material.h"

namespace omnihdr::sim {

// Radiance that leaves a surface towards the eye. `direction`: of the ray that hit it, unit length;
// `pixel`: the angle between neighbouring samples, radians: finer detail of a texture is left out.
// `light` must be that of `geometry`. Any thread.
Vec3 Shade(const std::vector<Material>& materials, const Geometry& geometry,
           const BakedLight& light, Vec3 direction, float pixel, const Hit& hit);

}  // namespace omnihdr::sim
