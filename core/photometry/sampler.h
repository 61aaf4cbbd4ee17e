#pragma once

#include <Eigen/Core>
#include <array>
#include <cmath>
#include <cstdint>

#include "core/base/simd.h"
#include "core/photometry/measurement.h"
#include "core/sphere/fast_angle.h"

namespace omnihdr {

// A bilinear sample of a measurement.
struct RadianceSample {
  std::array<float, 3> rgb{};
  std::uint8_t flags = kMasked;  // bits of every pixel that took part
};

// Fast bilinear lookup of a measurement along rays of its camera frame. Borrowed: the measurement
// must outlive the sampler. Thread-safe.
class PanoramaSampler {
 public:
  explicit PanoramaSampler(const Measurement& m) : m_(&m) {
    const Projection& p = m.projection;
    width_ = m.radiance.width();
    height_ = m.radiance.height();
    is_cylinder_ = p.kind() == ProjectionKind::kCylindrical;
    x_scale_ = static_cast<float>(width_) / 6.28318530717958648F;
    if (is_cylinder_) {
      y_scale_ = static_cast<float>(height_ / (p.z_max() - p.z_min()));
      y_offset_ = static_cast<float>(p.z_max()) * y_scale_;
    } else {
      y_scale_ = static_cast<float>(height_) / 3.14159265358979324F;
    }
  }

  // What PixelFromRay works with, for those that do whole rows: columns a radian; rows a radian, on
  // a cylinder rows a unit of z; the row of a cylinder's z = 0.
  bool is_cylinder() const { return is_cylinder_; }
  float x_scale() const { return x_scale_; }
  float y_scale() const { return y_scale_; }
  float y_offset() const { return y_offset_; }

  // Image point of a ray (any length).
  void PixelFromRay(float rx, float ry, float rz, float* x, float* y) const {
    constexpr float kPi = 3.14159265358979324F;
    *x = (kPi - FastAtan2(ry, rx)) * x_scale_;
    const float rho = std::sqrt(rx * rx + ry * ry);
    *y = is_cylinder_ ? y_offset_ - y_scale_ * rz / (rho > 1e-9F ? rho : 1e-9F)
                      : FastAtan2(rho, rz) * y_scale_;
  }

  RadianceSample Sample(const Eigen::Vector3f& ray) const {
    float x = 0.0F;
    float y = 0.0F;
    PixelFromRay(ray.x(), ray.y(), ray.z(), &x, &y);
    return SampleAt(x, y);
  }

  // Bilinear; the nearest pixel alone where some of the four are clipped or masked and others not.
  // Columns wrap round; on a cylinder, outside [0, height] is masked; a lat-long's poles are
  // clamped.
  RadianceSample SampleAt(float x, float y) const {
    RadianceSample out;
    if (is_cylinder_ && !(y >= 0.0F && y <= static_cast<float>(height_))) return out;
    const float fx = x - 0.5F;
    const float fy = y - 0.5F;
    const float floor_x = std::floor(fx);
    const float floor_y = std::floor(fy);
    const float ax = fx - floor_x;
    const float ay = fy - floor_y;
    int x0 = static_cast<int>(floor_x);
    x0 = x0 < 0 ? x0 + width_ : (x0 >= width_ ? x0 - width_ : x0);
    const int x1 = x0 + 1 == width_ ? 0 : x0 + 1;
    const int y_floor = static_cast<int>(floor_y);
    const int y0 = y_floor < 0 ? 0 : (y_floor >= height_ ? height_ - 1 : y_floor);
    const int y1 = y_floor + 1 >= height_ ? height_ - 1 : (y_floor + 1 < 0 ? 0 : y_floor + 1);
    const std::uint8_t* f0 = m_->flags.row(y0);
    const std::uint8_t* f1 = m_->flags.row(y1);
    const auto any = static_cast<std::uint8_t>(f0[x0] | f0[x1] | f1[x0] | f1[x1]);
    const auto all = static_cast<std::uint8_t>(f0[x0] & f0[x1] & f1[x0] & f1[x1]);
    if (((any ^ all) & (kSaturatedAny | kMasked)) != 0) {
      // The rim of a clipped or masked area: a blend would be neither measured nor a bound.
      const int xn = ax < 0.5F ? x0 : x1;
      const int yn = ay < 0.5F ? y0 : y1;
      const float* nearest = m_->radiance.pixel(xn, yn);
      for (std::size_t c = 0; c < 3; ++c) out.rgb[c] = nearest[c];
      out.flags = m_->flags.at(xn, yn);
      return out;
    }
    const float* p00 = m_->radiance.pixel(x0, y0);
    const float* p10 = m_->radiance.pixel(x1, y0);
    const float* p01 = m_->radiance.pixel(x0, y1);
    const float* p11 = m_->radiance.pixel(x1, y1);
    const float w00 = (1.0F - ax) * (1.0F - ay);
    const float w10 = ax * (1.0F - ay);
    const float w01 = (1.0F - ax) * ay;
    const float w11 = ax * ay;
    for (std::size_t c = 0; c < 3; ++c) {
      out.rgb[c] = w00 * p00[c] + w10 * p10[c] + w01 * p01[c] + w11 * p11[c];
    }
    out.flags = any;
    return out;
  }

 private:
  const Measurement* m_;
  int width_ = 0;
  int height_ = 0;
  bool is_cylinder_ = false;
  float x_scale_ = 0.0F;
  float y_scale_ = 0.0F;
  float y_offset_ = 0.0F;
};

}  // namespace omnihdr
