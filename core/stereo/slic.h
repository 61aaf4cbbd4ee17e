#pragma once

#include <cstdint>

#include "core/image/image.h"

namespace omnihdr {

struct SlicOptions {
  int side_px = 24;           // of the grid cell each superpixel starts from, 4 to 256
  double compactness = 10.0;  // colour codes that weigh as much as one cell's side, > 0
  int iterations = 5;         // 1 to 50
};

struct Superpixels {
  Image<std::int32_t> label;  // 0 .. count - 1, each one 4-connected piece
  int count = 0;
};

// Simple linear iterative clustering (Achanta et al. 2012) of a lat-long picture of three 8-bit
// channels, W×H×3, in which equal steps are equally visible (LogColours). Columns close round the
// globe, and a step along a row counts sin(polar angle) of one along a column. A pixel considers
// the nine centres whose cells lie around it, as gSLIC does (Ren and Reid 2011), which keeps the
// inner loop over neighbours in memory. Pieces smaller than a quarter of a cell join a neighbour.
// Deterministic on any number of cores. The picture must be at least 3·side_px wide.
Superpixels FindSuperpixels(ImageView<const std::uint8_t> picture, const SlicOptions& options);

}  // namespace omnihdr
