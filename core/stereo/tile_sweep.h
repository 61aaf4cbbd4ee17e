#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/stereo/cost_volume.h"
#include "core/stereo/lattice.h"

namespace omnihdr {

// Fills a volume tile by tile. `make_tile` gives a worker's own object with
//   void Start(int x0, int y)            the tile whose first pixel that is comes next
//   void Add(const TileRays&, const LabelDisparities&, std::uint16_t* sum)
//                                        adds the costs of a block of the tile's hypotheses
// and a cost is the sum over `divisor`, rounded. Deterministic on any number of cores.
template <typename MakeTile>
void SweepTiles(unsigned divisor, MakeTile make_tile, CostVolume* volume) {
  const auto multiplier =
      static_cast<std::uint16_t>(std::min(65535U, 65536U / std::max(1U, divisor)));
  const std::vector<std::array<float, 2>> columns_of_map = ColumnDirections(volume->width);
  ParallelFor(volume->height, 1, [&](int row_begin, int row_end) {
    const auto tile = make_tile();
    TileRays rays;
    alignas(64) std::array<std::uint16_t, kSweepBlock> sum;
    alignas(64) std::array<std::uint8_t, kSweepBlock> costs;
    for (int y = row_begin; y < row_end; ++y) {
      for (int x0 = 0; x0 < volume->width; x0 += kTileColumns) {
        FillRays(columns_of_map, x0, y, volume->height, &rays);
        tile->Start(x0, y);
        const LabelRange range = volume->range(x0, y);
        std::uint8_t* out = volume->cost.data() + volume->offset(x0, y);
        for (int k = 0; k < range.count; k += kTileLabels) {
          const LabelDisparities disparities = {
              static_cast<float>((range.first + k) * volume->step),
              static_cast<float>(volume->step)};
          sum.fill(0);
          tile->Add(rays, disparities, sum.data());
          NormaliseSums(sum.data(), multiplier, costs.data());
          StoreLabelFastest(costs.data(), std::min(kTileColumns, volume->width - x0),
                            std::min(kTileLabels, range.count - k), range.count, out + k);
        }
      }
    }
  });
}

}  // namespace omnihdr
