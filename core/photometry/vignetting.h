#pragma once

#include <Eigen/Core>
#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/photometry/response.h"
#include "core/photometry/sensor_picture.h"
#include "core/sphere/rig.h"

namespace omnihdr {

struct VignettingOptions {
  double value_low = 10.0;  // usable pixel values, 8-bit units
  double value_high = 245.0;
  // Radii (in half diagonals) that samples must reach: at least this share of the lens's largest
  // radius, and none missing between.
  double least_reach = 0.85;
  double rise_tolerance = 0.01;  // the fall-off may rise by this much on its way out
  double worst_error = 0.03;     // largest standard error of the fall-off that is a result
  double worst_residual = 0.05;  // largest rms of ln values about the fit, outliers bounded
};

struct VignettingFit {
  Vignetting vignetting;
  int samples = 0;
  double rho_min = 0.0;  // of the samples
  double rho_max = 0.0;
  double error = 0.0;     // largest standard error of the fall-off in [0, rho_max]
  double at_edge = 1.0;   // fall-off at rho_max
  double residual = 0.0;  // rms of ln values about the fit (Huber's bound on outliers)
};

// A picture of an evenly lit field (a white sheet, an integrating sphere, the overcast zenith).
// Borrowed. `mask`: empty, or the picture's size, 0 = do not use.
struct FlatField {
  const SensorPicture* picture = nullptr;
  ImageView<const std::uint8_t> mask;
};

// The fall-off of one sensor from flat fields: means of small blocks per colour, each picture and
// colour with its own brightness, each picture with its own linear tilt of the light (fields are
// rarely quite even), Huber's loss against dust. `centre`: the lens's, in pixels; `largest_rho`:
// where the lens's image ends (1 = in the corners). Errors (kData): clipped or dark throughout,
// radii not covered, not an even field, a fall-off that rises or is too uncertain, with numbers.
Result<VignettingFit> FitFlatFields(std::span<const FlatField> fields,
                                    const Eigen::Vector2d& centre, double largest_rho,
                                    const Response& response, const VignettingOptions& options);

// What one sensor says about one direction of the scene.
struct OverlapSample {
  int direction = 0;  // samples of the same direction belong together
  int sensor = 0;
  double rho = 0.0;                  // distance from the lens's centre in half diagonals
  std::array<double, 3> exposure{};  // linear light per second; NaN where it is not usable
};

struct OverlapOptions {
  VignettingOptions vignetting;
  // One fall-off for all sensors (lenses of one make), or one for each.
  bool shared = true;
};

struct OverlapFit {
  std::vector<VignettingFit> sensors;  // the same for all when shared
  // Makes the sensors agree, per channel; geometric mean 1 over the sensors.
  std::vector<std::array<double, 3>> gain;
  std::vector<std::array<double, 3>> gain_error;  // relative standard error
  int directions = 0;                             // seen by two sensors or more
  // rms difference of sensors about their common value of a direction, in ln (median based), before
  // and after.
  double difference_before = 0.0;
  double difference_after = 0.0;
};

// Fall-off and relative gains from directions that several sensors see at different radii (or one
// sensor in several rotations of the head): ln E = ln light(direction) + ln falloff(rho) −
// ln gain(sensor), least squares with Huber's loss, the light of each direction eliminated (compare
// Goldman 2010). `largest_rho`: per sensor, where its lens's image ends. Errors (kData): as above,
// and sensors that no common direction links to the first.
Result<OverlapFit> FitOverlaps(std::span<const OverlapSample> input,
                               const std::vector<std::string>& names,
                               const std::vector<double>& largest_rho,
                               const OverlapOptions& options);

// One stand of the head: what each of its sensors saw at the same instant.
struct RigPictures {
  std::vector<const SensorPicture*> sensors;         // in the rig's order; null = none
  std::vector<double> seconds;                       // exposure of each
  std::vector<ImageView<const std::uint8_t>> masks;  // empty, or one a sensor (may be empty)
  // Rotation world_from_rig, when known: then directions of several stands meet.
  std::optional<Eigen::Matrix3d> world_from_rig;
};

// Samples an even grid of directions (`step_deg` apart) at the rig's sphere radius: means over
// small windows, clipped, dark, masked and strongly textured ones left out.
std::vector<OverlapSample> CollectOverlapSamples(const Rig& rig,
                                                 std::span<const RigPictures> stands,
                                                 std::span<const Response> responses,
                                                 double step_deg, const VignettingOptions& options);

// Where the image of a sensor's lens ends, in half diagonals from the lens's centre.
double LargestRho(const RigSensor& sensor);

}  // namespace omnihdr
