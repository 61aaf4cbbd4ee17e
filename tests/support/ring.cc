#include "tests/support/ring.h"

#include <Eigen/Geometry>
#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <random>
#include <string>

namespace omnihdr::testing {

Rig MakeRing(const RingOptions& options) {
  Rig rig;
  rig.model = "ring";
  rig.sphere_radius_m = options.sphere_radius_m;
  rig.blend_width_deg = options.blend_width_deg;
  constexpr double kDegree = std::numbers::pi / 180.0;
  for (int s = 0; s < 6; ++s) {
    RigSensor sensor;
    sensor.name = "sensor" + std::to_string(s);
    // The short side sees about 92 degrees.
    const double focal = options.height / (92.0 * kDegree);
    sensor.lens = Lens::Fisheye(options.width, options.height, {focal, focal},
                                {0.5 * options.width + 1.3, 0.5 * options.height - 0.7},
                                {-0.02, 0.003, 0.0, 0.0, 0.0}, 65.0 * kDegree)
                      .value();
    // Lens Z along the camera's X, columns down (the sensor lies on its side), rows to the left.
    Eigen::Matrix3d camera_from_lens;
    camera_from_lens.col(0) = -Eigen::Vector3d::UnitZ();
    camera_from_lens.col(1) = Eigen::Vector3d::UnitY();
    camera_from_lens.col(2) = Eigen::Vector3d::UnitX();
    const Eigen::Quaterniond turn(
        s < 5 ? Eigen::AngleAxisd(-72.0 * kDegree * s, Eigen::Vector3d::UnitZ())
              : Eigen::AngleAxisd(-90.0 * kDegree, Eigen::Vector3d::UnitY()));
    sensor.camera_from_sensor.rotation = (turn * Eigen::Quaterniond(camera_from_lens)).normalized();
    sensor.camera_from_sensor.translation = turn * Eigen::Vector3d(options.offset_m, 0.0, 0.0);
    sensor.bayer = options.bayer;
    sensor.vignetting = options.vignetting;
    if (!options.equal_gains) {
      sensor.gain = {1.5 + 0.05 * s, 1.0 - 0.03 * s, 1.8 - 0.06 * s};
    }
    rig.sensors.push_back(sensor);
  }
  return rig;
}

DecodedImage ShootRing(const Rig& rig, const RadianceAt& scene, double distance, double seconds,
                       int bits, double noise_rms, std::uint64_t seed) {
  const auto along = [&](const Eigen::Vector3d& from, const Eigen::Vector3d& ray) {
    // |from + t·ray| = distance.
    const double b = ray.dot(from);
    const double t = -b + std::sqrt(b * b - from.squaredNorm() + distance * distance);
    return scene(from + t * ray);
  };
  return ShootRig(rig, along, seconds, bits, noise_rms, seed);
}

DecodedImage ShootRig(const Rig& rig, const RadianceAlong& scene, double seconds, int bits,
                      double noise_rms, std::uint64_t seed) {
  const std::vector<int> rows = StackedRows(rig).value();
  const int width = rig.sensors.front().lens.width();
  const bool colour = rig.sensors.front().bayer == BayerOrder::kNone;
  const int channels = colour ? 3 : 1;
  Image<std::uint8_t> bytes(bits == 8 ? width : 0, bits == 8 ? rows.back() : 0, channels);
  Image<std::uint16_t> words(bits == 8 ? 0 : width, bits == 8 ? 0 : rows.back(), channels);
  std::mt19937_64 random(seed);
  std::normal_distribution<double> normal(0.0, 1.0);
  const double largest = std::pow(2.0, bits) - 1.0;
  for (std::size_t s = 0; s < rig.sensors.size(); ++s) {
    const RigSensor& sensor = rig.sensors[s];
    const Pose& pose = sensor.camera_from_sensor;
    const double half_diagonal = 0.5 * std::hypot(width, sensor.lens.height());
    for (int y = 0; y < sensor.lens.height(); ++y) {
      for (int x = 0; x < width; ++x) {
        Eigen::Vector3d radiance = Eigen::Vector3d::Zero();
        const Eigen::Vector2d pixel(x + 0.5, y + 0.5);
        if (const auto ray = sensor.lens.RayFromPixel(pixel.x(), pixel.y())) {
          radiance = scene(pose.translation, pose.rotation * *ray);
        }
        const double v =
            sensor.vignetting.At((pixel - sensor.lens.centre()).norm() / half_diagonal);
        for (int k = 0; k < channels; ++k) {
          const int c = colour ? k : BayerChannel(sensor.bayer, x, y);
          const double value =
              radiance[c] * v / sensor.gain[static_cast<std::size_t>(c)] * 128.0 * seconds +
              (noise_rms > 0.0 ? noise_rms * normal(random) : 0.0);
          const double code = std::clamp(std::round(value * largest / 255.0), 0.0, largest);
          if (bits == 8) {
            bytes.at(x, rows[s] + y, k) = static_cast<std::uint8_t>(code);
          } else {
            words.at(x, rows[s] + y, k) = static_cast<std::uint16_t>(code);
          }
        }
      }
    }
  }
  if (bits == 8) return DecodedImage{std::move(bytes)};
  return DecodedImage{std::move(words)};
}

}  // namespace omnihdr::testing
