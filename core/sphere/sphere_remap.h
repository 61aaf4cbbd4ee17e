#pragma once

#include <Eigen/Core>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/image/image.h"
#include "core/sphere/sphere_grid.h"

namespace omnihdr {

struct SphereRemapOptions {
  // Where a target pixel is larger than the source's, average what it covers (by up to 8 × 8
  // bilinear samples) instead of sampling its centre alone.
  bool area = true;
  // Rows of the target for which tables are built: tables of a large picture are made in stripes.
  int first_row = 0;
  int rows = -1;  // -1: to the end
};

// Resampling of a picture of the sphere into another projection, as a table built once and applied
// to any number of pictures of the source's size. Bilinear on the sphere: at the border of a face,
// round the back and over the poles the neighbour's pixels take part, so that a smooth scene stays
// smooth. The values are interpolated as they are (linear light for radiance, code values for
// pictures). Thread-safe to apply; deterministic on any number of cores.
class SphereRemap {
 public:
  // `source_from_target` turns a target ray into the source's frame: ray_source = R · ray_target.
  SphereRemap(const SphereGrid& target, const SphereGrid& source,
              const SphereRemapOptions& options = {},
              const Eigen::Matrix3d& source_from_target = Eigen::Matrix3d::Identity());

  // Requires pictures of the two grids' sizes with the same number of channels, at most 4, the
  // source's rows without gaps; target rows outside the table's are left alone. Float: NaN is "no
  // value"; a pixel is the weighted mean of the values there are when these have at least half of
  // its weight, else NaN. Where the source does not reach, and in what shows no part of the sphere:
  // NaN in float, 0 in integers.
  void Apply(ImageView<const float> source, ImageView<float> target) const;
  void Apply(ImageView<const std::uint8_t> source, ImageView<std::uint8_t> target) const;
  void Apply(ImageView<const std::uint16_t> source, ImageView<std::uint16_t> target) const;
  // The nearest source pixel: for labels and flags, which have no in-between.
  void ApplyNearest(ImageView<const float> source, ImageView<float> target) const;
  void ApplyNearest(ImageView<const std::uint8_t> source, ImageView<std::uint8_t> target) const;

  const SphereGrid& target() const { return target_; }
  const SphereGrid& source() const { return source_; }
  // Memory of the tables.
  std::size_t Bytes() const;

 private:
  struct Tap {
    std::uint32_t pixel;
    float weight;
  };
  // A target pixel that a 2×2 block of the source does not make: at seams, minified, or empty (no
  // taps).
  struct Gathered {
    int x;
    std::uint32_t nearest;
    std::size_t first_tap;  // its taps end where the next one's begin
  };
  struct RowTable;

  // Fills the row's part of base_ and fraction_.
  RowTable BuildRow(int row, const Eigen::Matrix3d& source_from_target, bool area);
  template <typename T>
  void ApplyTo(ImageView<const T> source, ImageView<T> target) const;
  template <typename T>
  void ApplyNearestTo(ImageView<const T> source, ImageView<T> target) const;

  SphereGrid target_;
  SphereGrid source_;
  int first_row_ = 0;
  int rows_ = 0;
  // Of each target pixel: the top left of its 2×2 source pixels, and the position between them in
  // 1/65536, x in the high half.
  std::vector<std::uint32_t> base_;
  std::vector<std::uint32_t> fraction_;
  std::vector<Gathered> gathered_;           // by rows
  std::vector<std::size_t> first_gathered_;  // of each row, and the end
  std::vector<Tap> taps_;
};

}  // namespace omnihdr
