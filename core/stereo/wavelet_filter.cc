#include "core/stereo/wavelet_filter.h"

#include <algorithm>
#include <array>
#include <cassert>
#include <cmath>
#include <limits>
#include <utility>
#include <vector>

#include "core/base/parallel_for.h"

namespace omnihdr {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();
constexpr std::array<float, 5> kSpline = {1.0F / 16, 4.0F / 16, 6.0F / 16, 4.0F / 16, 1.0F / 16};

// Value times weight, and weight: sums of known pixels.
struct Weighted {
  Image<float> value;
  Image<float> weight;
};

Image<float> SmoothRows(const Image<float>& in, int spacing) {
  const int width = in.width();
  Image<float> out(width, in.height());
  ParallelFor(in.height(), 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        float sum = 0.0F;
        for (int t = -2; t <= 2; ++t) {
          const int from = ((x + t * spacing) % width + width) % width;
          sum += kSpline[static_cast<std::size_t>(t + 2)] * in.at(from, y);
        }
        out.at(x, y) = sum;
      }
    }
  });
  return out;
}

// Rows beyond a pole do not exist: their share of the weight is missing, as that of unknown pixels.
Image<float> SmoothColumns(const Image<float>& in, int spacing) {
  Image<float> out(in.width(), in.height());
  ParallelFor(in.height(), 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      float* to = out.row(y);
      for (int t = -2; t <= 2; ++t) {
        const int from = y + t * spacing;
        if (from < 0 || from >= in.height()) continue;
        const float* row = in.row(from);
        const float k = kSpline[static_cast<std::size_t>(t + 2)];
        for (int x = 0; x < in.width(); ++x) to[x] += k * row[x];
      }
    }
  });
  return out;
}

// The approximations of the map at scales 0 (itself) to `scales`; NaN where the map is unknown.
std::vector<Image<float>> Approximations(const Image<float>& map, int scales) {
  std::vector<Image<float>> out;
  out.push_back(map.Clone());
  for (int scale = 0; scale < scales; ++scale) {
    const Image<float>& last = out.back();
    Weighted w = {Image<float>(map.width(), map.height()), Image<float>(map.width(), map.height())};
    for (std::size_t k = 0; k < last.size(); ++k) {
      const float d = last.values()[k];
      if (!(d >= 0.0F)) continue;
      w.value.values()[k] = d;
      w.weight.values()[k] = 1.0F;
    }
    const int spacing = 1 << scale;
    const Image<float> value = SmoothColumns(SmoothRows(w.value, spacing), spacing);
    const Image<float> weight = SmoothColumns(SmoothRows(w.weight, spacing), spacing);
    Image<float> next(map.width(), map.height(), 1, kNan);
    for (std::size_t k = 0; k < next.size(); ++k) {
      if (!(last.values()[k] >= 0.0F)) continue;
      next.values()[k] = value.values()[k] / weight.values()[k];
    }
    out.push_back(std::move(next));
  }
  return out;
}

// Least value within `reach` pixels each side; NaN counts as none.
Image<float> LeastAround(const Image<float>& in, int reach) {
  const int width = in.width();
  const int height = in.height();
  constexpr float kNone = std::numeric_limits<float>::max();
  Image<float> rows(width, height, 1, kNone);
  Image<float> out(width, height, 1, kNone);
  const auto lesser = [](float a, float b) { return b < a ? b : a; };  // a when b is NaN
  ParallelFor(height, 8, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        float least = kNone;
        for (int t = -reach; t <= reach; ++t) {
          least = lesser(least, in.at(((x + t) % width + width) % width, y));
        }
        rows.at(x, y) = least;
      }
    }
  });
  ParallelFor(height, 8, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int t = std::max(0, y - reach); t <= std::min(height - 1, y + reach); ++t) {
        for (int x = 0; x < width; ++x) out.at(x, y) = lesser(out.at(x, y), rows.at(x, t));
      }
    }
  });
  return out;
}

// Standard deviation of noise among a scale's details, from their median magnitude.
float NoiseOf(const Image<float>& finer, const Image<float>& coarser, const Image<float>& map) {
  std::vector<float> magnitudes;
  magnitudes.reserve(map.size());
  for (std::size_t k = 0; k < map.size(); ++k) {
    if (!(map.values()[k] >= 0.0F)) continue;
    magnitudes.push_back(std::abs(finer.values()[k] - coarser.values()[k]));
  }
  if (magnitudes.empty()) return 0.0F;
  const auto middle = magnitudes.begin() + static_cast<std::ptrdiff_t>(magnitudes.size() / 2);
  std::nth_element(magnitudes.begin(), middle, magnitudes.end());
  return 1.4826F * *middle;
}

}  // namespace

void FilterWavelet(const WaveletOptions& options, DisparityMap* map) {
  assert(options.scales >= 1 && options.scales <= 5);
  Image<float>& disparity = map->disparity;
  {
    const Image<float> coarse = std::move(Approximations(disparity, options.scales).back());
    const Image<float> floor = LeastAround(coarse, 2 << options.scales);
    for (std::size_t k = 0; k < disparity.size(); ++k) {
      float& d = disparity.values()[k];
      if (!(d >= 0.0F)) continue;
      const float least = floor.values()[k];
      const float near = std::max(static_cast<float>(options.tolerance),
                                  static_cast<float>(options.relative_tolerance) * least);
      if (d >= least - near) continue;
      d = kNan;
      map->confidence.values()[k] = 0.0F;
    }
  }
  const std::vector<Image<float>> scale = Approximations(disparity, options.scales);
  std::vector<float> threshold;
  for (std::size_t s = 0; s + 1 < scale.size(); ++s) {
    threshold.push_back(static_cast<float>(options.noise_sigmas) *
                        NoiseOf(scale[s], scale[s + 1], disparity));
  }
  ParallelFor(disparity.height(), 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < disparity.width(); ++x) {
        float& d = disparity.at(x, y);
        if (!(d >= 0.0F)) continue;
        for (std::size_t s = 0; s < threshold.size(); ++s) {
          const float detail = scale[s].at(x, y) - scale[s + 1].at(x, y);
          if (std::abs(detail) < threshold[s]) d -= detail;
        }
        d = std::max(d, 0.0F);
      }
    }
  });
}

}  // namespace omnihdr
