#include "core/stereo/sweep.h"

#include <algorithm>
#include <array>
#include <memory>
#include <utility>

#include "core/base/simd.h"
#include "core/stereo/cost_aggregation.h"
#include "core/stereo/lattice.h"
#include "core/stereo/tile_sweep.h"

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

// In halves, quarters and eighths: each step is one that vectors have an instruction for.
OMNIHDR_SIMD_CLONES
void Split(const std::uint64_t* texels, Lanes* lanes) {
  alignas(64) std::array<std::array<std::uint32_t, kBlock>, 2> half;
  for (int i = 0; i < kBlock; ++i)
    half[0][static_cast<std::size_t>(i)] = static_cast<std::uint32_t>(texels[i]);
  for (int i = 0; i < kBlock; ++i)
    half[1][static_cast<std::size_t>(i)] = static_cast<std::uint32_t>(texels[i] >> 32U);
  alignas(64) std::array<std::array<std::uint16_t, kBlock>, 4> quarter;
  for (std::size_t h = 0; h < half.size(); ++h) {
    const std::uint32_t* in = half[h].data();
    std::uint16_t* low = quarter[2 * h].data();
    std::uint16_t* high = quarter[2 * h + 1].data();
    for (int i = 0; i < kBlock; ++i) low[i] = static_cast<std::uint16_t>(in[i]);
    for (int i = 0; i < kBlock; ++i) high[i] = static_cast<std::uint16_t>(in[i] >> 16U);
  }
  for (std::size_t q = 0; q < quarter.size(); ++q) {
    const std::uint16_t* in = quarter[q].data();
    std::uint8_t* low = lanes->plane[2 * q].data();
    std::uint8_t* high = lanes->plane[2 * q + 1].data();
    for (int i = 0; i < kBlock; ++i) low[i] = static_cast<std::uint8_t>(in[i]);
    for (int i = 0; i < kBlock; ++i) high[i] = static_cast<std::uint8_t>(in[i] >> 8U);
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

// A tile's sums over all pairs of views.
class PairTile {
 public:
  PairTile(const StereoView& reference, const std::vector<SweepNeighbour>& neighbours,
           std::size_t views, const PairLimits& limits)
      : reference_(reference), neighbours_(neighbours), views_(views), limits_(limits) {}

  void Start(int x0, int y) {
    const std::uint64_t* row = reference_.row(2 * y + 1);
    const int last = reference_.width / 2 - 1;
    for (int i = 0; i < kBlock; ++i) {
      texels_[static_cast<std::size_t>(i)] = row[2 * std::min(x0 + i % kTileColumns, last) + 1];
    }
    Split(texels_.data(), &lanes_[0]);
  }

  void Add(const TileRays& rays, const LabelDisparities& disparities, std::uint16_t* sum) {
    for (std::size_t n = 1; n < views_; ++n) {
      const SweepNeighbour& neighbour = neighbours_[n - 1];
      LatticeIndices(rays, neighbour.offset.data(), disparities, neighbour.view->width,
                     neighbour.view->height, index_.data());
      GatherTexels(neighbour.view->texels.data(), index_.data(), texels_.data());
      Split(texels_.data(), &lanes_[n]);
      // Pairs with the reference count twice: it is the view whose map this is.
      for (std::size_t m = 0; m < n; ++m) {
        AddPair(lanes_[m], lanes_[n], limits_, m == 0 ? 2 : 1, sum);
      }
    }
  }

 private:
  const StereoView& reference_;
  const std::vector<SweepNeighbour>& neighbours_;
  std::size_t views_;
  PairLimits limits_;
  std::array<Lanes, kMaxViews> lanes_;
  alignas(64) std::array<std::int32_t, kBlock> index_;
  alignas(64) std::array<std::uint64_t, kBlock> texels_;
};

}  // namespace

CostVolume SweepCosts(const StereoView& reference, const std::vector<SweepNeighbour>& neighbours,
                      const SweepOptions& options) {
  CostVolume volume = CostVolume::Allocate(reference.width / 2, reference.height / 2,
                                           options.labels, options.max_disparity, options.ranges);
  const std::size_t views = 1 + std::min<std::size_t>(neighbours.size(), kMaxViews - 1);
  const PairLimits limits = {static_cast<std::uint8_t>(options.value_truncation),
                             static_cast<std::uint8_t>(options.gradient_truncation),
                             static_cast<std::uint8_t>(options.unknown_cost),
                             options.gradient_shift};
  const auto reference_pairs = static_cast<unsigned>(views - 1);
  const unsigned other_pairs = reference_pairs * (reference_pairs - 1) / 2;
  SweepTiles(
      2 * reference_pairs + other_pairs,
      [&] { return std::make_unique<PairTile>(reference, neighbours, views, limits); }, &volume);
  return options.aggregates ? AggregateCosts(volume) : std::move(volume);
}

}  // namespace omnihdr
