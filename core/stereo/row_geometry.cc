#include "core/stereo/row_geometry.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/base/simd.h"

namespace omnihdr {
namespace {

// Row-major, so that the loops below read plain floats.
struct Turn {
  std::array<float, 9> m;
  explicit Turn(const Eigen::Matrix3f& matrix) {
    for (int k = 0; k < 9; ++k) m[static_cast<std::size_t>(k)] = matrix(k / 3, k % 3);
  }
};

struct Rays {
  const float* __restrict x;
  const float* __restrict y;
  const float* __restrict z;
  int count;
};
Rays Of(const RayRow& rays) {
  return {rays.x.data(), rays.y.data(), rays.z.data(), static_cast<int>(rays.size())};
}

OMNIHDR_SIMD_CLONES
void PointsLatLong(Rays rays, Turn turn, float x_scale, float y_scale, float* __restrict px,
                   float* __restrict py) {
  constexpr float kPi = 3.14159265358979324F;
  for (int i = 0; i < rays.count; ++i) {
    const float x = turn.m[0] * rays.x[i] + turn.m[1] * rays.y[i] + turn.m[2] * rays.z[i];
    const float y = turn.m[3] * rays.x[i] + turn.m[4] * rays.y[i] + turn.m[5] * rays.z[i];
    const float z = turn.m[6] * rays.x[i] + turn.m[7] * rays.y[i] + turn.m[8] * rays.z[i];
    px[i] = (kPi - FastAtan2(y, x)) * x_scale;
    py[i] = FastAtan2(std::sqrt(x * x + y * y), z) * y_scale;
  }
}

OMNIHDR_SIMD_CLONES
void PointsCylinder(Rays rays, Turn turn, float x_scale, float y_scale, float y_offset,
                    float* __restrict px, float* __restrict py) {
  constexpr float kPi = 3.14159265358979324F;
  for (int i = 0; i < rays.count; ++i) {
    const float x = turn.m[0] * rays.x[i] + turn.m[1] * rays.y[i] + turn.m[2] * rays.z[i];
    const float y = turn.m[3] * rays.x[i] + turn.m[4] * rays.y[i] + turn.m[5] * rays.z[i];
    const float z = turn.m[6] * rays.x[i] + turn.m[7] * rays.y[i] + turn.m[8] * rays.z[i];
    const float rho = std::sqrt(x * x + y * y);
    px[i] = (kPi - FastAtan2(y, x)) * x_scale;
    py[i] = y_offset - y_scale * z / (rho > 1e-9F ? rho : 1e-9F);
  }
}

// `columns`, `row`: as LatLongGrid has them.
OMNIHDR_SIMD_CLONES
void TurnedRow(const std::array<float, 2>* __restrict columns, int step, int count,
               std::array<float, 2> row, Turn turn, float* __restrict x, float* __restrict y,
               float* __restrict z) {
  const auto [sin_phi, cos_phi] = row;
  for (int i = 0; i < count; ++i) {
    const auto& [cos_theta, sin_theta] = columns[i * step];
    const float rx = sin_phi * cos_theta;
    const float ry = sin_phi * sin_theta;
    x[i] = turn.m[0] * rx + turn.m[1] * ry + turn.m[2] * cos_phi;
    y[i] = turn.m[3] * rx + turn.m[4] * ry + turn.m[5] * cos_phi;
    z[i] = turn.m[6] * rx + turn.m[7] * ry + turn.m[8] * cos_phi;
  }
}

// Rays from the view to the surface points, and how long they are.
OMNIHDR_SIMD_CLONES
void FromView(Rays rays, const float* __restrict disparity, std::array<float, 3> offset,
              float* __restrict x, float* __restrict y, float* __restrict z,
              float* __restrict length) {
  for (int i = 0; i < rays.count; ++i) {
    x[i] = rays.x[i] - disparity[i] * offset[0];
    y[i] = rays.y[i] - disparity[i] * offset[1];
    z[i] = rays.z[i] - disparity[i] * offset[2];
    length[i] = std::sqrt(x[i] * x[i] + y[i] * y[i] + z[i] * z[i]);
  }
}

OMNIHDR_SIMD_CLONES
void PixelsOf(const float* __restrict px, const float* __restrict py, int count, int width,
              int height, int* __restrict column, int* __restrict row) {
  for (int i = 0; i < count; ++i) {
    const int x = static_cast<int>(px[i]);
    const int y = static_cast<int>(py[i]);
    column[i] = x < width - 1 ? x : width - 1;
    row[i] = y < height - 1 ? y : height - 1;
  }
}

const Turn& Unturned() {
  static const Turn unturned(Eigen::Matrix3f::Identity());
  return unturned;
}

void Resize(PointRow* points, std::size_t count) {
  points->x.resize(count);
  points->y.resize(count);
}

}  // namespace

void RaysOfRow(const LatLongGrid& grid, int y, int first, int step,
               const Eigen::Matrix3f& world_from_grid, RayRow* rays) {
  const auto count = static_cast<std::size_t>((grid.width() - first + step - 1) / step);
  rays->x.resize(count);
  rays->y.resize(count);
  rays->z.resize(count);
  TurnedRow(grid.columns() + first, step, static_cast<int>(count), grid.row(y),
            Turn(world_from_grid), rays->x.data(), rays->y.data(), rays->z.data());
}

void PointsOnGrid(const RayRow& rays, const LatLongGrid& grid, PointRow* points) {
  Resize(points, rays.size());
  PointsLatLong(Of(rays), Unturned(), grid.x_scale(), grid.y_scale(), points->x.data(),
                points->y.data());
}

void PointsInView(const RayRow& rays, const Eigen::Matrix3f& camera_from_world,
                  const PanoramaSampler& view, PointRow* points) {
  Resize(points, rays.size());
  const Turn turn(camera_from_world);
  if (view.is_cylinder()) {
    PointsCylinder(Of(rays), turn, view.x_scale(), view.y_scale(), view.y_offset(),
                   points->x.data(), points->y.data());
  } else {
    PointsLatLong(Of(rays), turn, view.x_scale(), view.y_scale(), points->x.data(),
                  points->y.data());
  }
}

void SurfacePointsOnGrid(const RayRow& rays, const float* disparity, const Eigen::Vector3f& offset,
                         const LatLongGrid& grid, SeenRow* seen) {
  const std::size_t count = rays.size();
  seen->towards.x.resize(count);
  seen->towards.y.resize(count);
  seen->towards.z.resize(count);
  seen->distance.resize(count);
  seen->grid_column.resize(count);
  seen->grid_row.resize(count);
  FromView(Of(rays), disparity, {offset.x(), offset.y(), offset.z()}, seen->towards.x.data(),
           seen->towards.y.data(), seen->towards.z.data(), seen->distance.data());
  PointsOnGrid(seen->towards, grid, &seen->image);
  PixelsOf(seen->image.x.data(), seen->image.y.data(), static_cast<int>(count), grid.width(),
           grid.height(), seen->grid_column.data(), seen->grid_row.data());
}

void SurfacePointsInView(const RayRow& rays, const std::vector<float>& disparity,
                         const Eigen::Vector3f& offset, const Eigen::Matrix3f& camera_from_world,
                         const PanoramaSampler& view, const LatLongGrid& grid, SeenRow* seen) {
  SurfacePointsOnGrid(rays, disparity.data(), offset, grid, seen);
  PointsInView(seen->towards, camera_from_world, view, &seen->image);
}

}  // namespace omnihdr
