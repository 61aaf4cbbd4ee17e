#include "core/stereo/pairwise_costs.h"

#include <algorithm>
#include <bit>
#include <cstdlib>

#include "core/base/simd.h"
#include "core/stereo/mutual_information.h"
#include "core/stereo/pairwise_sweep.h"

namespace omnihdr {
namespace {

constexpr std::uint64_t kKnown = 1ULL << 63U;
constexpr int kStep = 2;               // lattice texels a map pixel, each side
constexpr int kRadius = 3;             // of the census window, in map pixels
constexpr unsigned kCensusWeight = 3;  // 48 bits to the scale of the other costs

TexelLattice EmptyLattice(const StereoView& view) {
  TexelLattice lattice;
  lattice.width = view.width;
  lattice.height = view.height;
  lattice.texels.assign(view.texels.size(), 0);
  return lattice;
}

std::uint64_t* RowOf(TexelLattice& lattice, int i) {
  return lattice.texels.data() + static_cast<std::ptrdiff_t>(i) * (lattice.width + 1);
}

// Mean over a square of 2·radius + 1 texels of what is known in it; rows end at the poles.
Image<float> LocalMean(const Image<std::int16_t>& grey, int radius) {
  const int width = grey.width();
  const int height = grey.height();
  Image<std::int32_t> sums(width, height, 2);  // over each row: sum, count
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      const std::int16_t* row = grey.row(y);
      std::int32_t sum = 0;
      std::int32_t count = 0;
      const auto take = [&](int x, int sign) {
        const std::int16_t v = row[(x % width + width) % width];
        if (v < 0) return;
        sum += sign * v;
        count += sign;
      };
      for (int x = -radius; x < radius; ++x) take(x, 1);
      for (int x = 0; x < width; ++x) {
        take(x + radius, 1);
        sums.at(x, y, 0) = sum;
        sums.at(x, y, 1) = count;
        take(x - radius, -1);
      }
    }
  });
  Image<float> mean(width, height);
  ParallelFor(height, 32, [&](int begin, int end) {
    std::vector<std::int32_t> total(2 * static_cast<std::size_t>(width), 0);
    const auto take = [&](int y, int sign) {
      if (y < 0 || y >= height) return;
      const std::int32_t* row = sums.row(y);
      for (std::size_t k = 0; k < total.size(); ++k) total[k] += sign * row[k];
    };
    for (int y = begin - radius; y < begin + radius; ++y) take(y, 1);
    for (int y = begin; y < end; ++y) {
      take(y + radius, 1);
      for (int x = 0; x < width; ++x) {
        const auto k = 2 * static_cast<std::size_t>(x);
        mean.at(x, y) = total[k + 1] > 0
                            ? static_cast<float>(total[k]) / static_cast<float>(total[k + 1])
                            : 0.0F;
      }
      take(y - radius, -1);
    }
  });
  return mean;
}

std::uint64_t Code(int difference, int position) {
  return static_cast<std::uint64_t>(std::clamp(128 + difference, 0, 255)) << (8 * position);
}

// Bytes: value less local mean, derivative along the row, along the column, in half codes.
TexelLattice AdjustedLattice(const StereoView& view, int mean_radius) {
  const Image<std::int16_t> grey = GreyLattice(view);
  const Image<float> mean = LocalMean(grey, kStep * mean_radius);
  TexelLattice lattice = EmptyLattice(view);
  ParallelFor(view.height + 1, 16, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      std::uint64_t* out = RowOf(lattice, i);
      const std::int16_t* row = grey.row(i);
      const std::int16_t* above = grey.row(std::max(0, i - kStep));
      const std::int16_t* below = grey.row(std::min(view.height, i + kStep));
      for (int j = 0; j < view.width; ++j) {
        if (row[j] < 0) continue;
        const auto derivative = [](int before, int after) {
          return before < 0 || after < 0 ? 0 : after - before;
        };
        const int left = row[(j + view.width - kStep) % view.width];
        const int right = row[(j + kStep) % view.width];
        const float adjusted = static_cast<float>(row[j]) - mean.at(j, i);
        out[j] = Code(static_cast<int>(adjusted + (adjusted < 0.0F ? -0.5F : 0.5F)), 0) |
                 Code(derivative(left, right), 1) | Code(derivative(above[j], below[j]), 2) |
                 kKnown;
      }
      out[view.width] = out[0];
    }
  });
  return lattice;
}

OMNIHDR_SIMD_CLONES
void AddAdjusted(const std::uint64_t* a, const std::uint64_t* b, int truncation, int value_weight,
                 int gradient_weight, int unknown, std::uint16_t* sum) {
  for (int i = 0; i < kSweepBlock; ++i) {
    const auto distance = [&](unsigned shift) {
      const auto p = static_cast<int>((a[i] >> shift) & 0xFFU);
      const auto q = static_cast<int>((b[i] >> shift) & 0xFFU);
      const int gap = p > q ? p - q : q - p;
      return gap < truncation ? gap : truncation;
    };
    const int cost = value_weight * distance(0) + gradient_weight * (distance(8) + distance(16));
    const bool known = (a[i] & b[i] & kKnown) != 0;
    const int chosen = known ? (cost < 255 ? cost : 255) : unknown;
    sum[i] = static_cast<std::uint16_t>(sum[i] + chosen);
  }
}

