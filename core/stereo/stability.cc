#include "core/stereo/stability.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/base/parallel_for.h"
#include "core/sphere/latlong_grid.h"

namespace omnihdr {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

class Agreement {
 public:
  explicit Agreement(const AgreementOptions& options)
      : tolerance_(static_cast<float>(options.tolerance)),
        relative_(static_cast<float>(options.relative_tolerance)) {}
  float Near(float disparity) const { return std::max(tolerance_, relative_ * disparity); }

 private:
  float tolerance_;
  float relative_;
};

// What a neighbour's map holds where it would see the point at disparity `d` along `ray`, and what
// it should hold; NaN when it says nothing.
struct Seen {
  float found = kNan;
  float expected = kNan;
};
Seen LookFrom(const NeighbourMap& neighbour, const LatLongGrid& grid, const Eigen::Vector3f& ray,
              float d) {
  const Eigen::Vector3f v = ray - d * neighbour.offset;
  const float length = v.norm();
  if (length < 1e-6F) return {};
  int x = 0;
  int y = 0;
  grid.Pixel(v, &x, &y);
  return {neighbour.map->disparity.at(x, y), d / length};
}

}  // namespace

DisparityMap CrossCheck(const DisparityMap& map, const std::vector<NeighbourMap>& neighbours,
                        const AgreementOptions& options) {
  const int width = map.disparity.width();
  const int height = map.disparity.height();
  const LatLongGrid grid(width, height);
  const Agreement agreement(options);
  DisparityMap checked;
  checked.disparity = Image<float>(width, height, 1, kNan);
  checked.confidence = Image<float>(width, height);
  ParallelFor(height, 8, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        const float d = map.disparity.at(x, y);
        if (!(d >= 0.0F)) continue;
        const Eigen::Vector3f ray = grid.Ray(x, y);
        int confirmed = 0;
        for (const NeighbourMap& neighbour : neighbours) {
          const Seen seen = LookFrom(neighbour, grid, ray, d);
          const float near = agreement.Near(std::max(seen.found, seen.expected));
          if (std::abs(seen.found - seen.expected) <= near) ++confirmed;
        }
        if (confirmed == 0) continue;
        checked.disparity.at(x, y) = d;
        checked.confidence.at(x, y) =
            static_cast<float>(confirmed) / static_cast<float>(neighbours.size());
      }
    }
  });
  return checked;
}

DisparityMap FuseByStability(const DisparityMap& reference,
                             const std::vector<NeighbourMap>& neighbours,
                             const AgreementOptions& options) {
  const int width = reference.disparity.width();
  const int height = reference.disparity.height();
  const LatLongGrid grid(width, height);
  const Agreement agreement(options);
  std::vector<Image<float>> warped(neighbours.size());
  ParallelFor(static_cast<int>(neighbours.size()), 1, [&](int begin, int end) {
    for (int k = begin; k < end; ++k) {
      const auto n = static_cast<std::size_t>(k);
      warped[n] = WarpDisparity(*neighbours[n].map, -neighbours[n].offset);
    }
  });
  DisparityMap fused;
  fused.disparity = Image<float>(width, height, 1, kNan);
  fused.confidence = Image<float>(width, height);
  ParallelFor(height, 8, [&](int begin, int end) {
    std::vector<float> values;
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        values.clear();
        const auto take = [&values](float d) {
          if (d >= 0.0F) values.push_back(d);
        };
        take(reference.disparity.at(x, y));
        for (const Image<float>& w : warped) take(w.at(x, y));
        const Eigen::Vector3f ray = grid.Ray(x, y);
        int least = std::numeric_limits<int>::max();
        float winner = kNan;
        for (const float candidate : values) {
          const float near = agreement.Near(candidate);
          int stability = static_cast<int>(std::count_if(
              values.begin(), values.end(), [&](float v) { return v > candidate + near; }));
          for (const NeighbourMap& neighbour : neighbours) {
            const Seen seen = LookFrom(neighbour, grid, ray, candidate);
            if (seen.found < seen.expected - agreement.Near(seen.expected)) --stability;
          }
          if (stability < 0 || stability > least) continue;
          if (stability < least || candidate > winner) winner = candidate;
          least = stability;
        }
        if (!(winner >= 0.0F)) continue;
        const float near = agreement.Near(winner);
        float sum = 0.0F;
        float count = 0.0F;
        for (const float v : values) {
          if (std::abs(v - winner) > near) continue;
          sum += v;
          count += 1.0F;
        }
        fused.disparity.at(x, y) = sum / count;
        fused.confidence.at(x, y) = count / static_cast<float>(neighbours.size() + 1);
      }
    }
  });
  return fused;
}

DisparityMap FuseCrossChecked(const DisparityMap& reference,
                              const std::vector<NeighbourMap>& neighbours,
                              const AgreementOptions& options) {
  std::vector<DisparityMap> checked;
  checked.reserve(neighbours.size());
  std::vector<NeighbourMap> maps;
  for (const NeighbourMap& n : neighbours) {
    checked.push_back(CrossCheck(*n.map, {{&reference, -n.offset}}, options));
    maps.push_back({&checked.back(), n.offset});
  }
  return FuseByStability(CrossCheck(reference, neighbours, options), maps, options);
}

}  // namespace omnihdr
