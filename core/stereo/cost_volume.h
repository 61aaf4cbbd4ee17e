#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/base/large_memory.h"
#include "core/stereo/lattice.h"

namespace omnihdr {

struct DisparityMap;

// Labels searched at the pixels of a tile: first, first + 1, ... count of them.
struct LabelRange {
  int first = 0;
  int count = 0;
  bool operator==(const LabelRange&) const = default;
};

// Matching cost of inverse-distance hypotheses at every pixel of a lat-long map: bytes, label
// fastest, then column, then row. Label k stands for the normalised disparity (1/r) k·step. Which
// labels there are is the same for the kTileColumns pixels of a tile (a piece of a row), and may
// differ from tile to tile.
struct CostVolume {
  int width = 0;
  int height = 0;
  int labels = 0;
  double step = 0.0;
  std::vector<LabelRange> ranges;    // of each tile, TilesPerRow a row
  std::vector<std::size_t> offsets;  // of each tile's first cost
  std::vector<std::uint8_t, LargeAllocator<std::uint8_t>> cost;

  // `step` such that the last label is `max_disparity`. `ranges`: empty = all labels everywhere.
  static CostVolume Allocate(int width, int height, int labels, double max_disparity,
                             std::vector<LabelRange> ranges);
  static int TilesPerRow(int width) { return (width + kTileColumns - 1) / kTileColumns; }

  std::size_t tile(int x, int y) const {
    return static_cast<std::size_t>(y) * static_cast<std::size_t>(TilesPerRow(width)) +
           static_cast<std::size_t>(x / kTileColumns);
  }
  const LabelRange& range(int x, int y) const { return ranges[tile(x, y)]; }
  // Where the costs of a pixel begin: that of its range's first label.
  std::size_t offset(int x, int y) const {
    const std::size_t t = tile(x, y);
    return offsets[t] +
           static_cast<std::size_t>(x % kTileColumns) * static_cast<std::size_t>(ranges[t].count);
  }
  const std::uint8_t* at(int x, int y) const { return cost.data() + offset(x, y); }
};

struct RangeOptions {
  int reach = 1;             // pixels of the guide around a pixel whose disparity may be its own
  double margin = 2.0;       // labels beyond those of the guide, where it is confident
  double more_margin = 3.0;  // labels more where it is not at all
};

// The labels of each tile of a map of width × height that a guide - the same map at the same or
// half the size, without holes - leaves in question: those between the least and the largest
// disparity around, and a margin. Ranges are whole multiples of kTileLabels where `labels` allows.
std::vector<LabelRange> RangesAround(const DisparityMap& guide, int width, int height, int labels,
                                     double max_disparity, const RangeOptions& options);

}  // namespace omnihdr
