#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <vector>

#include "core/photometry/sampler.h"
#include "core/sphere/latlong_grid.h"

namespace omnihdr {

// Where a row of directions falls in the views: the arithmetic that is the same for every pixel, a
// row at a time, so that it is done in vectors. Value types, one per thread.

// Rays of a row's pixels in the world frame.
struct RayRow {
  std::vector<float> x;
  std::vector<float> y;
  std::vector<float> z;
  std::size_t size() const { return x.size(); }
};

// Points of an image.
struct PointRow {
  std::vector<float> x;
  std::vector<float> y;
};

// The pixels first, first + step, ... of row `y` of `grid`.
void RaysOfRow(const LatLongGrid& grid, int y, int first, int step,
               const Eigen::Matrix3f& world_from_grid, RayRow* rays);

// Image points of the rays on a world-aligned lat-long grid.
void PointsOnGrid(const RayRow& rays, const LatLongGrid& grid, PointRow* points);

// Image points of the rays in a view.
void PointsInView(const RayRow& rays, const Eigen::Matrix3f& camera_from_world,
                  const PanoramaSampler& view, PointRow* points);

// Where a view at another place sees the surface points that lie along the rays.
struct SeenRow {
  RayRow towards;  // from the view to the points, in the world frame, in units of the reference's
  std::vector<float> distance;  // length of those
  PointRow image;               // the points in the view
  std::vector<int>
      grid_column;  // the pixel of a world-aligned lat-long grid that looks at the point
  std::vector<int> grid_row;
};
// `disparity`: of each ray from the reference, 0 and above (0: infinitely far). `offset`: the
// view's centre from the reference's, in the world frame.
void SurfacePointsInView(const RayRow& rays, const std::vector<float>& disparity,
                         const Eigen::Vector3f& offset, const Eigen::Matrix3f& camera_from_world,
                         const PanoramaSampler& view, const LatLongGrid& grid, SeenRow* seen);
// The same without the points in the view: only which pixels of the grid look at them.
void SurfacePointsOnGrid(const RayRow& rays, const float* disparity, const Eigen::Vector3f& offset,
                         const LatLongGrid& grid, SeenRow* seen);

}  // namespace omnihdr
