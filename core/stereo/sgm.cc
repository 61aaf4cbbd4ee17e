#include "core/stereo/sgm.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <memory>
#include <utility>

#include "core/base/large_memory.h"
#include "core/base/parallel_for.h"
#include "core/base/simd.h"

namespace omnihdr {
namespace {

constexpr int kPad = 32;  // room before label 0 and after the last, in values
// Of labels that were not in question at the path's last pixel: more than any that was.
constexpr std::uint16_t kGuard = 0x7000;
constexpr int kBlock = 8;  // labels worked on at a time: a vector's width

// A path's costs at its last pixel, by label, with room on either side.
struct Path {
  std::uint16_t* previous = nullptr;
  std::uint16_t* current = nullptr;
  LabelRange known;
  std::uint16_t least = 0;
};

struct PathPenalties {
  std::uint16_t small_change = 0;
  std::uint16_t large_change = 0;
};

using Lanes = std::uint16_t __attribute__((vector_size(2 * kBlock)));
using ByteLanes = std::uint8_t __attribute__((vector_size(kBlock)));

OMNIHDR_ALWAYS_INLINE Lanes LoadLanes(const std::uint16_t* from) {
  Lanes lanes;
  std::memcpy(&lanes, from, sizeof lanes);
  return lanes;
}
OMNIHDR_ALWAYS_INLINE Lanes LoadBytes(const std::uint8_t* from) {
  ByteLanes bytes;
  std::memcpy(&bytes, from, sizeof bytes);
  return __builtin_convertvector(bytes, Lanes);
}
OMNIHDR_ALWAYS_INLINE void StoreLanes(const Lanes& lanes, std::uint16_t* to) {
  std::memcpy(to, &lanes, sizeof lanes);
}
OMNIHDR_ALWAYS_INLINE Lanes Least(const Lanes& a, const Lanes& b) { return a < b ? a : b; }
OMNIHDR_ALWAYS_INLINE std::uint16_t LeastLane(Lanes lanes) {
  lanes = Least(lanes, __builtin_shufflevector(lanes, lanes, 4, 5, 6, 7, 0, 1, 2, 3));
  lanes = Least(lanes, __builtin_shufflevector(lanes, lanes, 2, 3, 0, 1, 6, 7, 4, 5));
  return lanes[0] < lanes[1] ? lanes[0] : lanes[1];
}

OMNIHDR_ALWAYS_INLINE void StartPath(int labels, Path* path) {
  for (int k = 0; k < labels; ++k) path->previous[k] = 0;
  path->previous[-1] = path->previous[labels] = kGuard;
  path->known = {0, labels};
  path->least = 0;
}

// One step of a path (Hirschmueller 2008, eq. 13): from the costs of its last pixel to this one's,
// which become its sums or are added to them.
template <bool kAdds>
OMNIHDR_ALWAYS_INLINE void Step(const std::uint8_t* __restrict cost, const LabelRange& range,
                                const PathPenalties& penalties, Path* path,
                                std::uint16_t* __restrict sum) {
  const std::uint16_t* __restrict previous = path->previous;
  if (!(range == path->known)) {
    // The step reads one label beyond the range on either side.
    const int known_end = path->known.first + path->known.count;
    const int begin = range.first - 1;
    const int end = range.first + range.count + 1;
    const int low_end = end < path->known.first ? end : path->known.first;
    for (int k = begin; k < low_end; ++k) path->previous[k] = kGuard;
    for (int k = begin > known_end ? begin : known_end; k < end; ++k) path->previous[k] = kGuard;
  }
  const std::uint16_t base = path->least;
  const auto jump = static_cast<std::uint16_t>(base + penalties.large_change);
  std::uint16_t* __restrict current = path->current + range.first;
  previous += range.first;
  Lanes least = Lanes{} + std::uint16_t{0xFFFF};
  int k = 0;
  for (; k + kBlock <= range.count; k += kBlock) {
    const Lanes down = LoadLanes(previous + k - 1) + penalties.small_change;
    const Lanes up = LoadLanes(previous + k + 1) + penalties.small_change;
    const Lanes stay = Least(LoadLanes(previous + k), Lanes{} + jump);
    const Lanes value = LoadBytes(cost + k) + Least(Least(down, up), stay) - base;
    StoreLanes(value, current + k);
    StoreLanes(kAdds ? LoadLanes(sum + k) + value : value, sum + k);
    least = Least(least, value);
  }
  for (; k < range.count; ++k) {
    const auto down = static_cast<std::uint16_t>(previous[k - 1] + penalties.small_change);
    const auto up = static_cast<std::uint16_t>(previous[k + 1] + penalties.small_change);
    const std::uint16_t best = std::min({previous[k], jump, down, up});
    const auto value = static_cast<std::uint16_t>(cost[k] + best - base);
    current[k] = value;
    sum[k] = kAdds ? static_cast<std::uint16_t>(sum[k] + value) : value;
    least[0] = std::min(least[0], value);
  }
  current[-1] = current[range.count] = kGuard;
  path->least = LeastLane(least);
  path->known = range;
  std::swap(path->previous, path->current);
}

// Buffers of some paths, for labels each.
class PathBuffers {
 public:
  PathBuffers(int paths, int labels)
      : values_(static_cast<std::size_t>(2 * paths) * static_cast<std::size_t>(labels + 2 * kPad),
                kGuard),
        paths_(static_cast<std::size_t>(paths)) {
    std::uint16_t* at = values_.data() + kPad;
    for (Path& path : paths_) {
      path.previous = at;
      path.current = at + labels + 2 * kPad;
      at = path.current + labels + 2 * kPad;
    }
  }
  Path* paths() { return paths_.data(); }

