#include "core/stereo/cost_volume.h"

#include <algorithm>
#include <cmath>
#include <utility>

#include "core/base/parallel_for.h"
#include "core/stereo/sgm.h"

namespace omnihdr {

CostVolume CostVolume::Allocate(int width, int height, int labels, double max_disparity,
                                std::vector<LabelRange> ranges) {
  CostVolume volume;
  volume.width = width;
  volume.height = height;
  volume.labels = labels;
  volume.step = max_disparity / std::max(1, labels - 1);
  volume.ranges = std::move(ranges);
  const int tiles = TilesPerRow(width);
  volume.ranges.resize(static_cast<std::size_t>(tiles) * static_cast<std::size_t>(height),
                       {0, labels});
  std::size_t total = 0;
  volume.offsets.reserve(volume.ranges.size());
  for (std::size_t t = 0; t < volume.ranges.size(); ++t) {
    volume.offsets.push_back(total);
    const int x = static_cast<int>(t % static_cast<std::size_t>(tiles)) * kTileColumns;
    total += static_cast<std::size_t>(std::min(kTileColumns, width - x)) *
             static_cast<std::size_t>(volume.ranges[t].count);
  }
  volume.cost.resize(total);
  return volume;
}

std::vector<LabelRange> RangesAround(const DisparityMap& guide, int width, int height, int labels,
                                     double max_disparity, const RangeOptions& options) {
  const Image<float>& map = guide.disparity;
  const int tiles = CostVolume::TilesPerRow(width);
  const double step = max_disparity / std::max(1, labels - 1);
  // Of each tile's columns, guide row by guide row.
  Image<float> least(tiles, map.height());
  Image<float> most(tiles, map.height());
  ParallelFor(map.height(), 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int t = 0; t < tiles; ++t) {
        const int first = t * kTileColumns * map.width() / width - options.reach;
        const int last =
            std::min((t + 1) * kTileColumns, width) * map.width() / width + options.reach;
        auto low = static_cast<float>(labels);
        float high = 0.0F;
        for (int k = first; k < last; ++k) {
          const int x = (k % map.width() + map.width()) % map.width();
          const auto label = static_cast<float>(map.at(x, y) / step);
          const auto margin = static_cast<float>(
              options.margin + options.more_margin * (1.0F - guide.confidence.at(x, y)));
          low = std::min(low, label - margin);
          high = std::max(high, label + margin);
        }
        least.at(t, y) = low;
        most.at(t, y) = high;
      }
    }
  });
  std::vector<LabelRange> ranges(static_cast<std::size_t>(tiles) *
                                 static_cast<std::size_t>(height));
  for (int y = 0; y < height; ++y) {
    const int row = y * map.height() / height;
    const int above = std::max(0, row - options.reach);
    const int below = std::min(map.height() - 1, row + options.reach);
    for (int t = 0; t < tiles; ++t) {
      float low = least.at(t, above);
      float high = most.at(t, above);
      for (int k = above + 1; k <= below; ++k) {
        low = std::min(low, least.at(t, k));
        high = std::max(high, most.at(t, k));
      }
      const int last = std::min(labels - 1, static_cast<int>(std::ceil(high)));
      int first = std::clamp(static_cast<int>(std::floor(low)), 0, last);
      const int wanted = last - first + 1;
      const int count = std::min(labels, (wanted + kTileLabels - 1) / kTileLabels * kTileLabels);
      first = std::min(first, labels - count);
      ranges[static_cast<std::size_t>(y) * static_cast<std::size_t>(tiles) +
             static_cast<std::size_t>(t)] = {first, count};
    }
  }
  return ranges;
}

}  // namespace omnihdr
