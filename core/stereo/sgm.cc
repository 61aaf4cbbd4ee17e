#include "core/stereo/sgm.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
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

class Path {
 public:
  explicit Path(int labels)
      : labels_(labels),
        a_(static_cast<std::size_t>(labels + 2 * kPad), kGuard),
        b_(static_cast<std::size_t>(labels + 2 * kPad), kGuard) {}
  void Start() {
    std::fill_n(a_.data() + kPad, labels_, std::uint16_t{0});
    least_ = 0;
  }
  void Step(const std::uint8_t* cost, int small_penalty, int large_penalty, std::uint16_t* sum) {
    least_ = PathStep(cost, a_.data() + kPad, least_, static_cast<std::uint16_t>(small_penalty),
                      static_cast<std::uint16_t>(large_penalty), labels_, b_.data() + kPad, sum);
    std::swap(a_, b_);
  }

 private:
  static constexpr std::uint16_t kGuard = 0x7000;
  int labels_;
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
  const auto pixels = static_cast<std::size_t>(width) * static_cast<std::size_t>(height);
  std::vector<std::uint16_t> sums(pixels * static_cast<std::size_t>(labels), 0);
  const auto sum_at = [&](int x, int y) {
    return sums.data() + (static_cast<std::size_t>(y) * static_cast<std::size_t>(width) +
                          static_cast<std::size_t>(x)) *
                             static_cast<std::size_t>(labels);
  };
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
          std::fill(discard.begin(), discard.end(), std::uint16_t{0});
          path.Step(volume.at(x, y), options.small_penalty, large_penalty(from, y, x, y),
                    k < 0 ? discard.data() : sum_at(x, y));
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
          paths[static_cast<std::size_t>(x - begin)].Step(
              volume.at(x, y), options.small_penalty, large_penalty(x, from, x, y), sum_at(x, y));
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
        const std::uint16_t* s = sum_at(x, y);
        const int best = static_cast<int>(std::min_element(s, s + labels) - s);
        int rival = std::numeric_limits<int>::max();
        for (int k = 0; k < labels; ++k) {
          if (std::abs(k - best) > 2) rival = std::min(rival, static_cast<int>(s[k]));
        }
        double offset = 0.0;
        if (best > 0 && best + 1 < labels) {
          const int left = s[best - 1] - s[best];
          const int right = s[best + 1] - s[best];
          if (left + right > 0) offset = 0.5 * (left - right) / (left + right);
        }
        map.disparity.at(x, y) = static_cast<float>((best + offset) * volume.step);
        const double margin = rival == std::numeric_limits<int>::max() ? 0.0 : rival - s[best];
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
