#include "core/stereo/cost_aggregation.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <vector>

#include "core/base/parallel_for.h"

namespace omnihdr::cost_aggregation_test {
namespace {

// Random costs; random labels of each tile, or all everywhere.
CostVolume Volume(int width, int height, int labels, bool varies, unsigned seed) {
  std::mt19937 random(seed);
  const auto below = [&](int most) {
    return static_cast<int>(random() % static_cast<unsigned>(most));
  };
  std::vector<LabelRange> ranges;
  for (int t = 0; varies && t < CostVolume::TilesPerRow(width) * height; ++t) {
    const int count = 1 + below(labels);
    ranges.push_back({below(labels - count + 1), count});
  }
  CostVolume volume = CostVolume::Allocate(width, height, labels, 1.0, std::move(ranges));
  for (std::uint8_t& cost : volume.cost) cost = static_cast<std::uint8_t>(below(256));
  return volume;
}

// What the mean is by its definition.
double MeanAround(const CostVolume& volume, int x, int y, int label) {
  double sum = 0.0;
  int pixels = 0;
  for (int dy = -1; dy <= 1; ++dy) {
    for (int dx = -1; dx <= 1; ++dx) {
      const int u = (x + dx + volume.width) % volume.width;
      const int v = std::clamp(y + dy, 0, volume.height - 1);
      const int k = label - volume.range(u, v).first;
      if (k < 0 || k >= volume.range(u, v).count) continue;
      sum += volume.at(u, v)[k];
      ++pixels;
    }
  }
  return sum / pixels;
}

void ExpectMeans(const CostVolume& volume) {
  const CostVolume means = AggregateCosts(volume);
  ASSERT_EQ(means.ranges, volume.ranges);
  ASSERT_EQ(means.cost.size(), volume.cost.size());
  EXPECT_EQ(means.step, volume.step);
  for (int y = 0; y < volume.height; ++y) {
    for (int x = 0; x < volume.width; ++x) {
      const LabelRange& range = volume.range(x, y);
      for (int k = 0; k < range.count; ++k) {
        ASSERT_NEAR(means.at(x, y)[k], MeanAround(volume, x, y, range.first + k), 0.51)
            << x << ' ' << y << ' ' << k;
      }
    }
  }
}

TEST(AggregateCosts, IsTheMeanAroundRoundTheGlobe) {
  ExpectMeans(Volume(64, 9, 24, false, 1));
  ExpectMeans(Volume(72, 5, 7, false, 2));  // the last tile is a part of one
}

TEST(AggregateCosts, LeavesOutPixelsWhereALabelIsNotSearched) {
  for (unsigned seed = 3; seed < 9; ++seed) {
    ExpectMeans(Volume(72, 6, 20, true, seed));
    ExpectMeans(Volume(129, 7, 40, true, seed));  // the last tile is a pixel
  }
}

TEST(AggregateCosts, KeepsTheLargestCosts) {
  CostVolume volume = Volume(128, 12, 30, true, 13);
  std::fill(volume.cost.begin(), volume.cost.end(), std::uint8_t{255});
  ExpectMeans(volume);
}

TEST(AggregateCosts, HasMeansOfTheSmallestMaps) {
  ExpectMeans(Volume(4, 2, 8, false, 10));
  ExpectMeans(Volume(2, 1, 1, false, 11));
}

TEST(AggregateCosts, GivesTheSameBytesOnAnyNumberOfCores) {
  const CostVolume volume = Volume(160, 40, 16, true, 12);
  SetWorkerCount(1);
  const CostVolume one = AggregateCosts(volume);
  SetWorkerCount(4);
  const CostVolume four = AggregateCosts(volume);
  SetWorkerCount(0);
  EXPECT_TRUE(std::equal(one.cost.begin(), one.cost.end(), four.cost.begin(), four.cost.end()));
}

}  // namespace
}  // namespace omnihdr::cost_aggregation_test
