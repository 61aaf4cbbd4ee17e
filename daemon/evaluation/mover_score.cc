#include "daemon/evaluation/mover_score.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "core/photometry/tonemap.h"

namespace omnihdr {
namespace {

constexpr double kOffLog10 = 0.3;
constexpr float kBoundTolerance = 0.8F;  // a bound is met from this share of it on
constexpr std::uint8_t kFewWitnesses = 2;

// Whether the own frame, clipped or dark on `now`, may just as well have seen `background`.
bool MayBe(const float* background, const float* now, const MeasurableRange& own) {
  const bool is_clipped = *std::max_element(now, now + 3) > own.high;
  const bool is_dark = Luminance(now) < own.low;
  if (!is_clipped && !is_dark) return false;
  if (is_dark && Luminance(background) > own.low / kBoundTolerance) return false;
  for (int c = 0; c < 3; ++c) {
    if (now[c] > own.high && background[c] < kBoundTolerance * own.high) return false;
  }
  return true;
}

// Pixels of either mask and their neighbours.
Image<std::uint8_t> AreaOf(const Reference::Movers& movers) {
  const int width = movers.here.width();
  const int height = movers.here.height();
  Image<std::uint8_t> area(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (movers.here.at(x, y) == 0 && movers.in_sight.at(x, y) == 0) continue;
      for (int dy = -1; dy <= 1; ++dy) {
        const int ny = std::clamp(y + dy, 0, height - 1);
        for (int dx = -1; dx <= 1; ++dx) area.at((x + dx + width) % width, ny) = 255;
      }
    }
  }
  return area;
}

}  // namespace

MoverScore ScoreMovers(const MoverComparison& c, const ComparisonArea& sphere) {
  const int width = c.truth.width();
  const int height = c.truth.height();
  Image<std::uint8_t> compared = AreaOf(c.movers);
  Image<std::uint8_t> other_allowed(width, height);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (compared.at(x, y) == 0) continue;
      const float* now = c.truth.pixel(x, y);
      const float* background = c.movers.background.pixel(x, y);
      if (!std::isfinite(c.own_frame.pixel(x, y)[0]) ||
          !c.bracket.Has(c.removes ? background : now)) {
        compared.at(x, y) = 0;
        continue;
      }
      const bool is_allowed =
          c.removes ? c.movers.witnesses.at(x, y) < kFewWitnesses : MayBe(background, now, c.own);
      other_allowed.at(x, y) = is_allowed ? 255 : 0;
    }
  }
  ComparisonArea area = sphere;
  area.mask = compared.view();
  const Image<float>& wanted = c.removes ? c.movers.background : c.truth;
  const Image<float>& other = c.removes ? c.truth : c.movers.background;
  const std::array<Instance, 2> instances = {
      {{wanted.view(), {}}, {other.view(), other_allowed.view()}}};
  MoverScore score;
  score.removes = c.removes;
  score.view = CompareInstances(c.view, c.view_scale, instances, kOffLog10, area, /*wraps=*/true);
  score.own_frame =
      CompareInstances(c.own_frame, c.own_scale, instances, kOffLog10, area, /*wraps=*/true);
  return score;
}

}  // namespace omnihdr
