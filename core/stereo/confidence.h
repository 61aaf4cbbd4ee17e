#pragma once

#include <vector>

#include "core/image/image.h"
#include "core/stereo/sgm.h"
#include "core/stereo/stereo_view.h"
#include "core/stereo/sweep.h"

namespace omnihdr {

// Score (DisparityMap::confidence) from which on a disparity is used where the reference itself saw
// nothing and only other views vouch for it.
inline constexpr float kTrustedScore = 0.4F;

// How a panorama was taken, as far as it limits what a disparity is worth.
struct PanoramaOptics {
  double columns = 1024.0;   // that its sensors resolve all round
  double viewpoint_m = 0.0;  // root mean square distance of its sensors from the centre that the
                             // pose is of
};

// What a disparity that was matched right is off by: a share of a column resolved, and, of a head
// of several sensors, what the distance from the head's centre is not: a surface is matched from
// where the sensors stand. One standard deviation.
struct DisparityPrecision {
  double columns = 1024.0;
  double viewpoint = 0.0;  // in the unit of the poses
  double baseline = 0.0;   // mean distance to the neighbours; 0 = unknown
  // The probability that it is within a pixel of parallax of a panorama 1536 wide, as a share of
  // that of a panorama like those that ProbabilityRight was measured on; at most 1.
  float Within(float disparity) const;
};

// The probability that a disparity is right, to within a pixel of parallax of a panorama 1536 wide,
// given the score that matching and fusion left in DisparityMap::confidence; 0 = it has none, its
// disparity was filled in from around. Rising with the score, measured on simulated drives
// (README.md); `omnihdr evaluate` shows how far it holds.
float ProbabilityRight(float score);

// Scores of known disparities, in place, to probabilities: ProbabilityRight times what precision
// allows; that of an unknown one becomes 0.
void CalibrateConfidence(const Image<float>& disparity, const DisparityPrecision& precision,
                         Image<float>* confidence);

// Where the reference itself saw nothing (masked, outside its sensors), makes unknown again what is
// not part of an area that other views agree on: single pixels strewn about are chance; and what
// not two of the neighbours can have seen: maps agree on chance as well where all have the same
// blind side.
void ForgetUnseen(const StereoView& reference, const std::vector<SweepNeighbour>& neighbours,
                  DisparityMap* map);

}  // namespace omnihdr
