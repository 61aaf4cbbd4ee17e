#pragma once

#include <Eigen/Core>
#include <optional>
#include <span>

#include "core/session/pose_notes.h"
#include "core/session/session.h"
#include "core/sphere/geodesy.h"

namespace omnihdr {

// Where satellites say a camera position was.
struct GnssClue {
  GeodeticPlace place;
  double sigma_m = 0.0;  // one standard deviation of each horizontal axis, > 0
};
// What a fix that states no accuracy is taken to be good for.
inline constexpr double kUnstatedGnssSigma = 3.0;
// The height is known that many times worse than the rest.
inline constexpr double kGnssHeightFactor = 2.0;

// Of a journal line; none without a fix.
std::optional<GnssClue> ClueFromFix(const std::optional<GnssFix>& fix);

// A camera's place by pictures, in its chain's frame and unit, and by satellites.
struct GnssSample {
  Eigen::Vector3d translation = Eigen::Vector3d::Zero();
  GnssClue clue;
};

// How many metres a chain's unit of length is: the robust similarity from the samples' translations
// to their fixes (both have Z up, to some ten degrees; where north is, is not known). Of all
// similarities in the plane that two samples make, the one that most fixes agree with within three
// sigmas begins; Gauss-Newton with Cauchy weights in units of the sigmas ends it. The sigma of the
// scale is that of the normal equations, larger where the fixes scatter more than they state. Up to
// a few dozen samples: the work grows with the cube of their number. Nothing when fewer than four
// fixes agree, fewer than two thirds of all, or the samples do not move.
std::optional<GnssScale> EstimateGnssScale(std::span<const GnssSample> samples);

// Whether a chain of that scale may be told in metres.
bool IsScaleKnown(const GnssScale& scale);
// Whether the fixes contradict that one unit is a metre: by three sigmas and by more than an
// odometer may be off.
bool ContradictsMetres(const GnssScale& scale);

}  // namespace omnihdr