// One bit a neighbour: whether it is darker than the centre.
OMNIHDR_SIMD_CLONES
void CompareRow(const std::int16_t* centre, const std::int16_t* other, int count, unsigned bit,
                std::uint64_t* out) {
  for (int j = 0; j < count; ++j) {
    out[j] |= static_cast<std::uint64_t>(other[j] < centre[j] ? 1U : 0U) << bit;
  }
}

TexelLattice CensusLattice(const StereoView& view) {
  const Image<std::int16_t> grey = GreyLattice(view);
  constexpr int kReach = kStep * kRadius;
  const int padded_width = view.width + 2 * kReach;
  Image<std::int16_t> padded(padded_width, view.height + 1);
  for (int i = 0; i <= view.height; ++i) {
    for (int j = 0; j < padded_width; ++j) {
      padded.at(j, i) = grey.at((j - kReach + view.width) % view.width, i);
    }
  }
  TexelLattice lattice = EmptyLattice(view);
  ParallelFor(view.height + 1, 16, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      std::uint64_t* out = RowOf(lattice, i);
      const std::int16_t* centre = padded.row(i) + kReach;
      unsigned bit = 0;
      for (int dy = -kRadius; dy <= kRadius; ++dy) {
        const std::int16_t* other = padded.row(std::clamp(i + kStep * dy, 0, view.height)) + kReach;
        for (int dx = -kRadius; dx <= kRadius; ++dx) {
          if (dx == 0 && dy == 0) continue;
          CompareRow(centre, other + static_cast<std::ptrdiff_t>(kStep) * dx, view.width, bit++,
                     out);
        }
      }
      for (int j = 0; j < view.width; ++j) out[j] = centre[j] < 0 ? 0 : out[j] | kKnown;
      out[view.width] = out[0];
    }
  });
  return lattice;
}

OMNIHDR_SIMD_CLONES
void AddCensus(const std::uint64_t* a, const std::uint64_t* b, unsigned unknown,
               std::uint16_t* sum) {
  for (int i = 0; i < kSweepBlock; ++i) {
    const auto bits = static_cast<unsigned>(std::popcount(a[i] ^ b[i]));
    const unsigned cost = (a[i] & b[i] & kKnown) != 0 ? kCensusWeight * bits : unknown;
    sum[i] = static_cast<std::uint16_t>(sum[i] + cost);
  }
}

template <typename Describe>
std::vector<TexelLattice> DescribeAll(const std::vector<SweepNeighbour>& neighbours,
                                      Describe describe) {
  std::vector<TexelLattice> lattices;
  for (const SweepNeighbour& n : neighbours) lattices.push_back(describe(*n.view));
  return lattices;
}

std::vector<Eigen::Vector3f> OffsetsOf(const std::vector<SweepNeighbour>& neighbours) {
  std::vector<Eigen::Vector3f> offsets;
  for (const SweepNeighbour& n : neighbours) offsets.push_back(n.offset);
  return offsets;
}

}  // namespace

Image<std::int16_t> GreyLattice(const StereoView& view) {
  Image<std::int16_t> grey(view.width, view.height + 1);
  ParallelFor(view.height + 1, 32, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      const std::uint64_t* texels = view.row(i);
      std::int16_t* out = grey.row(i);
      for (int j = 0; j < view.width; ++j) {
        const auto byte = [t = texels[j]](unsigned k) {
          return static_cast<int>((t >> (8 * k)) & 0xFFU);
        };
        const auto value = [](int lo, int hi) { return lo == 0 ? hi : lo; };
        out[j] = static_cast<std::int16_t>(
            byte(0) > byte(1) ? -1 : value(byte(0), byte(1)) + value(byte(2), byte(3)));
      }
    }
  });
  return grey;
}

CostVolume RadiometricCosts(const StereoView& reference,
                            const std::vector<SweepNeighbour>& neighbours,
                            const SweepOptions& options, const RadiometricOptions& radiometric) {
  const auto describe = [&](const StereoView& view) {
    return AdjustedLattice(view, radiometric.mean_radius);
  };
  return SweepPairs(
      describe(reference), DescribeAll(neighbours, describe), OffsetsOf(neighbours), options,
      [&](std::size_t, const std::uint64_t* mine, const std::uint64_t* theirs, std::uint16_t* sum) {
        AddAdjusted(mine, theirs, radiometric.truncation, radiometric.value_weight,
                    radiometric.gradient_weight, options.unknown_cost, sum);
      });
}

CostVolume CensusCosts(const StereoView& reference, const std::vector<SweepNeighbour>& neighbours,
                       const SweepOptions& options) {
  return SweepPairs(
      CensusLattice(reference), DescribeAll(neighbours, CensusLattice), OffsetsOf(neighbours),
      options,
      [&](std::size_t, const std::uint64_t* mine, const std::uint64_t* theirs, std::uint16_t* sum) {
        AddCensus(mine, theirs, static_cast<unsigned>(options.unknown_cost), sum);
      });
}

CostVolume MatchingCosts(StereoCost cost, const StereoView& reference,
                         const std::vector<SweepNeighbour>& neighbours,
                         const SweepOptions& options) {
  switch (cost) {
    case StereoCost::kInterval:
      break;
    case StereoCost::kRadiometric:
      return RadiometricCosts(reference, neighbours, options, {});
    case StereoCost::kCensus:
      return CensusCosts(reference, neighbours, options);
    case StereoCost::kMutualInformation:
      return MutualInformationCosts(reference, neighbours, options, {});
  }
  return SweepCosts(reference, neighbours, options);
}

}  // namespace omnihdr
