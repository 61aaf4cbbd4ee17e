#include "core/stereo/mutual_information.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/sphere/latlong_grid.h"
#include "core/stereo/pairwise_sweep.h"
#include "core/stereo/sgm.h"

namespace omnihdr {
namespace {

constexpr int kCodes = 256;
constexpr int kLargestCost = 144;
constexpr int kLeastLabels = 16;
constexpr double kLeastProbability = 1e-7;

// A table a neighbour: cost of [reference's code][neighbour's code]. Code 0 says nothing.
using CostTable = std::vector<std::uint8_t>;

// Grey codes 1..255 as texels; 0 where the view says nothing.
TexelLattice CodeLattice(const StereoView& view) {
  const Image<std::int16_t> grey = GreyLattice(view);
  TexelLattice lattice;
  lattice.width = view.width;
  lattice.height = view.height;
  lattice.texels.resize(view.texels.size());
  for (int i = 0; i <= view.height; ++i) {
    std::uint64_t* out = lattice.texels.data() + static_cast<std::ptrdiff_t>(i) * (view.width + 1);
    for (int j = 0; j < view.width; ++j) {
      const int code = grey.at(j, i);
      out[j] = code < 0 ? 0U : static_cast<std::uint64_t>(std::clamp((code + 1) / 2, 1, 255));
    }
    out[view.width] = out[0];
  }
  return lattice;
}

// The same on a lattice `factor` times smaller: means of the texels around.
TexelLattice Coarsen(const TexelLattice& fine, int factor) {
  TexelLattice coarse;
  coarse.width = fine.width / factor;
  coarse.height = fine.height / factor;
  coarse.texels.resize(static_cast<std::size_t>(coarse.width + 1) *
                       static_cast<std::size_t>(coarse.height + 1));
  const int reach = factor / 2;
  ParallelFor(coarse.height + 1, 8, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      std::uint64_t* out =
          coarse.texels.data() + static_cast<std::ptrdiff_t>(i) * (coarse.width + 1);
      for (int j = 0; j < coarse.width; ++j) {
        std::uint64_t sum = 0;
        std::uint64_t count = 0;
        for (int dy = -reach; dy <= reach; ++dy) {
          const int y = std::clamp(i * fine.height / coarse.height + dy, 0, fine.height);
          const std::uint64_t* row =
              fine.texels.data() + static_cast<std::ptrdiff_t>(y) * (fine.width + 1);
          for (int dx = -reach; dx <= reach; ++dx) {
            const std::uint64_t code =
                row[(j * fine.width / coarse.width + dx + fine.width) % fine.width];
            sum += code;
            count += code != 0 ? 1 : 0;
          }
        }
        out[j] = count == 0 ? 0 : (sum + count / 2) / count;
      }
      out[coarse.width] = out[0];
    }
  });
  return coarse;
}

Image<std::uint8_t> BrightnessOf(const TexelLattice& lattice) {
  Image<std::uint8_t> brightness(lattice.width / 2, lattice.height / 2);
  for (int y = 0; y < brightness.height(); ++y) {
    const std::uint64_t* row =
        lattice.texels.data() + static_cast<std::ptrdiff_t>(2 * y + 1) * (lattice.width + 1);
    for (int x = 0; x < brightness.width(); ++x) {
      brightness.at(x, y) = static_cast<std::uint8_t>(row[2 * x + 1]);
    }
  }
  return brightness;
}

// Gaussian of one code's width, seven taps, along one axis of a kCodes × kCodes table.
void SmoothAlong(std::ptrdiff_t along, std::ptrdiff_t across, std::vector<double>* table) {
  static constexpr std::array<double, 7> kKernel = {0.0044, 0.0540, 0.2420, 0.3992,
                                                    0.2420, 0.0540, 0.0044};
  std::array<double, kCodes> line{};
  for (int k = 0; k < kCodes; ++k) {
    double* values = table->data() + k * across;
    for (int i = 0; i < kCodes; ++i) {
      double sum = 0.0;
      for (int t = -3; t <= 3; ++t) {
        sum += kKernel[static_cast<std::size_t>(t + 3)] *
               values[std::clamp(i + t, 0, kCodes - 1) * along];
      }
      line[static_cast<std::size_t>(i)] = sum;
    }
    for (int i = 0; i < kCodes; ++i) values[i * along] = line[static_cast<std::size_t>(i)];
  }
}

