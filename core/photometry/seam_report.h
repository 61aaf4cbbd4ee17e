#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "core/photometry/stitch_source.h"
#include "core/photometry/stitch_table.h"
#include "core/sphere/sphere_grid.h"

namespace omnihdr {

// How two sensors agree where the panorama blends them, per channel. A wrong gain, exposure or
// vignetting moves the ratio; parallax, motion and wrong geometry widen its spread.
struct Seam {
  int first = 0;  // sensors, first < second
  int second = 0;
  // Pixels that both measure, neither clipped nor dark in any channel. On fine panoramas every n-th
  // pixel of both directions, at most about two million in all.
  std::size_t samples = 0;
  // log10 of first over second: median by solid angle, and the median distance from it (MAD). NaN
  // without samples.
  std::array<double, 3> log10_ratio{};
  std::array<double, 3> spread{};
};

// All pairs of sensors that some pixel blends, in rising order. The sensors' own values decide, not
// the blended ones. `grid` is the table's.
std::vector<Seam> MeasureSeams(const StitchTable& table, const StitchSource& source,
                               const SphereGrid& grid);

}  // namespace omnihdr
