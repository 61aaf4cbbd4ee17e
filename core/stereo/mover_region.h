#pragma once

#include <Eigen/Core>
#include <cstdint>
#include <vector>

#include "core/image/image.h"
#include "core/photometry/measurement.h"
#include "core/photometry/sampler.h"
#include "core/sphere/latlong_grid.h"
#include "core/stereo/merge_source.h"

namespace omnihdr {

// Output pixels of a merge to one pixel of the region in which movers are looked for.
inline constexpr int kMoverStep = 2;

// Where the own view of a merge shows something that moved, and how far what it hides is away.
struct MoverRegion {
  Image<std::uint8_t> inside;  // of the search's grid; empty = nowhere
  Image<float> disparity;      // of the background, inside
  bool Has(int x, int y) const {
    return !inside.empty() && x < inside.width() && y < inside.height() && inside.at(x, y) != 0 &&
           disparity.at(x, y) >= 0.0F;
  }
};

struct MoverSearch {
  const Measurement& own;
  const PanoramaSampler& own_sampler;
  Eigen::Matrix3f own_from_world;
  const DisparityMap& map;  // the own view's
  const std::vector<SourceLookup>& sources;
  LatLongGrid grid;
  Eigen::Matrix3f world_from_grid;
  float misalignment_px = 0.35F;
};

// A pixel shows a mover when the map is no surface there that two other views confirm - it is torn
// where what moved matched by chance - and at the distance of the surfaces left and right of it, or
// of what another view's map puts there, at least two other views agree with each other and the own
// view contradicts them. Pixels that a person marked (kMover) do in any case. Areas smaller than a
// person 13 m away, and those in which that holds for less than three pixels in five, are left
// alone; others take in what contradicts the others close by, and grow by two pixels. Something
// that moves so that it looks like a still thing at another distance is not found.
MoverRegion FindMovers(const MoverSearch& search);

}  // namespace omnihdr
