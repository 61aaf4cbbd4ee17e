#include "core/stereo/cost_aggregation.h"

#include <algorithm>
#include <array>
#include <cstdint>
#include <cstring>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/base/simd.h"

namespace omnihdr {
namespace {

constexpr int kRows = 3;
constexpr std::size_t kPixels = 9;

// 2^16 over the number of costs in a sum.
constexpr std::array<std::uint32_t, kPixels + 1> kReciprocal = [] {
  std::array<std::uint32_t, kPixels + 1> table{};
  for (std::uint32_t n = 1; n <= kPixels; ++n) table[n] = (65536 + n / 2) / n;
  return table;
}();

// At most 255: the reciprocals are near enough for that.
std::uint8_t Rounded(std::uint32_t sum, std::uint32_t reciprocal) {
  return static_cast<std::uint8_t>((sum * reciprocal + 32768U) >> 16U);
}

constexpr int kLanes = 8;  // labels worked on at a time
using Bytes = std::uint8_t __attribute__((vector_size(kLanes)));
using Sums = std::uint16_t __attribute__((vector_size(2 * kLanes)));
using Wide = std::uint32_t __attribute__((vector_size(4 * kLanes)));

// The same kLanes labels at the pixels of one tile, one after the other. Labels that are not
// searched there are read as well, from the pixels before and after, and masked.
struct TileLabels {
  const std::uint8_t* at = nullptr;
  std::ptrdiff_t stride = 0;  // from pixel to pixel
  Bytes mask{};
};
// Those of three rows' tiles.
struct ColumnLabels {
  std::array<TileLabels, kRows> row;
  Wide searched{};  // by label: in how many of the rows
};

OMNIHDR_ALWAYS_INLINE Sums SumOfColumn(const ColumnLabels& labels, std::ptrdiff_t column) {
  Sums sum{};
  for (const TileLabels& row : labels.row) {
    Bytes bytes;
    std::memcpy(&bytes, row.at + column * row.stride, sizeof bytes);
    sum += __builtin_convertvector(bytes & row.mask, Sums);
  }
  return sum;
}

OMNIHDR_ALWAYS_INLINE void StoreMean(const Sums& sum, const Wide& reciprocal, std::uint8_t* to) {
  const Wide mean = (__builtin_convertvector(sum, Wide) * reciprocal + 32768U) >> 16U;
  const Bytes bytes = __builtin_convertvector(mean, Bytes);
  std::memcpy(to, &bytes, sizeof bytes);
}

OMNIHDR_ALWAYS_INLINE Wide Reciprocals(const Wide& count) {
  Wide reciprocal{};
  for (int i = 0; i < kLanes; ++i) reciprocal[i] = kReciprocal[count[i]];
  return reciprocal;
}

// Means of kLanes labels at a tile's pixels: `left` is the column before, `right` that behind.
OMNIHDR_SIMD_CLONES
void MeansOfTile(const ColumnLabels& left, const ColumnLabels& own, const ColumnLabels& right,
                 int columns, std::ptrdiff_t stride, std::uint8_t* to) {
  const Wide inside = Reciprocals(own.searched + own.searched + own.searched);
  const Wide first = Reciprocals(left.searched + own.searched + own.searched);
  const Wide last = Reciprocals(own.searched + own.searched + right.searched);
  Sums before = SumOfColumn(left, 0);
  Sums here = SumOfColumn(own, 0);
  for (std::ptrdiff_t i = 0; i + 1 < columns; ++i) {
    const Sums next = SumOfColumn(own, i + 1);
    StoreMean(before + here + next, i == 0 ? first : inside, to + i * stride);
    before = here;
    here = next;
  }
  StoreMean(before + here + SumOfColumn(right, 0), last, to + (columns - 1) * stride);
}

OMNIHDR_SIMD_CLONES
void AddRows(const std::uint8_t* __restrict above, const std::uint8_t* __restrict middle,
             const std::uint8_t* __restrict below, int count, std::uint16_t* __restrict sum) {
  for (int k = 0; k < count; ++k) {
    sum[k] = static_cast<std::uint16_t>(above[k] + middle[k] + below[k]);
  }
}

// `sum`: of three rows, from the pixel left of the first one on, `labels` values each.
OMNIHDR_SIMD_CLONES
void MeanOfColumns(const std::uint16_t* __restrict sum, int count, int labels,
                   std::uint8_t* __restrict mean) {
  const std::uint16_t* __restrict middle = sum + labels;
  const std::uint16_t* __restrict right = sum + 2 * labels;
  for (int k = 0; k < count; ++k) {
    const std::uint32_t nine = std::uint32_t{sum[k]} + middle[k] + right[k];
    mean[k] = static_cast<std::uint8_t>((nine * kReciprocal[kPixels] + 32768U) >> 16U);
  }
}

OMNIHDR_SIMD_CLONES
void AddLabels(const std::uint8_t* __restrict cost, int count, std::uint16_t* __restrict sum,
               std::uint8_t* __restrict pixels) {
  for (int k = 0; k < count; ++k) sum[k] = static_cast<std::uint16_t>(sum[k] + cost[k]);
  for (int k = 0; k < count; ++k) pixels[k] = static_cast<std::uint8_t>(pixels[k] + 1);
}

// A worker's own object.
class Aggregator {
 public:
  Aggregator(const CostVolume& in, CostVolume* out)
      : in_(in),
        out_(out),
        sum_(static_cast<std::size_t>(kTileColumns + 2) * static_cast<std::size_t>(in.labels)),
        pixels_(static_cast<std::size_t>(in.labels)) {}