 private:
  std::vector<std::uint16_t> values_;
  std::vector<Path> paths_;
};

// What the paths read.
struct Field {
  const std::uint8_t* cost;
  const LabelRange* ranges;
  const std::size_t* offsets;
  const std::uint8_t* brightness;
  int width;
  int height;
  int tiles;  // a row
  SgmOptions options;
};

OMNIHDR_ALWAYS_INLINE PathPenalties PenaltiesBetween(const Field& f, std::uint8_t a,
                                                     std::uint8_t b) {
  const int edge = a > b ? a - b : b - a;
  const int large = f.options.large_penalty - 4 * edge;
  const int least = f.options.least_large_penalty;
  return {static_cast<std::uint16_t>(f.options.small_penalty),
          static_cast<std::uint16_t>(large > least ? large : least)};
}

// A row in one direction, starting `lead` pixels before its first one so that the seam is no
// border.
template <bool kAdds>
OMNIHDR_ALWAYS_INLINE void AlongRow(const Field& f, int y, int direction, int lead,
                                    std::uint16_t* discard, Path* path, std::uint16_t* sums) {
  const std::uint8_t* brightness = f.brightness + static_cast<std::ptrdiff_t>(y) * f.width;
  const std::ptrdiff_t first_tile = static_cast<std::ptrdiff_t>(y) * f.tiles;
  int x = direction > 0 ? f.width - lead : lead - 1;
  int from = direction > 0 ? x - 1 : x + 1;
  if (from < 0) from += f.width;
  if (from >= f.width) from -= f.width;
  for (int k = -lead; k < f.width; ++k) {
    const std::ptrdiff_t tile = first_tile + x / kTileColumns;
    const LabelRange& range = f.ranges[tile];
    const std::size_t offset = f.offsets[tile] + static_cast<std::size_t>(x % kTileColumns) *
                                                     static_cast<std::size_t>(range.count);
    const PathPenalties penalties = PenaltiesBetween(f, brightness[from], brightness[x]);
    if (k < 0) {
      Step<false>(f.cost + offset, range, penalties, path, discard);
    } else {
      Step<kAdds>(f.cost + offset, range, penalties, path, sums + offset);
    }
    from = x;
    x += direction;
    if (x == f.width) x = 0;
    if (x < 0) x = f.width - 1;
  }
}

OMNIHDR_SIMD_CLONES
void AlongRows(const Field& f, int begin, int end, int labels, Path* path, std::uint16_t* discard,
               std::uint16_t* sums) {
  const int lead = f.width / 2 < 64 ? f.width / 2 : 64;
  for (int y = begin; y < end; ++y) {
    StartPath(labels, path);
    AlongRow<false>(f, y, 1, lead, discard, path, sums);
    StartPath(labels, path);
    AlongRow<true>(f, y, -1, lead, discard, path, sums);
  }
}

// Columns in both directions, abreast, so that whole cache lines are used.
OMNIHDR_SIMD_CLONES
void AlongColumns(const Field& f, int begin, int end, int labels, Path* paths,
                  std::uint16_t* sums) {
  for (int direction = 1; direction >= -1; direction -= 2) {
    for (int x = begin; x < end; ++x) StartPath(labels, paths + (x - begin));
    for (int k = 0; k < f.height; ++k) {
      const int y = direction > 0 ? k : f.height - 1 - k;
      const int from = k == 0 ? y : y - direction;
      const std::uint8_t* here = f.brightness + static_cast<std::ptrdiff_t>(y) * f.width;
      const std::uint8_t* there = f.brightness + static_cast<std::ptrdiff_t>(from) * f.width;
      for (int x = begin; x < end; ++x) {
        const std::ptrdiff_t tile = static_cast<std::ptrdiff_t>(y) * f.tiles + x / kTileColumns;
        const LabelRange& range = f.ranges[tile];
        const std::size_t offset = f.offsets[tile] + static_cast<std::size_t>(x % kTileColumns) *
                                                         static_cast<std::size_t>(range.count);
        Step<true>(f.cost + offset, range, PenaltiesBetween(f, there[x], here[x]),
                   paths + (x - begin), sums + offset);
      }
    }
  }
}

OMNIHDR_SIMD_CLONES
std::uint16_t LeastOf(const std::uint16_t* values, int count) {
  std::uint16_t least = 0xFFFF;
  for (int k = 0; k < count; ++k) least = least < values[k] ? least : values[k];
  return least;
}

}  // namespace

DisparityMap OptimiseSemiGlobal(const CostVolume& volume, const Image<std::uint8_t>& brightness,
                                const SgmOptions& options) {
  const int width = volume.width;
  const int height = volume.height;
  const int labels = volume.labels;
  // The first path along each row sets what the others add to.
  const std::unique_ptr<std::uint16_t, decltype(&FreeLarge)> sums(
      static_cast<std::uint16_t*>(AllocateLarge(volume.cost.size() * sizeof(std::uint16_t))),
      &FreeLarge);
  const Field field = {volume.cost.data(),
                       volume.ranges.data(),
                       volume.offsets.data(),
                       brightness.data(),
                       width,
                       height,
                       CostVolume::TilesPerRow(width),
                       options};
  ParallelFor(height, 4, [&](int begin, int end) {
    PathBuffers buffers(1, labels);
    std::vector<std::uint16_t> discard(static_cast<std::size_t>(labels));
    AlongRows(field, begin, end, labels, buffers.paths(), discard.data(), sums.get());
  });
  ParallelFor(width / kTileColumns + 1, 1, [&](int begin, int end) {
    for (int tile = begin; tile < end; ++tile) {
      const int first = tile * kTileColumns;
      const int last = std::min(width, first + kTileColumns);
      if (first >= last) continue;
      PathBuffers buffers(last - first, labels);
      AlongColumns(field, first, last, labels, buffers.paths(), sums.get());
    }
  });

  DisparityMap map;
  map.disparity = Image<float>(width, height);
  map.confidence = Image<float>(width, height);
  ParallelFor(height, 8, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        const std::uint16_t* s = sums.get() + volume.offset(x, y);
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
