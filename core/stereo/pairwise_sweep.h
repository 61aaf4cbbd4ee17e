#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cstdint>
#include <memory>
#include <vector>

#include "core/image/image.h"
#include "core/stereo/lattice.h"
#include "core/stereo/stereo_view.h"
#include "core/stereo/sweep.h"
#include "core/stereo/tile_sweep.h"

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

// A tile's sums over the pairs of the reference with each neighbour; see SweepPairs.
template <typename AddPairs>
class ReferencePairTile {
 public:
  ReferencePairTile(const TexelLattice& reference, const std::vector<TexelLattice>& neighbours,
                    const std::vector<Eigen::Vector3f>& offsets, const AddPairs& add)
      : reference_(reference), neighbours_(neighbours), offsets_(offsets), add_(add) {}

  void Start(int x0, int y) {
    const std::uint64_t* row =
        reference_.texels.data() + static_cast<std::ptrdiff_t>(2 * y + 1) * (reference_.width + 1);
    const int last = reference_.width / 2 - 1;
    for (int i = 0; i < kSweepBlock; ++i) {
      mine_[static_cast<std::size_t>(i)] = row[2 * std::min(x0 + i % kTileColumns, last) + 1];
    }
  }

  void Add(const TileRays& rays, const LabelDisparities& disparities, std::uint16_t* sum) {
    for (std::size_t n = 0; n < neighbours_.size(); ++n) {
      LatticeIndices(rays, offsets_[n].data(), disparities, neighbours_[n].width,
                     neighbours_[n].height, index_.data());
      GatherTexels(neighbours_[n].texels.data(), index_.data(), theirs_.data());
      add_(n, mine_.data(), theirs_.data(), sum);
    }
  }

 private:
  const TexelLattice& reference_;
  const std::vector<TexelLattice>& neighbours_;
  const std::vector<Eigen::Vector3f>& offsets_;
  const AddPairs& add_;
  alignas(64) std::array<std::int32_t, kSweepBlock> index_;
  alignas(64) std::array<std::uint64_t, kSweepBlock> mine_;
  alignas(64) std::array<std::uint64_t, kSweepBlock> theirs_;
};

// Costs of the reference's texels against those of each neighbour, averaged over neighbours.
// `add(n, reference, neighbour, sum)` adds the costs, at most 255, of a block of kSweepBlock texel
// pairs of neighbour n.
template <typename AddPairs>
CostVolume SweepPairs(const TexelLattice& reference, const std::vector<TexelLattice>& neighbours,
                      const std::vector<Eigen::Vector3f>& offsets, const SweepOptions& options,
                      AddPairs add) {
  CostVolume volume = CostVolume::Allocate(reference.width / 2, reference.height / 2,
                                           options.labels, options.max_disparity, options.ranges);
  SweepTiles(
      static_cast<unsigned>(neighbours.size()),
      [&] {
        return std::make_unique<ReferencePairTile<AddPairs>>(reference, neighbours, offsets, add);
      },
      &volume);
  return volume;
}

}  // namespace omnihdr
