#include "core/photometry/seam_report.h"

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <limits>
#include <map>
#include <utility>

namespace omnihdr {
namespace {

struct Weighted {
  float value = 0.0F;
  float weight = 0.0F;
};

// Sorts the values; NaN without any.
double Median(std::vector<Weighted>& values) {
  if (values.empty()) return std::numeric_limits<double>::quiet_NaN();
  std::sort(values.begin(), values.end(),
            [](const Weighted& a, const Weighted& b) { return a.value < b.value; });
  double total = 0.0;
  for (const Weighted& v : values) total += v.weight;
  double below = 0.0;
  for (const Weighted& v : values) {
    below += v.weight;
    if (2.0 * below >= total) return v.value;
  }
  return values.back().value;
}

using Ratios = std::array<std::vector<Weighted>, 3>;

}  // namespace

std::vector<Seam> MeasureSeams(const StitchTable& table, const StitchSource& source,
                               const SphereGrid& grid) {
  constexpr double kMostPixels = 1 << 21;
  const int step = std::max(
      1, static_cast<int>(
             std::ceil(std::sqrt(static_cast<double>(table.width) * table.height / kMostPixels))));
  std::map<std::pair<int, int>, Ratios> seams;
  std::vector<float> rgba;
  std::vector<std::uint8_t> flags;
  for (int y = 0; y < table.height; y += step) {
    for (const StitchSegment& segment : table.rows[static_cast<std::size_t>(y)]) {
      if (segment.count < 2) continue;
      const auto count = static_cast<std::size_t>(segment.x1 - segment.x0);
      rgba.resize(4 * count * segment.count);
      flags.resize(count * segment.count);
      for (std::size_t k = 0; k < segment.count; ++k) {
        const std::size_t first = segment.first + k * count;
        source.Sample(segment.sensors[k],
                      {&table.block[first], &table.packed[first], &table.shade[first],
                       static_cast<int>(count)},
                      &rgba[4 * k * count], &flags[k * count]);
      }
      for (std::size_t a = 0; a < segment.count; ++a) {
        for (std::size_t b = a + 1; b < segment.count; ++b) {
          Ratios& ratios = seams[{segment.sensors[a], segment.sensors[b]}];
          const int ahead = (step - segment.x0 % step) % step;
          for (auto x = static_cast<std::size_t>(ahead); x < count;
               x += static_cast<std::size_t>(step)) {
            if ((flags[a * count + x] | flags[b * count + x]) != 0) continue;
            const auto weight =
                static_cast<float>(grid.PixelSolidAngle(segment.x0 + static_cast<int>(x), y));
            for (std::size_t c = 0; c < 3; ++c) {
              ratios[c].push_back(
                  {std::log10(rgba[4 * (a * count + x) + c] / rgba[4 * (b * count + x) + c]),
                   weight});
            }
          }
        }
      }
    }
  }
  std::vector<Seam> report;
  for (auto& [sensors, ratios] : seams) {
    Seam seam{.first = sensors.first, .second = sensors.second, .samples = ratios[0].size()};
    for (std::size_t c = 0; c < 3; ++c) {
      seam.log10_ratio[c] = Median(ratios[c]);
      for (Weighted& v : ratios[c]) {
        v.value = std::abs(v.value - static_cast<float>(seam.log10_ratio[c]));
      }
      seam.spread[c] = Median(ratios[c]);
    }
    report.push_back(seam);
  }
  return report;
}

}  // namespace omnihdr
