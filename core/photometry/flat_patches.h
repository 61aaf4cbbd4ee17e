#pragma once

#include <Eigen/Core>
#include <array>
#include <vector>

#include "core/image/image.h"
#include "core/photometry/sensor_picture.h"

namespace omnihdr {

// An area of even colour with an edge all round that is shaped like a parallelogram.
struct FlatPatch {
  Eigen::Vector2d centre = Eigen::Vector2d::Zero();          // pixels of the full picture
  Eigen::Matrix2d covariance = Eigen::Matrix2d::Identity();  // of its points, edges put back
  double area = 0.0;
};

// A picture reduced so far that noise is averaged and a patch is a few pixels wide.
struct PatchLevel {
  int factor = 1;       // pixels of the full picture to one of this
  Image<float> linear;  // mean pixel values, 8-bit units, 1 or 3 channels
};

// Halvings from at most 1600 pixels down to about 150. Bayer tiles become RGB pixels.
// Deterministic.
std::vector<PatchLevel> MakePatchLevels(const SensorPicture& picture);

// Every flat patch of a level, found at several thresholds of the local contrast (of logarithmic
// values: equal ratios count equally, in a dark picture as in a bright one). One entry for a place.
std::vector<FlatPatch> FindFlatPatches(const PatchLevel& level);

}  // namespace omnihdr
