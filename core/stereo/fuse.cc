#include "core/stereo/fuse.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#include "core/base/parallel_for.h"
#include "core/base/simd.h"
#include "core/sphere/latlong_grid.h"
#include "core/stereo/row_geometry.h"

namespace omnihdr {
namespace {

constexpr float kNan = std::numeric_limits<float>::quiet_NaN();

// The unknown as if at infinity, for arithmetic that is then thrown away.
OMNIHDR_SIMD_CLONES
void KnownOrZero(const float* __restrict in, int count, float* __restrict out) {
  for (int i = 0; i < count; ++i) out[i] = in[i] >= 0.0F ? in[i] : 0.0F;
}

// WarpDisparity, with the confidence of what lands, 0 where nothing does.
DisparityMap WarpOnGrid(const DisparityMap& map, const Eigen::Vector3f& offset,
                        const LatLongGrid& grid) {
  const int width = map.disparity.width();
  const int height = map.disparity.height();
  DisparityMap warped{Image<float>(width, height, 1, kNan), Image<float>(width, height)};
  RayRow rays;
  SeenRow seen;
  std::vector<float> known(static_cast<std::size_t>(width));
  for (int y = 0; y < height; ++y) {
    RaysOfRow(grid, y, 0, 1, Eigen::Matrix3f::Identity(), &rays);
    const float* row = map.disparity.row(y);
    const float* confidence = map.confidence.row(y);
    KnownOrZero(row, width, known.data());
    SurfacePointsOnGrid(rays, known.data(), offset, grid, &seen);
    for (std::size_t i = 0; i < known.size(); ++i) {
      const float d = row[i];
      const float length = seen.distance[i];
      if (!(d >= 0.0F) || length < 1e-6F) continue;
      const float d_there = d / length;
      float& target = warped.disparity.at(seen.grid_column[i], seen.grid_row[i]);
      if (target >= d_there) continue;
      target = d_there;
      warped.confidence.at(seen.grid_column[i], seen.grid_row[i]) = confidence[i];
    }
  }
  return warped;
}

constexpr std::size_t kMostMaps = 9;

// What the maps say of a row, and how the votes stand.
struct VoteRow {
  std::array<std::vector<float>, kMostMaps> value;   // NaN: nothing
  std::array<std::vector<float>, kMostMaps> weight;  // 0 there
  std::vector<float> candidate;                      // 0 where there is none
  std::vector<float> sum;
  std::vector<float> support;
  std::vector<float> score;
  std::vector<float> best_score;
  std::vector<float> best_mean;
  explicit VoteRow(std::size_t width) : candidate(width), sum(width), support(width), score(width) {
    for (std::vector<float>& row : value) row.resize(width);
    for (std::vector<float>& row : weight) row.resize(width);
  }
};

constexpr float kDoubt = 0.5F;  // what a map's vote weighs that has no confidence at all

struct Tolerance {
  float absolute;
  float relative;
};

OMNIHDR_SIMD_CLONES
void WeighKnown(const float* __restrict value, const float* __restrict confidence, int count,
                float* __restrict out) {
  for (int i = 0; i < count; ++i) {
    const float w = kDoubt + confidence[i];
    out[i] = value[i] >= 0.0F ? w : 0.0F;
  }
}

// Adds the votes of a map for the candidates.
OMNIHDR_SIMD_CLONES
void AddVotes(const float* __restrict candidate, const float* __restrict value,
              const float* __restrict weight, int count, Tolerance tolerance, float* __restrict sum,
              float* __restrict support) {
  for (int i = 0; i < count; ++i) {
    const float wide = tolerance.relative * candidate[i];
    const float near = tolerance.absolute > wide ? tolerance.absolute : wide;
    const float gap = std::fabs(value[i] - candidate[i]);
    const float w = gap <= near ? weight[i] : 0.0F;  // never, of NaN
    support[i] += w;
    sum[i] += w > 0.0F ? w * value[i] : 0.0F;
  }
}

// Takes from the scores where a neighbour sees through the candidate.
OMNIHDR_SIMD_CLONES
void SubtractViolations(const float* __restrict map, const int* __restrict column,
                        const int* __restrict row, const float* __restrict distance,
                        const float* __restrict candidate, int count, int width,
                        Tolerance tolerance, float violation, float* __restrict score) {
  for (int i = 0; i < count; ++i) {
    const float expected = candidate[i] / distance[i];
    const float wide = tolerance.relative * expected;
    const float seen = map[row[i] * width + column[i]];
    const float limit = expected - (tolerance.absolute > wide ? tolerance.absolute : wide);
    const int violates = static_cast<int>(seen >= 0.0F) & static_cast<int>(seen < limit) &
                         static_cast<int>(distance[i] >= 1e-6F);
    score[i] -= violates != 0 ? violation : 0.0F;
  }
}

OMNIHDR_SIMD_CLONES
void KeepBest(const float* __restrict value, const float* __restrict score,
              const float* __restrict sum, const float* __restrict support, int count,
              float* __restrict best_score, float* __restrict best_mean) {
  for (int i = 0; i < count; ++i) {
    const int better =
        static_cast<int>(value[i] >= 0.0F) & static_cast<int>(score[i] > best_score[i]);
    best_score[i] = better != 0 ? score[i] : best_score[i];
    best_mean[i] = better != 0 ? sum[i] / support[i] : best_mean[i];
  }
}

}  // namespace

Image<float> WarpDisparity(const DisparityMap& map, const Eigen::Vector3f& offset) {
  return WarpOnGrid(map, offset, LatLongGrid(map.disparity.width(), map.disparity.height()))
      .disparity;
}

DisparityMap FuseDisparity(const DisparityMap& reference,
                           const std::vector<NeighbourMap>& neighbours,
                           const FuseOptions& options) {
  const int width = reference.disparity.width();
  const int height = reference.disparity.height();
  const LatLongGrid grid(width, height);
  std::vector<DisparityMap> warped(neighbours.size());
  ParallelFor(static_cast<int>(neighbours.size()), 1, [&](int begin, int end) {
    for (int n = begin; n < end; ++n) {
      const NeighbourMap& neighbour = neighbours[static_cast<std::size_t>(n)];
      // From the neighbour's centre the reference lies at -offset.
      warped[static_cast<std::size_t>(n)] = WarpOnGrid(*neighbour.map, -neighbour.offset, grid);
    }
  });
  const Tolerance tolerance = {static_cast<float>(options.tolerance),
                               static_cast<float>(options.relative_tolerance)};
  const std::size_t maps = std::min(neighbours.size() + 1, kMostMaps);

  DisparityMap fused;
  fused.disparity = Image<float>(width, height, 1, kNan);
  fused.confidence = Image<float>(width, height);
  ParallelFor(height, 8, [&](int begin, int end) {
    const auto pixels = static_cast<std::size_t>(width);
    VoteRow votes(pixels);
    RayRow rays;
    SeenRow seen;
    for (int y = begin; y < end; ++y) {
      RaysOfRow(grid, y, 0, 1, Eigen::Matrix3f::Identity(), &rays);
      for (std::size_t m = 0; m < maps; ++m) {
        const DisparityMap& map = m == 0 ? reference : warped[m - 1];
        std::copy_n(map.disparity.row(y), width, votes.value[m].begin());
        WeighKnown(map.disparity.row(y), map.confidence.row(y), width, votes.weight[m].data());
      }
      votes.best_score.assign(pixels, -1e9F);
      votes.best_mean.assign(pixels, kNan);
      for (std::size_t m = 0; m < maps; ++m) {
        KnownOrZero(votes.value[m].data(), width, votes.candidate.data());
        votes.sum.assign(pixels, 0.0F);
        votes.support.assign(pixels, 0.0F);
        for (std::size_t k = 0; k < maps; ++k) {
          AddVotes(votes.candidate.data(), votes.value[k].data(), votes.weight[k].data(), width,
                   tolerance, votes.sum.data(), votes.support.data());
        }
        votes.score = votes.support;
        for (std::size_t n = 0; n + 1 < maps; ++n) {
          const NeighbourMap& neighbour = neighbours[n];
          SurfacePointsOnGrid(rays, votes.candidate.data(), neighbour.offset, grid, &seen);
          SubtractViolations(neighbour.map->disparity.data(), seen.grid_column.data(),
                             seen.grid_row.data(), seen.distance.data(), votes.candidate.data(),
                             width, width, tolerance, options.violation_weight, votes.score.data());
        }
        KeepBest(votes.value[m].data(), votes.score.data(), votes.sum.data(), votes.support.data(),
                 width, votes.best_score.data(), votes.best_mean.data());
      }
      for (std::size_t i = 0; i < pixels; ++i) {
        if (votes.best_score[i] < options.least_score) continue;
        const int x = static_cast<int>(i);
        fused.disparity.at(x, y) = votes.best_mean[i];
        fused.confidence.at(x, y) =
            std::clamp(votes.best_score[i] / static_cast<float>(maps), 0.0F, 1.0F);
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
