#pragma once

#include <Eigen/Core>

#include "core/image/image.h"
#include "core/photometry/measurement.h"

namespace omnihdr {

// As far as clearance is measured, in pixels.
inline constexpr int kMostClearance = 63;

// The picture features are found on: natural logarithm of grey radiance on a Mercator panorama. A
// Mercator map is conformal, so a small patch looks the same (to scale and rotation) wherever the
// camera's motion takes it, and it shares its columns with both the cylinder and the
// equirectangular map. A change of exposure is a constant offset; noise near the floor is softened.
struct FeatureImage {
  int width() const { return log_radiance.width(); }
  int height() const { return log_radiance.height(); }
  // Angle of one pixel at the equator, and, times cosh(ordinate), anywhere.
  double step_rad = 0.0;
  double top_ordinate = 0.0;  // Mercator ordinate asinh(tan(latitude)) of y = 0
  Image<float> log_radiance;  // W×H×1, ln of relative radiance; the left and right borders meet
  Image<float>
      clearance;  // W×H×1, pixels to the nearest one that says nothing, at most kMostClearance
  float softening = 0.0F;  // what was added to the radiance before the logarithm
  // Variance of the relative radiance of one feature pixel: floor + slope · radiance.
  float variance_floor = 0.0F;
  float variance_slope = 0.0F;

  // Unit ray through (x, y), pixel centres at +0.5.
  Eigen::Vector3d RayFromPixel(double x, double y) const;
  // Angle spanned by one pixel at row coordinate y.
  double PixelAngle(double y) const;
};

// `width` at most; never wider than the measurement, and a multiple of 32. Latitudes up to 75°.
// Saturated and masked pixels have clearance 0; masked ones are filled from their surroundings. An
// empty picture (width 0) where the measurement is smaller than 64 columns or holds no usable
// pixel.
FeatureImage MakeFeatureImage(const Measurement& measurement, int width);

}  // namespace omnihdr