  void Row(int y) {
    rows_ = {std::max(0, y - 1), y, std::min(in_.height - 1, y + 1)};
    for (int x = 0; x < in_.width; x += kTileColumns) {
      const int columns = std::min(kTileColumns, in_.width - x);
      if (SameLabelsAround(x, columns)) {
        EvenTile(x, columns);
      } else if (columns > 1 && in_.range(x, y).count >= kLanes && MayReadAround(x, columns)) {
        UnevenTile(x, columns);
      } else {
        for (int i = 0; i < columns; ++i) Pixel(x + i);
      }
    }
  }

 private:
  int Wrapped(int x) const { return x < 0 ? x + in_.width : (x < in_.width ? x : x - in_.width); }

  bool SameLabelsAround(int x, int columns) const {
    const LabelRange& own = in_.range(x, rows_[1]);
    for (const int y : rows_) {
      for (const int u : {Wrapped(x - 1), x, Wrapped(x + columns)}) {
        if (!(in_.range(u, y) == own)) return false;
      }
    }
    return true;
  }

  // All labels of a tile's pixels lie one after the other, and line up with those around.
  void EvenTile(int x, int columns) {
    const int labels = in_.range(x, rows_[1]).count;
    const auto add = [&](int u, int pixels, int at) {
      AddRows(in_.at(u, rows_[0]), in_.at(u, rows_[1]), in_.at(u, rows_[2]), pixels * labels,
              sum_.data() + static_cast<std::ptrdiff_t>(at) * labels);
    };
    add(Wrapped(x - 1), 1, 0);
    add(x, columns, 1);
    add(Wrapped(x + columns), 1, columns + 1);
    MeanOfColumns(sum_.data(), columns * labels, labels, To(x));
  }

  // Whether there are costs before and after those of all pixels that a tile's means are of.
  bool MayReadAround(int x, int columns) const {
    for (const int y : rows_) {
      for (const int u : {Wrapped(x - 1), x, x + columns - 1, Wrapped(x + columns)}) {
        const std::size_t offset = in_.offset(u, y);
        const auto end = offset + static_cast<std::size_t>(in_.range(u, y).count);
        if (offset < kLanes || end + kLanes > in_.cost.size()) return false;
      }
    }
    return true;
  }

  // The labels from `label` on at the pixels from `x` on.
  ColumnLabels LabelsAt(int x, int label) const {
    ColumnLabels labels;
    for (std::size_t k = 0; k < kRows; ++k) {
      const LabelRange& there = in_.range(x, rows_[k]);
      TileLabels& row = labels.row[k];
      const int skipped = label - there.first;
      if (skipped <= -kLanes || skipped >= there.count) {
        row.at = in_.cost.data();  // all masked
        continue;
      }
      row.at = in_.at(x, rows_[k]) + skipped;
      row.stride = there.count;
      for (int i = 0; i < kLanes; ++i) {
        const bool searched = skipped + i >= 0 && skipped + i < there.count;
        row.mask[i] = searched ? 255 : 0;
        labels.searched[i] += searched ? 1U : 0U;
      }
    }
    return labels;
  }

  void UnevenTile(int x, int columns) {
    const LabelRange& own = in_.range(x, rows_[1]);
    std::uint8_t* to = To(x);
    for (int k = 0; k < own.count; k += kLanes) {
      // The last labels once more where their number is no multiple.
      const int first = std::min(k, own.count - kLanes);
      MeansOfTile(LabelsAt(Wrapped(x - 1), own.first + first), LabelsAt(x, own.first + first),
                  LabelsAt(Wrapped(x + columns), own.first + first), columns, own.count,
                  to + first);
    }
  }

  void Pixel(int x) {
    const LabelRange& own = in_.range(x, rows_[1]);
    const int end = own.first + own.count;
    std::fill_n(sum_.begin(), own.count, std::uint16_t{0});
    std::fill_n(pixels_.begin(), own.count, std::uint8_t{0});
    for (const int y : rows_) {
      for (int dx = -1; dx <= 1; ++dx) {
        const int u = Wrapped(x + dx);
        const LabelRange& there = in_.range(u, y);
        const int first = std::max(own.first, there.first);
        const int count = std::min(end, there.first + there.count) - first;
        if (count <= 0) continue;
        AddLabels(in_.at(u, y) + (first - there.first), count, sum_.data() + (first - own.first),
                  pixels_.data() + (first - own.first));
      }
    }
    std::uint8_t* to = To(x);
    for (std::size_t k = 0; k < static_cast<std::size_t>(own.count); ++k) {
      to[k] = Rounded(sum_[k], kReciprocal[pixels_[k]]);
    }
  }

  std::uint8_t* To(int x) const { return out_->cost.data() + out_->offset(x, rows_[1]); }

  const CostVolume& in_;
  CostVolume* out_;
  std::array<int, kRows> rows_{};
  std::vector<std::uint16_t> sum_;
  std::vector<std::uint8_t> pixels_;
};

}  // namespace

CostVolume AggregateCosts(const CostVolume& volume) {
  CostVolume out;
  out.width = volume.width;
  out.height = volume.height;
  out.labels = volume.labels;
  out.step = volume.step;
  out.ranges = volume.ranges;
  out.offsets = volume.offsets;
  out.cost.resize(volume.cost.size());
  ParallelFor(volume.height, 4, [&](int begin, int end) {
    Aggregator aggregator(volume, &out);
    for (int y = begin; y < end; ++y) aggregator.Row(y);
  });
  return out;
}

}  // namespace omnihdr
