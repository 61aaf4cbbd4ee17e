#pragma once

#include <array>
#include <cmath>
#include <cstdint>
#include <random>
#include <span>

#include "core/base/parallel_for.h"
#include "core/photometry/measure.h"
#include "core/sphere/pose.h"

namespace omnihdr::test {

// A box-shaped room with textured walls, floor and ceiling: enough of a world to track poses in.
// Diffuse, so every surface point looks the same from everywhere.
class Room {
 public:
  explicit Room(std::uint32_t seed) : seed_(seed) {}

  // Radiance met by a ray; about 0.2 to 5, with a lamp field ten times brighter on the ceiling.
  float Radiance(const Eigen::Vector3d& from, const Eigen::Vector3d& ray) const {
    static constexpr std::array<double, 3> kHalf{4.0, 3.0, 1.6};
    double nearest = 1e9;
    int wall = 0;
    for (int axis = 0; axis < 3; ++axis) {
      if (std::fabs(ray[axis]) < 1e-9) continue;
      const double side = ray[axis] > 0.0 ? kHalf[static_cast<std::size_t>(axis)]
                                          : -kHalf[static_cast<std::size_t>(axis)];
      const double distance = (side - from[axis]) / ray[axis];
      if (distance < nearest) {
        nearest = distance;
        wall = 2 * axis + (side > 0.0 ? 1 : 0);
      }
    }
    const Eigen::Vector3d hit = from + nearest * ray;
    const double u = wall < 2 ? hit.y() : hit.x();
    const double v = wall < 4 ? hit.z() : hit.y();
    double texture = 0.0;
    double amplitude = 1.0;
    for (double cell = 0.8; cell > 0.08; cell *= 0.5, amplitude *= 0.75) {
      texture += amplitude * Noise(u / cell, v / cell, wall);
    }
    double radiance = std::exp(1.1 * texture);
    if (wall == 5 && std::fabs(u - 1.0) < 0.4 && std::fabs(v) < 0.8) radiance *= 10.0;
    return static_cast<float>(radiance);
  }

  Image<float> Render(const Pose& world_from_camera, const Projection& projection) const {
    Image<float> radiance(projection.width(), projection.height());
    ParallelFor(projection.height(), 8, [&](int begin, int end) {
      for (int y = begin; y < end; ++y) {
        for (int x = 0; x < projection.width(); ++x) {
          float sum = 0.0F;
          for (int sample = 0; sample < 4; ++sample) {
            const Eigen::Vector3d ray = projection.RayFromPixel(x + 0.25 + 0.5 * (sample % 2),
                                                                y + 0.25 + 0.5 * (sample / 2));
            sum += Radiance(world_from_camera.translation, world_from_camera.rotation * ray);
          }
          radiance.row(y)[x] = 0.25F * sum;
        }
      }
    });
    return radiance;
  }

 private:
  // Value noise in [-1, 1]: random lattice, smooth between.
  double Noise(double u, double v, int wall) const {
    const double iu = std::floor(u);
    const double iv = std::floor(v);
    const double fu = (u - iu) * (u - iu) * (3.0 - 2.0 * (u - iu));
    const double fv = (v - iv) * (v - iv) * (3.0 - 2.0 * (v - iv));
    const auto at = [&](int du, int dv) {
      std::uint32_t h = seed_ * 0x9e3779b9U + static_cast<std::uint32_t>(wall) * 0x85ebca6bU;
      h ^= static_cast<std::uint32_t>(static_cast<std::int32_t>(iu) + du) * 0xc2b2ae35U;
      h = (h ^ (h >> 15)) * 0x2c1b3c6dU;
      h ^= static_cast<std::uint32_t>(static_cast<std::int32_t>(iv) + dv) * 0x297a2d39U;
      h = (h ^ (h >> 12)) * 0x2c1b3c6dU;
      h = (h ^ (h >> 15)) * 0x297a2d39U;
      return static_cast<double>(h ^ (h >> 16)) / 2147483648.0 - 1.0;
    };
    const double top = at(0, 0) + fu * (at(1, 0) - at(0, 0));
    const double bottom = at(0, 1) + fu * (at(1, 1) - at(0, 1));
    return top + fv * (bottom - top);
  }

  std::uint32_t seed_;
};

// The radiance picture as an 8-bit linear sensor with noise measures it in `exposure_s`.
inline Measurement Expose(const Image<float>& radiance, const Projection& projection,
                          double exposure_s, std::uint32_t seed,
                          ImageView<const std::uint8_t> mask = {}) {
  std::mt19937 random(seed);
  Image<std::uint8_t> picture(radiance.width(), radiance.height(), 3);
  for (int y = 0; y < radiance.height(); ++y) {
    for (int x = 0; x < radiance.width(); ++x) {
      for (int c = 0; c < 3; ++c) {
        const double value = 128.0 * static_cast<double>(radiance.row(y)[x]) * exposure_s;
        // Sum of three uniform numbers, of variance 1: much like a normal one, the same with every
        // library.
        double noise = -3.0;
        for (int k = 0; k < 3; ++k) noise += static_cast<double>(random()) / 2147483648.0;
        picture.pixel(x, y)[c] = static_cast<std::uint8_t>(
            std::clamp(value + noise * std::sqrt(0.25 + 0.02 * value) + 0.5, 0.0, 255.0));
      }
    }
  }
  const DecodedImage image{std::move(picture)};
  const ExposedFrame frame{&image, Exposure{ExposureTime::Seconds(exposure_s), GainDb{0.0}}};
  return *Measure(std::span(&frame, 1), projection, *Response::Linear(), 8, mask, MeasureOptions{});
}

}  // namespace omnihdr::test
