#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"

namespace omnihdr {

// Curves to look at. One description, drawn as SVG and as pixels alike.
struct PlotSeries {
  std::string name;  // in the legend; empty = not there
  std::array<std::uint8_t, 3> colour{};
  std::vector<double> x;
  std::vector<double> y;
  // A shaded band from low to high; empty = none. As many as x.
  std::vector<double> low;
  std::vector<double> high;
  bool dots = false;  // points instead of a line
};

struct Plot {
  std::string title;
  std::string x_label;
  std::string y_label;
  bool log_x = false;  // values that are not positive are left out
  bool log_y = false;
  // Share of the height, 0 to below 1, that curves stay out of at the top: where the legend is.
  double headroom = 0.0;
  std::vector<PlotSeries> series;
};

// Plots side by side, `width`×`height` pixels each, on white. Points that are not finite break a
// line. A plot without a finite point shows its empty axes.
std::string PlotsAsSvg(const std::vector<Plot>& plots, int width, int height);
Image<std::uint8_t> PlotsAsPicture(const std::vector<Plot>& plots, int width, int height);

// Writes the plots as the name's ending says, .svg or .png. Errors: another ending (kUsage), a file
// that cannot be written.
Status WritePlots(const std::string& file, const std::vector<Plot>& plots);

}  // namespace omnihdr
