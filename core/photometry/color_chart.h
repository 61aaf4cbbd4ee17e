#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <string_view>
#include <vector>

#include "core/base/result.h"
#include "core/photometry/response.h"
#include "core/photometry/sensor_picture.h"

namespace omnihdr {

// The 24-patch ColorChecker (McCamy, Marcus and Davidson 1976): 6 columns × 4 rows, patches
// numbered row by row from dark skin; the last row is the grey scale from white to black.
inline constexpr int kChartColumns = 6;
inline constexpr int kChartRows = 4;
inline constexpr int kChartPatches = kChartColumns * kChartRows;
// The middle of a patch on the chart, whose patches are squares of side 1.
inline Eigen::Vector2d PatchInChart(int patch) {
  const int row = patch / kChartColumns;
  return {patch % kChartColumns + 0.5, row + 0.5};
}
inline constexpr int kChartFirstGrey = 18;

struct ChartPatchReference {
  std::string_view name;
  std::array<std::uint8_t, 3> srgb;
};
const std::array<ChartPatchReference, kChartPatches>& ChartReference();
// Linear light of a patch, white = 1 in each channel would be a perfect diffuser.
std::array<double, 3> ChartLinearLight(int patch);

// Where a chart lies in a picture. Chart coordinates (u, v): u along the columns, v along the rows,
// one unit from patch to patch; the centre of patch (column c, row r) is (c + 0.5, r + 0.5). They
// go to pixels (centres at +0.5) by a homography and then the division model of lens distortion
// (Fitzgibbon 2001): undistorted = p / (1 + λ·|p|²), p from the picture's centre in half diagonals.
class ChartGeometry {
 public:
  ChartGeometry() = default;
  ChartGeometry(const Eigen::Matrix3d& homography, double lambda, int width, int height);
  // Least squares through pairs of chart and pixel coordinates (at least 4, not on a line), the
  // distortion only with `with_distortion` and 12 pairs or more. Nothing when they fit no chart.
  static std::optional<ChartGeometry> Fit(const std::vector<Eigen::Vector2d>& chart,
                                          const std::vector<Eigen::Vector2d>& pixels, int width,
                                          int height, bool with_distortion);

  // NaN where the model has no image of the point.
  Eigen::Vector2d PixelFromChart(const Eigen::Vector2d& chart) const;
  Eigen::Vector2d PatchCentre(int patch) const;
  // Corners of the square of half-width `half` (in patch steps) around a patch's centre, in the
  // order of chart coordinates (-,-), (+,-), (+,+), (-,+).
  std::array<Eigen::Vector2d, 4> PatchSquare(int patch, double half) const;
  // Mean distance between neighbouring patches, in pixels.
  double PatchStep() const;
  double lambda() const { return lambda_; }

 private:
  Eigen::Matrix3d homography_ = Eigen::Matrix3d::Identity();  // to half diagonals from the centre
  double lambda_ = 0.0;
  Eigen::Vector2d centre_ = Eigen::Vector2d::Zero();
  double half_diagonal_ = 1.0;
};

struct ChartDetection {
  ChartGeometry geometry;
  // The picture shows the chart as a mirror would: columns or rows are stored the wrong way round.
  bool mirrored = false;
  // How the top of the chart lies in the picture, degrees clockwise from up, in [0, 360).
  double rotation_deg = 0.0;
  // Agreement of the patches with the reference colours, correlation in [-1, 1].
  double agreement = 0.0;
  int patches_seen = 0;       // outlined by their own edges; the others are placed by the grid
  double residual = 0.0;      // rms of the outlined ones against the geometry, in patch steps
  bool from_corners = false;  // given by a person
};

struct ChartDetectOptions {
  // Least agreement (correlation of log values with the reference, brightness and colour).
  double least_agreement = 0.80;
  // Least number of patches that must show their own edges.
  int least_patches = 11;
};

// Finds the chart under any rotation, perspective, moderate lens distortion and exposure. Error
// (kData) when there is none: what was seen, and what would help. Deterministic.
Result<ChartDetection> DetectColorChart(const SensorPicture& picture,
                                        const ChartDetectOptions& options);

// The chart whose corner patches (dark skin, bluish green, black, white) have their centres at the
// given pixels; patches that show their own edges refine it. Errors: corners outside the picture or
// not a convex quadrilateral (kUsage), colours that are not the chart's in that order (kData).
Result<ChartDetection> ColorChartAtCorners(const SensorPicture& picture,
                                           const std::array<Eigen::Vector2d, 4>& corners,
                                           const ChartDetectOptions& options);

// One channel of one patch, over the pixels of its inner part.
struct PatchChannel {
  int pixels = 0;
  double mean = 0.0;  // pixel value, 8-bit units
  double median = 0.0;
  double noise = 0.0;     // standard deviation of one pixel, outliers left out
  double clipped = 0.0;   // share of pixels above ChartMeasureOptions::value_high
  double dark = 0.0;      // share of pixels below value_low
  double exposure = 0.0;  // E·t: mean of the linearised pixels
  // Standard error of `exposure`: the noise of one pixel over their number.
  double exposure_error = 0.0;
  // No more than 1 % of the pixels clipped, and not dark.
  bool usable = false;
};
using ChartMeasurement = std::array<std::array<PatchChannel, 3>, kChartPatches>;

struct ChartMeasureOptions {
  double inner = 0.22;  // half-width of the measured square, in patch steps (a patch is about 0.43)
  double value_low = 4.0;
  double value_high = 250.0;
};

// Bayer pictures are measured on their own colour sites, without demosaicing; a grey picture gives
// the same numbers in all three channels. Errors (kData): a patch outside the picture or smaller
// than 8 pixels of a colour.
Result<ChartMeasurement> MeasureChart(const SensorPicture& picture, const ChartGeometry& geometry,
                                      const Response& response, const ChartMeasureOptions& options);

}  // namespace omnihdr
