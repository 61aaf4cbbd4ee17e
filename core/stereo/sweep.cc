#include "core/stereo/sweep.h"

#include <algorithm>
#include <array>
#include <memory>

#include "core/base/parallel_for.h"
#include "core/base/simd.h"
#include "core/stereo/lattice.h"

namespace omnihdr {
namespace {

constexpr int kPlanes = 8;    // bytes of a texel
constexpr int kMaxViews = 5;  // reference and four neighbours
constexpr int kBlock = kSweepBlock;

// One view's texels for a block of columns, byte by byte, and whether they say anything.
struct Lanes {
  alignas(64) std::array<std::array<std::uint8_t, kBlock>, kPlanes> plane;
  alignas(64) std::array<std::uint8_t, kBlock> known;
};

OMNIHDR_SIMD_CLONES
void Split(const std::uint64_t* texels, Lanes* lanes) {
  for (std::size_t p = 0; p < kPlanes; ++p) {
    std::uint8_t* out = lanes->plane[p].data();
    const auto shift = static_cast<int>(8 * p);
    for (int i = 0; i < kBlock; ++i) out[i] = static_cast<std::uint8_t>(texels[i] >> shift);
  }
  const std::uint8_t* lo = lanes->plane[0].data();
  const std::uint8_t* hi = lanes->plane[1].data();
  for (std::size_t i = 0; i < kBlock; ++i) lanes->known[i] = lo[i] <= hi[i] ? 255 : 0;
}

OMNIHDR_ALWAYS_INLINE std::uint8_t IntervalDistance(std::uint8_t lo_a, std::uint8_t hi_a,
                                                    std::uint8_t lo_b, std::uint8_t hi_b,
                                                    std::uint8_t limit) {
  const auto above = static_cast<std::uint8_t>((lo_a > hi_b ? lo_a : hi_b) - hi_b);
  const auto below = static_cast<std::uint8_t>((lo_b > hi_a ? lo_b : hi_a) - hi_a);
  const std::uint8_t distance = above > below ? above : below;
  return distance < limit ? distance : limit;
}

struct PairLimits {
  std::uint8_t value = 0;
  std::uint8_t gradient = 0;
  std::uint8_t unknown = 0;
  int gradient_shift = 0;
};

// Adds a pair's cost (0..255) times `weight` to the sums.
OMNIHDR_SIMD_CLONES
void AddPair(const Lanes& a, const Lanes& b, const PairLimits& limits, std::uint16_t weight,
             std::uint16_t* sum) {
  const std::uint8_t value = limits.value;
  const std::uint8_t gradient = limits.gradient;
  const std::uint8_t unknown = limits.unknown;
  const int shift = limits.gradient_shift;
  for (std::size_t i = 0; i < kBlock; ++i) {
    const auto red =
        IntervalDistance(a.plane[0][i], a.plane[1][i], b.plane[0][i], b.plane[1][i], value);
    const auto blue =
        IntervalDistance(a.plane[2][i], a.plane[3][i], b.plane[2][i], b.plane[3][i], value);
    const auto gx =
        IntervalDistance(a.plane[4][i], a.plane[5][i], b.plane[4][i], b.plane[5][i], gradient);
    const auto gy =
        IntervalDistance(a.plane[6][i], a.plane[7][i], b.plane[6][i], b.plane[7][i], gradient);
    const auto gradients = static_cast<std::uint8_t>(static_cast<std::uint8_t>(gx + gy) >> shift);
    const auto cost = static_cast<std::uint8_t>(red + blue + gradients);
    const auto known = static_cast<std::uint8_t>(a.known[i] & b.known[i]);
    const std::uint8_t chosen = known != 0 ? cost : unknown;
    sum[i] = static_cast<std::uint16_t>(sum[i] + weight * chosen);
  }
}

}  // namespace

CostVolume SweepCosts(const StereoView& reference, const std::vector<SweepNeighbour>& neighbours,
                      const SweepOptions& options) {
  CostVolume volume;
  volume.width = reference.width / 2;
  volume.height = reference.height / 2;
  volume.labels = options.labels;
  volume.step = options.max_disparity / std::max(1, options.labels - 1);
  volume.cost.resize(static_cast<std::size_t>(volume.width) *
                     static_cast<std::size_t>(volume.height) *
                     static_cast<std::size_t>(volume.labels));
  const std::size_t views = 1 + std::min<std::size_t>(neighbours.size(), kMaxViews - 1);
  const PairLimits limits = {static_cast<std::uint8_t>(options.value_truncation),
                             static_cast<std::uint8_t>(options.gradient_truncation),
                             static_cast<std::uint8_t>(options.unknown_cost),
                             options.gradient_shift};
  // Pairs with the reference count twice: it is the view whose map this is.
  const auto reference_pairs = static_cast<unsigned>(views - 1);
  const unsigned other_pairs = reference_pairs * (reference_pairs - 1) / 2;
  const unsigned total_weight = std::max(1U, 2 * reference_pairs + other_pairs);
  const auto multiplier = static_cast<std::uint16_t>(std::min(65535U, 65536U / total_weight));

  const std::vector<std::array<float, 2>> columns_of_map = ColumnDirections(volume.width);

  ParallelFor(volume.height, 1, [&](int row_begin, int row_end) {
    struct Scratch {
      std::array<Lanes, kMaxViews> lanes;
      RayBlock ray;
      alignas(64) std::array<std::int32_t, kBlock> index;
      alignas(64) std::array<std::uint64_t, kBlock> texels;
      alignas(64) std::array<std::uint16_t, kBlock> sum;
    };
    const auto scratch = std::make_unique<Scratch>();
    std::vector<std::uint8_t> by_label(static_cast<std::size_t>(volume.labels) * kBlock);
    for (int y = row_begin; y < row_end; ++y) {
      const std::uint64_t* reference_row = reference.row(2 * y + 1);
      for (int x0 = 0; x0 < volume.width; x0 += kBlock) {
        const int columns = std::min(kBlock, volume.width - x0);
        FillRays(columns_of_map, x0, y, volume.height, &scratch->ray);
        for (int i = 0; i < kBlock; ++i) {
          const int x = std::min(x0 + i, volume.width - 1);
          scratch->texels[static_cast<std::size_t>(i)] = reference_row[2 * x + 1];
        }
        Split(scratch->texels.data(), &scratch->lanes[0]);
        for (int label = 0; label < volume.labels; ++label) {
          const auto d = static_cast<float>(label * volume.step);
          scratch->sum.fill(0);
          for (std::size_t n = 1; n < views; ++n) {
            const SweepNeighbour& neighbour = neighbours[n - 1];
            LatticeIndices(scratch->ray, neighbour.offset.data(), d, neighbour.view->width,
                           neighbour.view->height, scratch->index.data());
            GatherTexels(neighbour.view->texels.data(), scratch->index.data(),
                         scratch->texels.data());
            Split(scratch->texels.data(), &scratch->lanes[n]);
            for (std::size_t m = 0; m < n; ++m) {
              AddPair(scratch->lanes[m], scratch->lanes[n], limits, m == 0 ? 2 : 1,
                      scratch->sum.data());
            }
          }
          NormaliseSums(scratch->sum.data(), multiplier,
                        by_label.data() + static_cast<std::size_t>(label) * kBlock);
        }
        // Label fastest, as the optimiser walks it.
        std::uint8_t* out = volume.cost.data() +
                            (static_cast<std::size_t>(y) * static_cast<std::size_t>(volume.width) +
                             static_cast<std::size_t>(x0)) *
                                static_cast<std::size_t>(volume.labels);
        StoreLabelFastest(by_label.data(), columns, volume.labels, out);
      }
    }
  });
  return volume;
}

}  // namespace omnihdr
