#include "core/quality/mover_metrics.h"

#include <algorithm>
#include <cassert>
#include <cmath>
#include <limits>

#include "core/photometry/tonemap.h"

namespace omnihdr {
namespace {

struct Interval {
  double low = std::numeric_limits<double>::infinity();
  double high = 0.0;
};

// Of an instance round a pixel; empty where it is not known at the pixel itself.
Interval IntervalAt(ImageView<const float> radiance, int x, int y, bool wraps) {
  const auto luminance = [&](int px, int py) {
    const auto value = static_cast<double>(Luminance(radiance.pixel(px, py)));
    return value > 0.0 && std::isfinite(value) ? value : 0.0;
  };
  Interval interval;
  if (!(luminance(x, y) > 0.0)) return interval;
  for (int dy = -1; dy <= 1; ++dy) {
    const int py = std::clamp(y + dy, 0, radiance.height() - 1);
    for (int dx = -1; dx <= 1; ++dx) {
      const int width = radiance.width();
      const int px = wraps ? (x + dx + width) % width : std::clamp(x + dx, 0, width - 1);
      const double value = luminance(px, py);
      if (!(value > 0.0)) continue;
      interval.low = std::min(interval.low, value);
      interval.high = std::max(interval.high, value);
    }
  }
  return interval;
}

}  // namespace

InstanceErrors CompareInstances(ImageView<const float> tested, double scale,
                                std::span<const Instance> instances, double limit_log10,
                                const ComparisonArea& area, bool wraps) {
  const double tolerance = std::pow(10.0, limit_log10);
  InstanceErrors errors;
  double off = 0.0;
  for (int y = 0; y < tested.height(); ++y) {
    for (int x = 0; x < tested.width(); ++x) {
      if (!area.Has(x, y)) continue;
      const double have = scale * static_cast<double>(Luminance(tested.pixel(x, y)));
      bool is_known = false;
      bool is_accepted = false;
      for (const Instance& instance : instances) {
        assert(instance.radiance.width() == tested.width());
        if (!instance.allowed.empty() && instance.allowed.at(x, y) == 0) continue;
        const Interval want = IntervalAt(instance.radiance, x, y, wraps);
        if (!(want.high > 0.0)) continue;
        is_known = true;
        is_accepted |= have >= want.low / tolerance && have <= want.high * tolerance;
      }
      if (!is_known) continue;
      ++errors.pixels;
      errors.weight += area.Weight(y);
      if (!is_accepted) off += area.Weight(y);
    }
  }
  if (errors.weight > 0.0) errors.share_off = off / errors.weight;
  return errors;
}

}  // namespace omnihdr
