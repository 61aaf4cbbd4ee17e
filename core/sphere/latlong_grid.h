#pragma once

#include <Eigen/Core>
#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "core/sphere/fast_angle.h"

namespace omnihdr {

// Directions of an equirectangular grid's pixel centres, from tables, and the fast way back. The
// same mapping as Projection::Equirectangular, in float. Thread-safe to read.
class LatLongGrid {
 public:
  LatLongGrid(int width, int height)
      : width_(width),
        height_(height),
        x_scale_(static_cast<float>(width / (2.0 * std::numbers::pi))),
        y_scale_(static_cast<float>(height / std::numbers::pi)) {
    for (int x = 0; x < width; ++x) {
      const double theta = std::numbers::pi - 2.0 * std::numbers::pi * (x + 0.5) / width;
      columns_.push_back(
          {static_cast<float>(std::cos(theta)), static_cast<float>(std::sin(theta))});
    }
    for (int y = 0; y < height; ++y) {
      const double phi = std::numbers::pi * (y + 0.5) / height;
      rows_.push_back({static_cast<float>(std::sin(phi)), static_cast<float>(std::cos(phi))});
    }
  }

  // Unit ray through the centre of pixel (x, y).
  Eigen::Vector3f Ray(int x, int y) const {
    const auto& [cos_theta, sin_theta] = columns_[static_cast<std::size_t>(x)];
    const auto& [sin_phi, cos_phi] = rows_[static_cast<std::size_t>(y)];
    return {sin_phi * cos_theta, sin_phi * sin_theta, cos_phi};
  }
  // Image point of a direction of any length: x in [0, W], y in [0, H].
  void Point(const Eigen::Vector3f& v, float* x, float* y) const {
    const float rho = std::sqrt(v.x() * v.x() + v.y() * v.y());
    *x = (std::numbers::pi_v<float> - FastAtan2(v.y(), v.x())) * x_scale_;
    *y = FastAtan2(rho, v.z()) * y_scale_;
  }
  // Pixel that contains the direction.
  void Pixel(const Eigen::Vector3f& v, int* x, int* y) const {
    float px = 0.0F;
    float py = 0.0F;
    Point(v, &px, &py);
    *x = std::clamp(static_cast<int>(px), 0, width_ - 1);
    *y = std::clamp(static_cast<int>(py), 0, height_ - 1);
  }
  int width() const { return width_; }
  int height() const { return height_; }
  // For whole rows of rays: cosine and sine of the azimuth of every column's centre; sine and
  // cosine of a row's angle from the zenith.
  const std::array<float, 2>* columns() const { return columns_.data(); }
  const std::array<float, 2>& row(int y) const { return rows_[static_cast<std::size_t>(y)]; }
  float x_scale() const { return x_scale_; }  // columns a radian
  float y_scale() const { return y_scale_; }  // rows a radian

 private:
  int width_;
  int height_;
  float x_scale_;
  float y_scale_;
  std::vector<std::array<float, 2>> columns_;
  std::vector<std::array<float, 2>> rows_;
};

}  // namespace omnihdr
