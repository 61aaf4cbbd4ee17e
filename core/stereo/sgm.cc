#include "core/stereo/sgm.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <utility>

#include "core/base/parallel_for.h"
#include "core/base/simd.h"

namespace omnihdr {
namespace {

constexpr int kPad = 32;  // room before label 0 and after the last, in values

// One step of a path: from the costs of the path's previous pixel to this pixel's, added to its
// sums. `previous` and `current` have a guard value on either side.
OMNIHDR_SIMD_CLONES
std::uint16_t PathStep(const std::uint8_t* cost, const std::uint16_t* previous,
                       std::uint16_t previous_least, std::uint16_t small_penalty,
                       std::uint16_t large_penalty, int labels, std::uint16_t* current,
                       std::uint16_t* sum) {
  const auto jump = static_cast<std::uint16_t>(previous_least + large_penalty);
  std::uint16_t least = 0xFFFF;
  for (int k = 0; k < labels; ++k) {
    const auto down = static_cast<std::uint16_t>(previous[k - 1] + small_penalty);
    const auto up = static_cast<std::uint16_t>(previous[k + 1] + small_penalty);
    std::uint16_t best = previous[k];
    best = best < down ? best : down;
    best = best < up ? best : up;
    best = best < jump ? best : jump;
    const auto value = static_cast<std::uint16_t>(cost[k] + best - previous_least);
    current[k] = value;
    sum[k] = static_cast<std::uint16_t>(sum[k] + value);
    least = least < value ? least : value;
  }
  return least;
}

OMNIHDR_SIMD_CLONES
std::uint16_t LeastOf(const std::uint16_t* values, int count) {
  std::uint16_t least = 0xFFFF;
  for (int k = 0; k < count; ++k) least = least < values[k] ? least : values[k];
  return least;
}

// A path's costs at its last pixel, by label. Labels that were not in question there cost a guard
// value, more than any that was.
class Path {
 public:
  explicit Path(int labels)
      : labels_(labels),
        a_(static_cast<std::size_t>(labels + 2 * kPad), kGuard),
        b_(static_cast<std::size_t>(labels + 2 * kPad), kGuard) {}
  void Start() {
    std::fill_n(a_.data() + kPad, labels_, std::uint16_t{0});
    known_ = {0, labels_};
    least_ = 0;
  }
  void Step(const std::uint8_t* cost, const LabelRange& range, int small_penalty, int large_penalty,
            std::uint16_t* sum) {
    // The step reads one label beyond the range on either side.
    std::uint16_t* previous = a_.data() + kPad;
    const int known_end = known_.first + known_.count;
    const int begin = range.first - 1;
    const int end = range.first + range.count + 1;
    for (int k = begin; k < std::min(end, known_.first); ++k) previous[k] = kGuard;
    for (int k = std::max(begin, known_end); k < end; ++k) previous[k] = kGuard;
    least_ =
        PathStep(cost, previous + range.first, least_, static_cast<std::uint16_t>(small_penalty),
                 static_cast<std::uint16_t>(large_penalty), range.count,
                 b_.data() + kPad + range.first, sum);
    known_ = range;
    std::swap(a_, b_);
  }

 private:
  static constexpr std::uint16_t kGuard = 0x7000;
  int labels_;
  LabelRange known_;
  std::uint16_t least_ = 0;
  std::vector<std::uint16_t> a_;
  std::vector<std::uint16_t> b_;
};

}  // namespace

DisparityMap OptimiseSemiGlobal(const CostVolume& volume, const Image<std::uint8_t>& brightness,
                                const SgmOptions& options) {
  const int width = volume.width;
  const int height = volume.height;
  const int labels = volume.labels;
  std::vector<std::uint16_t> sums(volume.cost.size(), 0);
  const auto large_penalty = [&](int x0, int y0, int x1, int y1) {
    const int edge = std::abs(brightness.at(x0, y0) - brightness.at(x1, y1));
    return std::max(options.least_large_penalty, options.large_penalty - 4 * edge);
  };

  // Rows, both ways, each starting a little before its first pixel so that the seam is no border.
  ParallelFor(height, 1, [&](int begin, int end) {
    Path path(labels);
    std::vector<std::uint16_t> discard(static_cast<std::size_t>(labels));
    for (int y = begin; y < end; ++y) {
      for (const int direction : {1, -1}) {
        const int lead = std::min(64, width / 2);
        path.Start();
        for (int k = -lead; k < width; ++k) {
          const int step = direction > 0 ? k : width - 1 - k;
          const int x = (step + width) % width;
          const int from = (x - direction + width) % width;
          const std::size_t offset = volume.offset(x, y);
          path.Step(volume.cost.data() + offset, volume.range(x, y), options.small_penalty,
                    large_penalty(from, y, x, y), k < 0 ? discard.data() : sums.data() + offset);
        }
      }
    }
  });
  // Columns, both ways, some columns abreast so that whole cache lines are used.
  ParallelFor(width, 8, [&](int begin, int end) {
    std::vector<Path> paths(static_cast<std::size_t>(end - begin), Path(labels));
    for (const int direction : {1, -1}) {
      for (Path& path : paths) path.Start();
      for (int k = 0; k < height; ++k) {
        const int y = direction > 0 ? k : height - 1 - k;
        const int from = k == 0 ? y : y - direction;
        for (int x = begin; x < end; ++x) {
          const std::size_t offset = volume.offset(x, y);
          paths[static_cast<std::size_t>(x - begin)].Step(
              volume.cost.data() + offset, volume.range(x, y), options.small_penalty,
              large_penalty(x, from, x, y), sums.data() + offset);
        }
      }
    }
  });

  DisparityMap map;
  map.disparity = Image<float>(width, height);
  map.confidence = Image<float>(width, height);
  ParallelFor(height, 8, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        const std::uint16_t* s = sums.data() + volume.offset(x, y);
        const LabelRange& range = volume.range(x, y);
        const int count = range.count;
        const auto best = static_cast<int>(std::find(s, s + count, LeastOf(s, count)) - s);
        // The best that is no neighbour of the best.
        const int below = std::max(0, best - 2);
        const int above = std::min(count, best + 3);
        const int rival = std::min(LeastOf(s, below), LeastOf(s + above, count - above));
        double offset = 0.0;
        if (best > 0 && best + 1 < count) {
          const int left = s[best - 1] - s[best];
          const int right = s[best + 1] - s[best];
          if (left + right > 0) offset = 0.5 * (left - right) / (left + right);
        }
        map.disparity.at(x, y) = static_cast<float>((range.first + best + offset) * volume.step);
        const double margin = below == 0 && above == count ? 0.0 : rival - s[best];
        map.confidence.at(x, y) = static_cast<float>(margin / (margin + 40.0));
      }
    }
  });
  return map;
}

DisparityMap OptimiseSemiGlobal(const CostVolume& volume, const StereoView& reference,
                                const SgmOptions& options) {
  return OptimiseSemiGlobal(volume, MapBrightness(reference), options);
}

Image<std::uint8_t> MapBrightness(const StereoView& view) {
  Image<std::uint8_t> brightness(view.width / 2, view.height / 2);
  ParallelFor(brightness.height(), 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      const std::uint64_t* texels = view.row(2 * y + 1);
      for (int x = 0; x < brightness.width(); ++x) {
        const std::uint64_t t = texels[2 * x + 1];
        brightness.at(x, y) = static_cast<std::uint8_t>(((t & 0xFFU) + ((t >> 16U) & 0xFFU)) / 2U);
      }
    }
  });
  return brightness;
}

}  // namespace omnihdr
