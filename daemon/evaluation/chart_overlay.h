#pragma once

#include <cstdint>

#include "core/image/image.h"
#include "core/photometry/color_chart.h"

namespace omnihdr {

// The picture as a screen shows it (brightened so that the chart's white is white), with what was
// taken for the chart: every measured square with its patch's number, green where all channels are
// usable, red where one clips, blue where one is dark. Large pictures are shrunk to about 1600
// pixels.
Image<std::uint8_t> DrawChartOverlay(const SensorPicture& picture, const ChartDetection& chart,
                                     const ChartMeasurement& measurement,
                                     const ChartMeasureOptions& options);

}  // namespace omnihdr
