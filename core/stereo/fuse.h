#pragma once

#include <Eigen/Core>
#include <vector>

#include "core/stereo/sgm.h"

namespace omnihdr {

// Another view's disparity map and where it was taken.
struct NeighbourMap {
  const DisparityMap* map = nullptr;
  // Its centre seen from the reference's centre, in the world frame, in the unit whose inverse the
  // disparity is.
  Eigen::Vector3f offset = Eigen::Vector3f::Zero();
};

struct FuseOptions {
  double tolerance = 0.01;           // two disparities agree within this ...
  double relative_tolerance = 0.06;  // ... or within this fraction of the larger
  float violation_weight = 0.5F;     // of a view whose free space a candidate would block
  float least_score = 0.45F;         // below it a pixel is a hole
};

// Forward warp of a disparity map to a viewpoint at `offset` (seen from the map's own centre): at
// every pixel of the target the nearest surface that lands there; NaN in holes and behind nothing.
Image<float> WarpDisparity(const DisparityMap& map, const Eigen::Vector3f& offset);

// Vote fusion of the reference's map with its neighbours': each pixel's candidates are its own
// value and those the other maps put there; the one with most support less half the violations
// (views that see through it: Merrell et al. 2007 call it a free-space violation) wins, and becomes
// the mean of its supporters. Each map supports with a half and its confidence there: what it only
// guessed, where a picture is clipped or dark, does not outvote what another has seen. Confidence
// is the winner's score over the number of maps. At most eight neighbours take part, the first
// ones.
DisparityMap FuseDisparity(const DisparityMap& reference,
                           const std::vector<NeighbourMap>& neighbours, const FuseOptions& options);

struct FillOptions {
  int reach = 192;             // how far a hole looks for its rim, in pixels
  float colour_codes = 10.0F;  // brightness difference at which a rim pixel counts e^-1
};

// Fills holes only (what is known stays as it is): from the rims in eight directions, weighed by
// distance and likeness of brightness, leaning to the farther surface, since holes are mostly what
// a nearer one hid. Confidence of a filled pixel is 0.
void FillHoles(const Image<std::uint8_t>& brightness, const FillOptions& options,
               DisparityMap* map);

}  // namespace omnihdr
