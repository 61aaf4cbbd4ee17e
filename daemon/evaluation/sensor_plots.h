#pragma once

#include <span>
#include <string>
#include <vector>

#include "core/photometry/sensor_consistency.h"
#include "daemon/evaluation/plot.h"

namespace omnihdr {

// How linear sensors are, from pictures of a ColorChecker, in two plots with a colour for each
// sensor, which the first one names. First what the grey patches measure (green, linearised)
// against the light they send by the chart's table times the exposure time, beside a line of slope
// 1 through their middle: a sensor above it is more sensitive, a bend is not linear, a flat start
// is stray light. Then how far each of the 24 patches strays from a straight line over the exposure
// times (thesis fig. 3.9), the worst of its channels; empty without three exposures. Clipped and
// dark patches are left out.
std::vector<Plot> SensorPlots(std::span<const SensorChart> charts,
                              const std::vector<std::string>& names,
                              const SensorConsistency& result);

}  // namespace omnihdr
