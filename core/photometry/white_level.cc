#include "core/photometry/white_level.h"

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <variant>

namespace omnihdr {
namespace {

constexpr int kBins = 1024;  // of 0..255; a fourth of an 8-bit value
constexpr double kBin = 256.0 / kBins;

// A heap is this wide, in bins: what read noise makes of one value, and no more than a hundredth of
// the range. What any scene has below it is looked at over as many widths: surfaces of one
// brightness heap up, too.
constexpr int kHeap = 12;
constexpr int kSlope = 10;
constexpr double kHotShare = 2e-5;  // of samples that may be brighter by themselves
constexpr double kLeastHot = 8.0;
constexpr double kLeastShare = 1e-3;  // of all samples, for a heap
constexpr double kSteepness = 4.0;    // of a heap over as wide a part below it
constexpr double kFew = 0.02;         // of the heap's samples that may lie below the level
constexpr double kSameValue = 1.0;    // 8-bit units
constexpr double kApart = 1.41;       // of exposures
constexpr std::size_t kMostHeaps = 256;

}  // namespace

void WhiteLevelFinder::Add(const DecodedImage& image, int bits, double seconds, int first_row,
                           int height, ImageView<const std::uint8_t> mask, int step) {
  if (heaps_.size() >= kMostHeaps) return;
  std::vector<double> counts(kBins);
  double total = 0.0;
  const double scale = image.is_16_bit() ? 255.0 / ((1 << std::clamp(bits, 8, 16)) - 1.0) : 1.0;
  std::visit(
      [&](const auto& pixels) {
        const int channels = pixels.channels();
        for (int y = first_row; y < std::min(first_row + height, pixels.height()); y += step) {
          const auto* row = pixels.row(y);
          for (int x = 0; x < pixels.width(); x += step) {
            if (!mask.empty() && mask.at(x, y) < 128) continue;
            for (int c = 0; c < channels; ++c) {
              const auto bin = static_cast<std::size_t>(row[x * channels + c] * scale / kBin);
              counts[std::min(bin, counts.size() - 1)] += 1.0;
              total += 1.0;
            }
          }
        }
      },
      image.pixels);
  if (total == 0.0) return;
  double above = 0.0;
  int top = kBins - 1;
  for (; top > 0 && above <= std::max(kLeastHot, kHotShare * total); --top) {
    above += counts[static_cast<std::size_t>(top)];
  }
  ++top;
  const auto sum = [&](int from, int to) {
    double n = 0.0;
    for (int k = std::max(from, 0); k < std::min(to, kBins); ++k) {
      n += counts[static_cast<std::size_t>(k)];
    }
    return n;
  };
  // The brightest samples' own noise lies on either side of the heap's middle.
  const double heap = sum(top - kHeap + 1, kBins);
  const double below = sum(top - (kSlope + 2) * kHeap + 1, top - 2 * kHeap + 1) / kSlope;
  if (heap < kLeastShare * total || heap < kSteepness * below) return;
  double under = 0.0;
  int level = top - kHeap + 1;
  for (; level < kBins; ++level) {
    under += level < 0 ? 0.0 : counts[static_cast<std::size_t>(level)];
    if (under > kFew * heap) break;
  }
  heaps_.push_back({seconds, level * kBin, heap / total});
}

std::optional<WhiteLevel> WhiteLevelFinder::Find() const {
  std::optional<WhiteLevel> best;
  for (const Heap& at : heaps_) {
    WhiteLevel level;
    level.value = at.value;
    std::vector<double> seconds;
    for (const Heap& heap : heaps_) {
      if (std::abs(heap.value - at.value) > kSameValue) continue;
      level.value = std::min(level.value, heap.value);
      level.share = std::max(level.share, heap.share);
      const bool is_new = std::none_of(seconds.begin(), seconds.end(), [&](double s) {
        return std::max(s, heap.seconds) < kApart * std::min(s, heap.seconds);
      });
      if (is_new) seconds.push_back(heap.seconds);
    }
    level.exposures = static_cast<int>(seconds.size());
    if (level.exposures < 2) continue;
    if (!best || level.exposures > best->exposures ||
        (level.exposures == best->exposures && level.share > best->share)) {
      best = level;
    }
  }
  return best;
}

}  // namespace omnihdr
