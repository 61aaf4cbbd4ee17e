#include "core/stereo/lattice.h"

#include <algorithm>
#include <cmath>
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
              RayBlock* rays) {
  const double phi = std::numbers::pi * (y + 0.5) / height;
  const auto sin_phi = static_cast<float>(std::sin(phi));
  rays->z = static_cast<float>(std::cos(phi));
  const int last = static_cast<int>(columns.size()) - 1;
  for (int i = 0; i < kSweepBlock; ++i) {
    const int x = std::min(x0 + i % kTileColumns, last);
    const auto& [c, s] = columns[static_cast<std::size_t>(x)];
    rays->x[static_cast<std::size_t>(i)] = sin_phi * c;
    rays->y[static_cast<std::size_t>(i)] = sin_phi * s;
  }
}

void FillDisparities(int first_label, double step, DisparityBlock* d) {
  for (int label = 0; label < kTileLabels; ++label) {
    std::fill_n(d->begin() + static_cast<std::ptrdiff_t>(label) * kTileColumns, kTileColumns,
                static_cast<float>((first_label + label) * step));
  }
}

OMNIHDR_SIMD_CLONES
void LatticeIndices(const RayBlock& u, const float* offset, const DisparityBlock& d,
                    int lattice_width, int lattice_height, std::int32_t* index) {
  constexpr float kPi = 3.14159265358979324F;
  const float bx = offset[0];
  const float by = offset[1];
  const float bz = offset[2];
  const float x_scale = static_cast<float>(lattice_width) / (2.0F * kPi);
  const float y_scale = static_cast<float>(lattice_height) / kPi;
  const std::int32_t stride = lattice_width + 1;
  for (int i = 0; i < kSweepBlock; ++i) {
    const auto k = static_cast<std::size_t>(i);
    const float vx = u.x[k] - d[k] * bx;
    const float vy = u.y[k] - d[k] * by;
    const float vz = u.z - d[k] * bz;
    const float rho = std::sqrt(vx * vx + vy * vy);
    const float column = (kPi - FastAtan2(vy, vx)) * x_scale;
    const float row = FastAtan2(rho, vz) * y_scale;
    index[i] =
        static_cast<std::int32_t>(row + 0.5F) * stride + static_cast<std::int32_t>(column + 0.5F);
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

void StoreLabelFastest(const std::uint8_t* block, int columns, int labels, std::ptrdiff_t stride,
                       std::uint8_t* out) {
  for (int i = 0; i < columns; ++i) {
    for (int label = 0; label < labels; ++label) {
      out[i * stride + label] =
          block[static_cast<std::size_t>(label) * kTileColumns + static_cast<std::size_t>(i)];
    }
  }
}

}  // namespace omnihdr
