#pragma once

#include <array>
#include <span>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/photometry/color_chart.h"

namespace omnihdr {

// The chart as one sensor saw it at one exposure.
struct SensorChart {
  int sensor = 0;
  double seconds = 1.0;  // exposure time, gain folded in
  ChartMeasurement chart;
};

// A straight line through a patch's linearised value against exposure time (thesis fig. 3.9).
struct ExposureLine {
  int points = 0;       // exposures in which the patch is usable
  bool fitted = false;  // three or more of them, at different exposures
  double slope = 0.0;   // per second
  double offset = 0.0;  // at zero seconds, as a share of the largest value of the line
  double r_squared = 0.0;
  double deviation = 0.0;  // largest distance from the line, as a share of its largest value
};

struct SensorReport {
  int pictures = 0;
  int exposures = 0;  // different ones
  std::array<std::array<ExposureLine, 3>, kChartPatches> lines{};
  std::array<double, 3> least_r_squared{};  // over the fitted patches; NaN without any
  std::array<double, 3> mean_r_squared{};
  std::array<double, 3> worst_deviation{};
  // Radiance of the grey patches (mean over exposures) against the mean of all sensors, minus 1;
  // NaN where it cannot be said. Before the gains and after.
  std::array<std::array<double, 3>, kChartPatches> difference{};
  std::array<std::array<double, 3>, kChartPatches> difference_after{};
  // Makes all sensors and channels agree on the grey row; the geometric mean of the sensors' green
  // gains is 1.
  std::array<double, 3> gain = {1.0, 1.0, 1.0};
  std::array<double, 3> gain_error{};  // relative standard error
};

struct SensorConsistency {
  std::vector<SensorReport> sensors;
  // Largest |difference| of a sensor's grey patch from the mean of all, per channel.
  std::array<double, 3> worst_difference{};
  std::array<double, 3> worst_difference_after{};
  std::vector<std::string> warnings;
};

// Linearity of every patch over exposures, agreement of the sensors on the grey row and the gains
// that make them agree (two-way additive model of ln E: patch + sensor, per channel; then the
// channels). Supposes the same light on the chart for every sensor. `names` are for messages.
// Errors (kData): no charts, a sensor without two usable grey patches, exposures not positive.
Result<SensorConsistency> CompareSensors(std::span<const SensorChart> charts,
                                         const std::vector<std::string>& names);

}  // namespace omnihdr
