#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "core/image/image.h"
#include "core/photometry/measurement.h"
#include "core/sphere/latlong_grid.h"
#include "core/stereo/merge_source.h"

namespace omnihdr {

// Output pixels of a merge to one pixel of the region in which movers are looked for.
inline constexpr int kMoverStep = 2;

// Where the own view of a merge shows something that moved, and how far what it hides is away.
struct MoverRegion {
  static constexpr std::uint8_t kCore = 2;
  // Of the search's grid; empty = nowhere. kCore, or 1 beside that, where it is an edge's pixel.
  Image<std::uint8_t> inside;
  Image<float> disparity;     // of the background, inside
  Image<std::uint8_t> views;  // inside: bit k is set where source k shows the background
  bool Has(int x, int y) const {
    return !inside.empty() && x < inside.width() && y < inside.height() && inside.at(x, y) != 0 &&
           disparity.at(x, y) >= 0.0F;
  }
  bool IsCore(int x, int y) const { return inside.at(x, y) == kCore; }
  bool ShowsBackground(int x, int y, std::size_t source) const {
    return ((views.at(x, y) >> source) & 1U) != 0;
  }
};

struct MoverSearch {
  const Measurement& own;
  Eigen::Matrix3f own_from_world;
  const DisparityMap& map;  // the own view's
  const std::vector<SourceLookup>& sources;
  LatLongGrid grid;
  Eigen::Matrix3f world_from_grid;
  float misalignment_px = 0.35F;
};

// In question are pixels whose map is no surface that the other views confirm - what moved matched
// by chance, and tore it - and those where other views' maps have something nearer than the own
// one: nothing still can be seen through that. There the background is sought, at one of several
// distances (the surfaces left and right, between them, the maps' own): that at which the other
// views around agree best. At that distance the views are told apart: the own and all others that
// see the same are a set, and the set that most views and most of the surroundings speak for is the
// one that sees the background. The own view shows a mover where it is not of that set and two
// others are. Areas in which less than a person 20 m away is so are left alone; all others grow by
// a pixel. Pixels that a person marked (kMover) are movers in any case. Where fewer than two other
// views see past a mover it stays. Something that moves so that it looks like a still thing nearer
// than the background is not found.
MoverRegion FindMovers(const MoverSearch& search);

}  // namespace omnihdr
