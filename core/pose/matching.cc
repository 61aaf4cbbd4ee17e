#include "core/pose/matching.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/base/parallel_for.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/pose/matching.cc"
#include <hwy/foreach_target.h>
//
#include <hwy/highway.h>

// A key is similarity · 2^13 + index: the larger key is the better match, and ties are settled.
HWY_BEFORE_NAMESPACE();
namespace omnihdr {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

constexpr int kPairs = kDescriptorLength / 2;
constexpr int kKeyShift = 13;
constexpr int kQueries = 4;  // rows of a worked on together
constexpr int kVectors = 2;  // vectors of b worked on together

int PanelWidth() { return kVectors * static_cast<int>(hn::Lanes(hn::ScalableTag<std::int32_t>())); }

// Descriptors of b in panels of PanelWidth() columns: for each pair of dimensions, the pair of each
// column.
void Pack(const std::int16_t* descriptors, int count, std::int16_t* packed) {
  const int panel = PanelWidth();
  for (int first = 0; first < count; first += panel) {
    for (int pair = 0; pair < kPairs; ++pair) {
      for (int column = 0; column < panel; ++column) {
        const int index = first + column;
        for (int k = 0; k < 2; ++k) {
          *packed++ = index < count
                          ? descriptors[static_cast<std::ptrdiff_t>(index) * kDescriptorLength +
                                        2 * pair + k]
                          : std::int16_t{0};
        }
      }
    }
  }
}

// For rows [begin, end) of a: the best and second best keys over all columns of b (index = column),
// and, raised into `column_best`, the best key of every column (index = row).
void BestOfRows(const std::int16_t* descriptors, int begin, int end, const std::int16_t* packed,
                int columns, std::int32_t* best, std::int32_t* second, std::int32_t* column_best) {
  const hn::ScalableTag<std::int32_t> d32;
  const hn::ScalableTag<std::int16_t> d16;
  const int lanes = static_cast<int>(hn::Lanes(d32));
  const int panel = kVectors * lanes;
  const auto zero = hn::Zero(d32);
  HWY_ALIGN std::int32_t lane_keys[hn::MaxLanes(d32)];
  for (int row = begin; row < end; row += kQueries) {
    const int rows = HWY_MIN(kQueries, end - row);
    const std::int16_t* a[kQueries];
    for (int q = 0; q < kQueries; ++q) {
      a[q] =
          descriptors + static_cast<std::ptrdiff_t>(row + HWY_MIN(q, rows - 1)) * kDescriptorLength;
    }
    auto best0 = zero, best1 = zero, best2 = zero, best3 = zero;
    auto second0 = zero, second1 = zero, second2 = zero, second3 = zero;
    for (int first = 0; first < columns; first += panel) {
      const std::int16_t* b = packed + static_cast<std::ptrdiff_t>(first) * kDescriptorLength;
      auto s00 = zero, s01 = zero, s10 = zero, s11 = zero;
      auto s20 = zero, s21 = zero, s30 = zero, s31 = zero;
      auto t00 = zero, t01 = zero, t10 = zero, t11 = zero;
      auto t20 = zero, t21 = zero, t30 = zero, t31 = zero;
      for (int pair = 0; pair < kPairs; ++pair, b += 2 * panel) {
        const auto b0 = hn::LoadU(d16, b);
        const auto b1 = hn::LoadU(d16, b + panel);
        const auto query = [&](int q) HWY_ATTR {
          std::int32_t both;
          hwy::CopyBytes<4>(a[q] + 2 * pair, &both);
          return hn::BitCast(d16, hn::Set(d32, both));
        };
        const auto a0 = query(0);
        s00 = hn::ReorderWidenMulAccumulate(d32, a0, b0, s00, t00);
        s01 = hn::ReorderWidenMulAccumulate(d32, a0, b1, s01, t01);
        const auto a1 = query(1);
        s10 = hn::ReorderWidenMulAccumulate(d32, a1, b0, s10, t10);
        s11 = hn::ReorderWidenMulAccumulate(d32, a1, b1, s11, t11);
        const auto a2 = query(2);
        s20 = hn::ReorderWidenMulAccumulate(d32, a2, b0, s20, t20);
        s21 = hn::ReorderWidenMulAccumulate(d32, a2, b1, s21, t21);
        const auto a3 = query(3);
        s30 = hn::ReorderWidenMulAccumulate(d32, a3, b0, s30, t30);
        s31 = hn::ReorderWidenMulAccumulate(d32, a3, b1, s31, t31);
      }
      const auto index0 = hn::Iota(d32, first);
      const auto index1 = hn::Iota(d32, first + lanes);
      auto column0 = hn::LoadU(d32, column_best + first);
      auto column1 = hn::LoadU(d32, column_best + first + lanes);
      const auto take = [&](int q, auto sum0, auto odd0, auto sum1, auto odd1, auto& row_best,
                            auto& row_second) HWY_ATTR {
        const auto score0 = hn::ShiftLeft<kKeyShift>(hn::RearrangeToOddPlusEven(sum0, odd0));
        const auto score1 = hn::ShiftLeft<kKeyShift>(hn::RearrangeToOddPlusEven(sum1, odd1));
        const auto key0 = hn::Add(score0, index0);
        const auto key1 = hn::Add(score1, index1);
        row_second = hn::Max(row_second, hn::Min(row_best, key0));
        row_best = hn::Max(row_best, key0);
        row_second = hn::Max(row_second, hn::Min(row_best, key1));
        row_best = hn::Max(row_best, key1);
        const auto me = hn::Set(d32, row + HWY_MIN(q, rows - 1));
        column0 = hn::Max(column0, hn::Add(score0, me));
        column1 = hn::Max(column1, hn::Add(score1, me));
      };
      take(0, s00, t00, s01, t01, best0, second0);
      take(1, s10, t10, s11, t11, best1, second1);
      take(2, s20, t20, s21, t21, best2, second2);
      take(3, s30, t30, s31, t31, best3, second3);
      hn::StoreU(column0, d32, column_best + first);
      hn::StoreU(column1, d32, column_best + first + lanes);
    }
    const auto finish = [&](int q, auto row_best, auto row_second) HWY_ATTR {
      if (q >= rows) return;
      std::int32_t top = 0;
      std::int32_t next = 0;
      const auto offer = [&](std::int32_t key) {
        if (key > top) {
          next = top;
          top = key;
        } else if (key > next) {
          next = key;
        }
      };
      hn::Store(row_best, d32, lane_keys);
      for (int lane = 0; lane < lanes; ++lane) offer(lane_keys[lane]);
      hn::Store(row_second, d32, lane_keys);
      for (int lane = 0; lane < lanes; ++lane) offer(lane_keys[lane]);
      best[row + q] = top;
      second[row + q] = next;
    };
    finish(0, best0, second0);
    finish(1, best1, second1);
    finish(2, best2, second2);
    finish(3, best3, second3);
  }
}

}  // namespace HWY_NAMESPACE
}  // namespace omnihdr
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace omnihdr {
namespace {

HWY_EXPORT(PanelWidth);
HWY_EXPORT(Pack);
HWY_EXPORT(BestOfRows);

constexpr std::int32_t kIndexMask = (1 << 13) - 1;

}  // namespace

int DescriptorSimilarity(const FeatureSet& a, int index_a, const FeatureSet& b, int index_b) {
  const std::int16_t* p =
      a.descriptors.data() + static_cast<std::ptrdiff_t>(index_a) * kDescriptorLength;
  const std::int16_t* q =
      b.descriptors.data() + static_cast<std::ptrdiff_t>(index_b) * kDescriptorLength;
  int sum = 0;
  for (int k = 0; k < kDescriptorLength; ++k) sum += p[k] * q[k];
  return sum;
}

float DescriptorDistance(int similarity) {
  constexpr float kSquare =
      static_cast<float>(kDescriptorNorm) * static_cast<float>(kDescriptorNorm);
  return std::sqrt(std::max(1e-6F, 2.0F - 2.0F * static_cast<float>(similarity) / kSquare));
}

std::vector<Match> MatchFeatures(const FeatureSet& a, const FeatureSet& b, float max_ratio) {
  const int rows = std::min(a.size(), kMaxMatchableFeatures);
  const int columns = std::min(b.size(), kMaxMatchableFeatures);
  std::vector<Match> matches;
  if (rows == 0 || columns < 2) return matches;

  const int panel = HWY_DYNAMIC_DISPATCH(PanelWidth)();
  const int padded = (columns + panel - 1) / panel * panel;
  std::vector<std::int16_t> packed(static_cast<std::size_t>(padded) * kDescriptorLength);
  HWY_DYNAMIC_DISPATCH(Pack)(b.descriptors.data(), columns, packed.data());

  std::vector<std::int32_t> best(static_cast<std::size_t>(rows));
  std::vector<std::int32_t> second(static_cast<std::size_t>(rows));
  // Fixed stripes, each with its own column maxima: no worker waits for another.
  constexpr int kStripe = 512;
  const int stripes = (rows + kStripe - 1) / kStripe;
  std::vector<std::vector<std::int32_t>> column_best(
      static_cast<std::size_t>(stripes),
      std::vector<std::int32_t>(static_cast<std::size_t>(padded)));
  ParallelFor(stripes, 1, [&](int begin, int end) {
    for (int stripe = begin; stripe < end; ++stripe) {
      HWY_DYNAMIC_DISPATCH(BestOfRows)
      (a.descriptors.data(), stripe * kStripe, std::min(rows, (stripe + 1) * kStripe),
       packed.data(), padded, best.data(), second.data(),
       column_best[static_cast<std::size_t>(stripe)].data());
    }
  });

  for (int row = 0; row < rows; ++row) {
    const std::int32_t key = best[static_cast<std::size_t>(row)];
    const int column = key & kIndexMask;
    if (key >> 13 == 0 || column >= columns) continue;
    std::int32_t top = 0;
    for (const auto& stripe : column_best)
      top = std::max(top, stripe[static_cast<std::size_t>(column)]);
    if ((top & kIndexMask) != row) continue;
    const float ratio = DescriptorDistance(key >> 13) /
                        DescriptorDistance(second[static_cast<std::size_t>(row)] >> 13);
    if (ratio < max_ratio) matches.push_back({row, column, ratio});
  }
  return matches;
}

}  // namespace omnihdr
#endif
