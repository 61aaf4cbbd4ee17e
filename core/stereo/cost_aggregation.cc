#include "core/stereo/cost_aggregation.h"

#include <algorithm>
#include <array>
#include <cstdint>
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

OMNIHDR_ALWAYS_INLINE std::uint8_t Rounded(std::uint32_t sum, std::uint32_t reciprocal) {
  const std::uint32_t mean = (sum * reciprocal + 32768U) >> 16U;
  return static_cast<std::uint8_t>(mean < 255U ? mean : 255U);
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
    mean[k] = Rounded(nine, kReciprocal[kPixels]);
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
        WholeTile(x, columns);
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

  void WholeTile(int x, int columns) {
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