// Cost table from how often codes meet at the disparities of `map` (reference's pixels).
CostTable TableOf(const TexelLattice& reference, const TexelLattice& neighbour,
                  const Eigen::Vector3f& offset, const Image<float>& map,
                  const MutualInformationOptions& options) {
  const int width = reference.width / 2;
  const int height = reference.height / 2;
  const LatLongGrid grid(width, height);
  const LatLongGrid there(neighbour.width, neighbour.height);
  std::vector<std::uint32_t> counts(static_cast<std::size_t>(kCodes) * kCodes, 0);
  double total = 0.0;
  for (int y = 0; y < height; ++y) {
    const std::uint64_t* row =
        reference.texels.data() + static_cast<std::ptrdiff_t>(2 * y + 1) * (reference.width + 1);
    for (int x = 0; x < width; ++x) {
      const std::uint64_t mine = row[2 * x + 1];
      const float d = map.at(x * map.width() / width, y * map.height() / height);
      if (mine == 0 || !(d >= 0.0F)) continue;
      float px = 0.0F;
      float py = 0.0F;
      there.Point(grid.Ray(x, y) - d * offset, &px, &py);
      const int j = std::clamp(static_cast<int>(px + 0.5F), 0, neighbour.width);
      const int i = std::clamp(static_cast<int>(py + 0.5F), 0, neighbour.height);
      const std::uint64_t theirs =
          neighbour
              .texels[static_cast<std::size_t>(i) * static_cast<std::size_t>(neighbour.width + 1) +
                      static_cast<std::size_t>(j)];
      if (theirs == 0) continue;
      ++counts[static_cast<std::size_t>(mine * kCodes + theirs)];
      total += 1.0;
    }
  }
  CostTable table(counts.size(), 0);
  if (total == 0.0) return table;
  std::vector<double> joint(counts.size());
  for (std::size_t k = 0; k < counts.size(); ++k) joint[k] = counts[k] / total;
  SmoothAlong(1, kCodes, &joint);
  SmoothAlong(kCodes, 1, &joint);
  std::array<double, kCodes> mine{};
  std::array<double, kCodes> theirs{};
  for (std::size_t a = 0; a < kCodes; ++a) {
    for (std::size_t b = 0; b < kCodes; ++b) {
      mine[a] += joint[a * kCodes + b];
      theirs[b] += joint[a * kCodes + b];
    }
  }
  // The logarithms are smoothed as well (Kim et al., eq. 11): the histogram is thin at its rims.
  std::vector<double> information(joint.size());
  for (std::size_t a = 0; a < kCodes; ++a) {
    for (std::size_t b = 0; b < kCodes; ++b) {
      information[a * kCodes + b] = std::log(std::max(joint[a * kCodes + b], kLeastProbability)) -
                                    std::log(std::max(mine[a], kLeastProbability)) -
                                    std::log(std::max(theirs[b], kLeastProbability));
    }
  }
  SmoothAlong(1, kCodes, &information);
  SmoothAlong(kCodes, 1, &information);
  // Each of the reference's codes starts from its own best partner: a constant for a pixel changes
  // no decision, and what is left fits the scale.
  for (std::size_t a = 0; a < kCodes; ++a) {
    const double* row = information.data() + a * kCodes;
    const double best = *std::max_element(row + 1, row + kCodes);
    for (std::size_t b = 1; b < kCodes; ++b) {
      const double cost = (best - row[b]) * static_cast<double>(options.codes_per_nat);
      table[a * kCodes + b] =
          static_cast<std::uint8_t>(std::min(cost + 0.5, static_cast<double>(kLargestCost)));
    }
  }
  return table;
}

CostVolume CostsByTable(const TexelLattice& reference, const std::vector<TexelLattice>& neighbours,
                        const std::vector<Eigen::Vector3f>& offsets,
                        const std::vector<CostTable>& tables, const SweepOptions& options) {
  return SweepPairs(reference, neighbours, offsets, options,
                    [&](std::size_t n, const std::uint64_t* mine, const std::uint64_t* theirs,
                        std::uint16_t* sum) {
                      const std::uint8_t* table = tables[n].data();
                      for (int i = 0; i < kSweepBlock; ++i) {
                        const bool known = mine[i] != 0 && theirs[i] != 0;
                        const unsigned cost = known ? table[mine[i] * kCodes + theirs[i]]
                                                    : static_cast<unsigned>(options.unknown_cost);
                        sum[i] = static_cast<std::uint16_t>(sum[i] + cost);
                      }
                    });
}

}  // namespace

CostVolume MutualInformationCosts(const StereoView& reference,
                                  const std::vector<SweepNeighbour>& neighbours,
                                  const SweepOptions& options,
                                  const MutualInformationOptions& information) {
  const TexelLattice mine = CodeLattice(reference);
  std::vector<TexelLattice> theirs;
  std::vector<Eigen::Vector3f> offsets;
  for (const SweepNeighbour& n : neighbours) {
    theirs.push_back(CodeLattice(*n.view));
    offsets.push_back(n.offset);
  }
  const TexelLattice mine_coarse = Coarsen(mine, information.coarse);
  std::vector<TexelLattice> theirs_coarse;
  for (const TexelLattice& lattice : theirs) {
    theirs_coarse.push_back(Coarsen(lattice, information.coarse));
  }
  SweepOptions coarse = options;
  coarse.labels =
      std::max(std::min(kLeastLabels, options.labels), options.labels / information.coarse);
  coarse.ranges.clear();
  const Image<std::uint8_t> brightness = BrightnessOf(mine_coarse);

  Image<float> map(mine_coarse.width / 2, mine_coarse.height / 2);  // all at infinity
  const auto tables_of = [&](const TexelLattice& from, const std::vector<TexelLattice>& to) {
    std::vector<CostTable> tables(to.size());
    ParallelFor(static_cast<int>(to.size()), 1, [&](int begin, int end) {
      for (int k = begin; k < end; ++k) {
        const auto n = static_cast<std::size_t>(k);
        tables[n] = TableOf(from, to[n], offsets[n], map, information);
      }
    });
    return tables;
  };
  for (int pass = 0; pass < information.passes; ++pass) {
    const CostVolume volume = CostsByTable(mine_coarse, theirs_coarse, offsets,
                                           tables_of(mine_coarse, theirs_coarse), coarse);
    map = OptimiseSemiGlobal(volume, brightness, SgmOptions{}).disparity;
  }
  return CostsByTable(mine, theirs, offsets, tables_of(mine, theirs), options);
}

}  // namespace omnihdr
