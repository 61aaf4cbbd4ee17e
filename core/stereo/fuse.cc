#include "core/stereo/fuse.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/base/parallel_for.h"
#include "core/sphere/latlong_grid.h"

namespace omnihdr {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

Image<float> WarpOnGrid(const DisparityMap& map, const Eigen::Vector3f& offset,
                        const LatLongGrid& grid) {
  const int width = map.disparity.width();
  const int height = map.disparity.height();
  Image<float> warped(width, height, 1, kNan);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const float d = map.disparity.at(x, y);
      if (!(d >= 0.0F)) continue;
      const Eigen::Vector3f v = grid.Ray(x, y) - d * offset;
      const float length = v.norm();
      if (length < 1e-6F) continue;
      const float d_there = d / length;
      int tx = 0;
      int ty = 0;
      grid.Pixel(v, &tx, &ty);
      float& target = warped.at(tx, ty);
      if (!(target >= d_there)) target = d_there;
    }
  }
  return warped;
}

}  // namespace

Image<float> WarpDisparity(const DisparityMap& map, const Eigen::Vector3f& offset) {
  return WarpOnGrid(map, offset, LatLongGrid(map.disparity.width(), map.disparity.height()));
}

DisparityMap FuseDisparity(const DisparityMap& reference,
                           const std::vector<NeighbourMap>& neighbours,
                           const FuseOptions& options) {
  const int width = reference.disparity.width();
  const int height = reference.disparity.height();
  const LatLongGrid grid(width, height);
  std::vector<Image<float>> warped(neighbours.size());
  ParallelFor(static_cast<int>(neighbours.size()), 1, [&](int begin, int end) {
    for (int n = begin; n < end; ++n) {
      const NeighbourMap& neighbour = neighbours[static_cast<std::size_t>(n)];
      // From the neighbour's centre the reference lies at -offset.
      warped[static_cast<std::size_t>(n)] = WarpOnGrid(*neighbour.map, -neighbour.offset, grid);
    }
  });
  const auto tolerance = static_cast<float>(options.tolerance);
  const auto relative = static_cast<float>(options.relative_tolerance);
  const auto maps = static_cast<float>(neighbours.size() + 1);

  DisparityMap fused;
  fused.disparity = Image<float>(width, height, 1, kNan);
  fused.confidence = Image<float>(width, height);
  ParallelFor(height, 8, [&](int begin, int end) {
    std::vector<float> values;
    std::vector<float> weights;
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        values.clear();
        weights.clear();
        const float own = reference.disparity.at(x, y);
        if (own >= 0.0F) {
          values.push_back(own);
          weights.push_back(0.5F + reference.confidence.at(x, y));
        }
        for (const Image<float>& w : warped) {
          const float d = w.at(x, y);
          if (d >= 0.0F) {
            values.push_back(d);
            weights.push_back(1.0F);
          }
        }
        const Eigen::Vector3f ray = grid.Ray(x, y);
        float best_score = -1e9F;
        float best_mean = kNan;
        for (std::size_t i = 0; i < values.size(); ++i) {
          const float candidate = values[i];
          // One next to a candidate already judged would be judged alike.
          const auto judged = values.begin() + static_cast<std::ptrdiff_t>(i);
          const float alike = 0.25F * std::max(tolerance, relative * candidate);
          if (std::any_of(values.begin(), judged,
                          [&](float v) { return std::abs(v - candidate) < alike; })) {
            continue;
          }
          const float near = std::max(tolerance, relative * candidate);
          float support = 0.0F;
          float sum = 0.0F;
          for (std::size_t k = 0; k < values.size(); ++k) {
            if (std::abs(values[k] - candidate) > near) continue;
            support += weights[k];
            sum += weights[k] * values[k];
          }
          float score = support;
          for (const NeighbourMap& neighbour : neighbours) {
            const Eigen::Vector3f v = ray - candidate * neighbour.offset;
            const float length = v.norm();
            if (length < 1e-6F) continue;
            const float expected = candidate / length;
            int nx = 0;
            int ny = 0;
            grid.Pixel(v, &nx, &ny);
            const float seen = neighbour.map->disparity.at(nx, ny);
            if (seen >= 0.0F && seen < expected - std::max(tolerance, relative * expected)) {
              score -= options.violation_weight;
            }
          }
          if (score > best_score) {
            best_score = score;
            best_mean = sum / support;
          }
        }
        if (best_score < options.least_score) continue;
        fused.disparity.at(x, y) = best_mean;
        fused.confidence.at(x, y) = std::clamp(best_score / maps, 0.0F, 1.0F);
      }
    }
  });
  return fused;
}

void FillHoles(const Image<std::uint8_t>& brightness, const FillOptions& options,
               DisparityMap* map) {
  static constexpr std::array<std::array<int, 2>, 8> kDirections = {
      {{1, 0}, {-1, 0}, {0, 1}, {0, -1}, {1, 1}, {-1, -1}, {1, -1}, {-1, 1}}};
  const int width = map->disparity.width();
  const int height = map->disparity.height();
  const int reach = std::min(options.reach, width);  // farther, a row comes back to its start
  const Image<float> known = map->disparity.Clone();
  ParallelFor(height, 4, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        if (known.at(x, y) >= 0.0F) continue;
        std::array<float, 8> rim{};
        std::array<float, 8> weight{};
        int count = 0;
        for (const auto& [dx, dy] : kDirections) {
          for (int k = 1; k <= reach; ++k) {
            const int sy = y + k * dy;
            if (sy < 0 || sy >= height) break;
            int sx = x + k * dx;
            if (sx < 0) sx += width;
            if (sx >= width) sx -= width;
            const float d = known.at(sx, sy);
            if (!(d >= 0.0F)) continue;
            const float unlike = std::abs(static_cast<float>(brightness.at(x, y)) -
                                          static_cast<float>(brightness.at(sx, sy)));
            rim[static_cast<std::size_t>(count)] = d;
            weight[static_cast<std::size_t>(count)] =
                std::exp(-unlike / options.colour_codes) / static_cast<float>(k);
            ++count;
            break;
          }
        }
        map->confidence.at(x, y) = 0.0F;
        if (count == 0) {
          map->disparity.at(x, y) = 0.0F;  // nothing known anywhere near: as if at infinity
          continue;
        }
        // Weighted lower quartile: leans to the farther surface, and is no blend of near and far.
        for (int k = 1; k < count; ++k) {  // insertion sort by disparity
          for (auto i = static_cast<std::size_t>(k); i > 0 && rim[i] < rim[i - 1]; --i) {
            std::swap(rim[i], rim[i - 1]);
            std::swap(weight[i], weight[i - 1]);
          }
        }
        float total = 0.0F;
        for (int k = 0; k < count; ++k) total += weight[static_cast<std::size_t>(k)];
        float passed = 0.0F;
        for (int k = 0; k < count; ++k) {
          const auto i = static_cast<std::size_t>(k);
          passed += weight[i];
          if (passed >= 0.35F * total) {
            map->disparity.at(x, y) = rim[i];
            break;
          }
        }
      }
    }
  });
}

}  // namespace omnihdr
