#include "core/stereo/lattice.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <numbers>

#include "core/base/simd.h"
#include "core/sphere/fast_angle.h"

namespace omnihdr {

std::vector<std::array<float, 2>> ColumnDirections(int width) {
  std::vector<std::array<float, 2>> columns(static_cast<std::size_t>(width));
  for (int x = 0; x < width; ++x) {
    const double theta = std::numbers::pi - 2.0 * std::numbers::pi * (x + 0.5) / width;
    columns[static_cast<std::size_t>(x)] = {static_cast<float>(std::cos(theta)),
                                            static_cast<float>(std::sin(theta))};
  }
  return columns;
}

void FillRays(const std::vector<std::array<float, 2>>& columns, int x0, int y, int height,
              TileRays* rays) {
  const double phi = std::numbers::pi * (y + 0.5) / height;
  const auto sin_phi = static_cast<float>(std::sin(phi));
  rays->z = static_cast<float>(std::cos(phi));
  const int last = static_cast<int>(columns.size()) - 1;
  for (int i = 0; i < kTileColumns; ++i) {
    const auto& [c, s] = columns[static_cast<std::size_t>(std::min(x0 + i, last))];
    rays->x[static_cast<std::size_t>(i)] = sin_phi * c;
    rays->y[static_cast<std::size_t>(i)] = sin_phi * s;
  }
}

namespace {

// How far, in texels, the middle one of three may lie beside the line between the others for a
// parabola through them to be good for those between. The error is of the third order: less than a
// tenth of that.
constexpr float kMostBend = 1.0F;

struct LatticeScale {
  float column;
  float row;
  int last_column;
  int last_row;
};

struct LatticePoints {
  alignas(64) std::array<float, kTileColumns> column;
  alignas(64) std::array<float, kTileColumns> row;
};

// Where the neighbour sees the tile's pixels at one disparity, in texels.
OMNIHDR_ALWAYS_INLINE void PointsAt(const TileRays& u, const float* offset, float d,
                                    const LatticeScale& scale, LatticePoints* points) {
  constexpr float kPi = 3.14159265358979324F;
  const float dx = d * offset[0];
  const float dy = d * offset[1];
  const float vz = u.z - d * offset[2];
  for (std::size_t i = 0; i < kTileColumns; ++i) {
    const float vx = u.x[i] - dx;
    const float vy = u.y[i] - dy;
    const float rho = std::sqrt(vx * vx + vy * vy);
    points->column[i] = (kPi - FastAtan2(vy, vx)) * scale.column;
    points->row[i] = FastAtan2(rho, vz) * scale.row;
  }
}

OMNIHDR_ALWAYS_INLINE std::int32_t IndexAt(float column, float row, const LatticeScale& scale) {
  auto i = static_cast<std::int32_t>(row + 0.5F);
  auto j = static_cast<std::int32_t>(column + 0.5F);
  i = i < scale.last_row ? i : scale.last_row;
  j = j < scale.last_column ? j : scale.last_column;
  i = i > 0 ? i : 0;
  j = j > 0 ? j : 0;
  return i * (scale.last_column + 1) + j;
}

}  // namespace

OMNIHDR_SIMD_CLONES
void LatticeIndices(const TileRays& u, const float* offset, const LabelDisparities& d,
                    int lattice_width, int lattice_height, std::int32_t* index) {
  constexpr float kPi = 3.14159265358979324F;
  constexpr int kHalf = kTileLabels / 2;
  const LatticeScale scale = {static_cast<float>(lattice_width) / (2.0F * kPi),
                              static_cast<float>(lattice_height) / kPi, lattice_width,
                              lattice_height};
  LatticePoints first;
  LatticePoints middle;
  LatticePoints end;
  PointsAt(u, offset, d.first, scale, &first);
  PointsAt(u, offset, d.first + kHalf * d.step, scale, &middle);
  PointsAt(u, offset, d.first + kTileLabels * d.step, scale, &end);
  int bent = 0;
  for (std::size_t i = 0; i < kTileColumns; ++i) {
    const float column = 0.5F * (first.column[i] + end.column[i]) - middle.column[i];
    const float row = 0.5F * (first.row[i] + end.row[i]) - middle.row[i];
    bent |= static_cast<int>(column * column + row * row > kMostBend * kMostBend);
  }
  if (bent != 0) {
    for (int label = 0; label < kTileLabels; ++label) {
      PointsAt(u, offset, d.first + static_cast<float>(label) * d.step, scale, &middle);
      std::int32_t* out = index + label * kTileColumns;
      for (std::size_t i = 0; i < kTileColumns; ++i) {
        out[i] = IndexAt(middle.column[i], middle.row[i], scale);
      }
    }
    return;
  }
  for (int label = 0; label < kTileLabels; ++label) {
    const float t = static_cast<float>(label - kHalf) / kHalf;
    const float of_first = 0.5F * t * (t - 1.0F);
    const float of_middle = 1.0F - t * t;
    const float of_end = 0.5F * t * (t + 1.0F);
    std::int32_t* out = index + label * kTileColumns;
    for (std::size_t i = 0; i < kTileColumns; ++i) {
      out[i] = IndexAt(
          of_first * first.column[i] + of_middle * middle.column[i] + of_end * end.column[i],
          of_first * first.row[i] + of_middle * middle.row[i] + of_end * end.row[i], scale);
    }
  }
}

OMNIHDR_SIMD_CLONES
void GatherTexels(const std::uint64_t* texels, const std::int32_t* index, std::uint64_t* out) {
  for (int i = 0; i < kSweepBlock; ++i) out[i] = texels[index[i]];
}

OMNIHDR_SIMD_CLONES
void NormaliseSums(const std::uint16_t* sum, std::uint16_t multiplier, std::uint8_t* out) {
  for (int i = 0; i < kSweepBlock; ++i) {
    out[i] = static_cast<std::uint8_t>((static_cast<std::uint32_t>(sum[i]) * multiplier + 32768U) >>
                                       16U);
  }
}

OMNIHDR_SIMD_CLONES
void StoreLabelFastest(const std::uint8_t* block, int columns, int labels, std::ptrdiff_t stride,
                       std::uint8_t* out) {
  static_assert(kTileLabels == sizeof(std::uint64_t) && std::endian::native == std::endian::little);
  alignas(64) std::array<std::uint64_t, kTileColumns> of_column;
  for (std::size_t i = 0; i < kTileColumns; ++i) {
    std::uint64_t all = 0;
    for (std::size_t label = 0; label < kTileLabels; ++label) {
      all |= static_cast<std::uint64_t>(block[label * kTileColumns + i]) << (8 * label);
    }
    of_column[i] = all;
  }
  if (labels == kTileLabels) {
    for (int i = 0; i < columns; ++i) {
      std::memcpy(out + i * stride, &of_column[static_cast<std::size_t>(i)], kTileLabels);
    }
    return;
  }
  for (int i = 0; i < columns; ++i) {
    std::memcpy(out + i * stride, &of_column[static_cast<std::size_t>(i)],
                static_cast<std::size_t>(labels));
  }
}

}  // namespace omnihdr
