#pragma once

#include <cstddef>
#include <vector>

#include "drivers/sim/geometry.h"
#include "drivers/sim/scene.h"

namespace omnihdr::sim {

// Light that falls on every surface of a scene, computed once on a grid per face and interpolated:
// sun and lamps with shadows, the sky (through openings indoors), and one bounce between surfaces
// with an estimate of the later ones. Independent of the viewer. Immutable; any thread.
class BakedLight {
 public:
  BakedLight() = default;
  BakedLight(const Scene& scene, const Geometry& geometry);
  // Light on `solids` that stand in the scene without throwing shadows: what `light`, the scene's
  // own, makes of `geometry` falls on them.
  BakedLight(const Scene& scene, const Geometry& geometry, const BakedLight& light,
             const Geometry& solids);

  // Irradiance at a hit, linear RGB: a diffuse surface of albedo a shines with a·E/π.
  Vec3 Irradiance(const Geometry& geometry, const Hit& hit) const;
  std::size_t texels() const { return irradiance_.size(); }

 private:
  struct Grid {
    std::size_t offset = 0;
    int columns = 1;
    int rows = 1;
    bool wraps = false;  // columns go round
  };
  // `lit`: what gets light; `around`: what throws shadows and light back, by its `finished` light;
  // without, `around` is `lit` itself.
  void Bake(const Scene& scene, const Geometry& lit, const Geometry& around,
            const BakedLight* finished);
  Vec3 Lookup(const std::vector<Vec3>& texels, const Geometry& geometry, const Hit& hit) const;
  const Grid& GridOf(const Hit& hit) const {
    return grids_[first_grid_[static_cast<std::size_t>(hit.primitive)] +
                  static_cast<std::size_t>(hit.face)];
  }
  void Smooth(std::vector<Vec3>& texels, int passes) const;

  std::vector<std::size_t> first_grid_;  // per primitive
  std::vector<Grid> grids_;
  std::vector<Vec3> irradiance_;
};

}  // namespace omnihdr::sim
