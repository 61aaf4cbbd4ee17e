#include "daemon/evaluation/sensor_plots.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

namespace omnihdr {
namespace {

using Colour = std::array<std::uint8_t, 3>;

// Told apart by most eyes (Okabe and Ito 2008), then again from the start.
constexpr std::array<Colour, 8> kColours = {{{0, 114, 178},
                                             {213, 94, 0},
                                             {0, 158, 115},
                                             {204, 121, 167},
                                             {86, 180, 233},
                                             {230, 159, 0},
                                             {90, 90, 90},
                                             {160, 140, 0}}};
constexpr Colour kLine = {120, 120, 120};
constexpr std::size_t kGreen = 1;

PlotSeries DotsOf(const std::string& name, std::size_t sensor) {
  PlotSeries series;
  series.name = name;
  series.colour = kColours[sensor % kColours.size()];
  series.dots = true;
  return series;
}

Plot AgainstReference(std::span<const SensorChart> charts, const std::vector<std::string>& names) {
  Plot plot;
  plot.title = "grey patches, green channel";
  plot.x_label = "light by the chart's table x exposure time, s";
  plot.y_label = "linearised value, 1 at Z = 128";
  plot.log_x = plot.log_y = true;
  double sum = 0.0;
  std::size_t points = 0;
  double least = 0.0;
  double largest = 0.0;
  for (std::size_t s = 0; s < names.size(); ++s) {
    PlotSeries series = DotsOf(names[s], s);
    for (const SensorChart& chart : charts) {
      if (chart.sensor != static_cast<int>(s)) continue;
      for (int p = kChartFirstGrey; p < kChartPatches; ++p) {
        const PatchChannel& patch = chart.chart[static_cast<std::size_t>(p)][kGreen];
        const double light = ChartLinearLight(p)[kGreen] * chart.seconds;
        if (!patch.usable || !(patch.exposure > 0.0)) continue;
        series.x.push_back(light);
        series.y.push_back(patch.exposure);
        sum += std::log(patch.exposure / light);
        least = points == 0 ? light : std::min(least, light);
        largest = std::max(largest, light);
        ++points;
      }
    }
    plot.series.push_back(std::move(series));
  }
  if (points == 0) return plot;
  const double slope = std::exp(sum / static_cast<double>(points));
  plot.series.push_back(
      {"proportional", kLine, {least, largest}, {slope * least, slope * largest}, {}, {}, false});
  return plot;
}

Plot OffTheLine(const SensorConsistency& result) {
  Plot plot;
  plot.title = "linearity over exposure time";
  plot.x_label = "patch (19 to 24: white to black)";
  plot.y_label = "largest distance from a straight line, %";
  for (std::size_t s = 0; s < result.sensors.size(); ++s) {
    PlotSeries series = DotsOf("", s);  // the other plot names the colours
    for (std::size_t p = 0; p < kChartPatches; ++p) {
      double worst = -1.0;
      for (const ExposureLine& line : result.sensors[s].lines[p]) {
        if (line.fitted) worst = std::max(worst, 100.0 * line.deviation);
      }
      if (worst < 0.0) continue;
      series.x.push_back(static_cast<double>(p) + 1.0);
      series.y.push_back(worst);
    }
    plot.series.push_back(std::move(series));
  }
  return plot;
}

}  // namespace

std::vector<Plot> SensorPlots(std::span<const SensorChart> charts,
                              const std::vector<std::string>& names,
                              const SensorConsistency& result) {
  return {AgainstReference(charts, names), OffTheLine(result)};
}

}  // namespace omnihdr
