#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/image/image.h"
#include "core/stereo/lattice.h"
#include "core/stereo/stereo_view.h"
#include "core/stereo/sweep.h"

namespace omnihdr {

// A lattice like StereoView's with any eight bytes a texel.
struct TexelLattice {
  int width = 0;
  int height = 0;
  std::vector<std::uint64_t> texels;  // (height + 1) rows of (width + 1)
};

// Sum of a view's red and blue log codes at every texel, lattice rows without the repeated column;
// -1 where the view says nothing. A bound counts as a value.
Image<std::int16_t> GreyLattice(const StereoView& view);

// Costs of the reference's texels against those of each neighbour, averaged over neighbours.
// `add(n, reference, neighbour, sum)` adds the costs, at most 255, of a block of kSweepBlock texel
// pairs of neighbour n.
template <typename AddPairs>
CostVolume SweepPairs(const TexelLattice& reference, const std::vector<TexelLattice>& neighbours,
                      const std::vector<Eigen::Vector3f>& offsets, const SweepOptions& options,
                      AddPairs add) {
  CostVolume volume;
  volume.width = reference.width / 2;
  volume.height = reference.height / 2;
  volume.labels = options.labels;
  volume.step = options.max_disparity / std::max(1, options.labels - 1);
  const auto labels = static_cast<std::size_t>(volume.labels);
  volume.cost.resize(static_cast<std::size_t>(volume.width) *
                     static_cast<std::size_t>(volume.height) * labels);
  const auto pairs = static_cast<unsigned>(std::max<std::size_t>(1, neighbours.size()));
  const auto multiplier = static_cast<std::uint16_t>(std::min(65535U, 65536U / pairs));
  const std::vector<std::array<float, 2>> columns_of_map = ColumnDirections(volume.width);
  ParallelFor(volume.height, 1, [&](int row_begin, int row_end) {
    struct Scratch {
      RayBlock ray;
      alignas(64) std::array<std::int32_t, kSweepBlock> index;
      alignas(64) std::array<std::uint64_t, kSweepBlock> mine;
      alignas(64) std::array<std::uint64_t, kSweepBlock> theirs;
      alignas(64) std::array<std::uint16_t, kSweepBlock> sum;
    };
    const auto scratch = std::make_unique<Scratch>();
    std::vector<std::uint8_t> by_label(labels * kSweepBlock);
    for (int y = row_begin; y < row_end; ++y) {
      const std::uint64_t* reference_row =
          reference.texels.data() + static_cast<std::ptrdiff_t>(2 * y + 1) * (reference.width + 1);
      for (int x0 = 0; x0 < volume.width; x0 += kSweepBlock) {
        FillRays(columns_of_map, x0, y, volume.height, &scratch->ray);
        for (int i = 0; i < kSweepBlock; ++i) {
          scratch->mine[static_cast<std::size_t>(i)] =
              reference_row[2 * std::min(x0 + i, volume.width - 1) + 1];
        }
        for (int label = 0; label < volume.labels; ++label) {
          scratch->sum.fill(0);
          for (std::size_t n = 0; n < neighbours.size(); ++n) {
            LatticeIndices(scratch->ray, offsets[n].data(), static_cast<float>(label * volume.step),
                           neighbours[n].width, neighbours[n].height, scratch->index.data());
            GatherTexels(neighbours[n].texels.data(), scratch->index.data(),
                         scratch->theirs.data());
            add(n, scratch->mine.data(), scratch->theirs.data(), scratch->sum.data());
          }
          NormaliseSums(scratch->sum.data(), multiplier,
                        by_label.data() + static_cast<std::size_t>(label) * kSweepBlock);
        }
        StoreLabelFastest(by_label.data(), std::min(kSweepBlock, volume.width - x0), volume.labels,
                          volume.cost.data() + (static_cast<std::size_t>(y) *
                                                    static_cast<std::size_t>(volume.width) +
                                                static_cast<std::size_t>(x0)) *
                                                   labels);
      }
    }
  });
  return volume;
}

}  // namespace omnihdr
