#pragma once

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <random>
#include <utility>
#include <vector>

#include "core/pose/features.h"
#include "core/sphere/pose.h"

namespace omnihdr::test {

// A world of points with a descriptor each, seen without pictures: what a feature finder would make
// of panoramas of it, with noise that is known. The same seed gives the same world.
class FeatureWorld {
 public:
  struct Options {
    double sigma_rad = 3.0e-4;  // of a ray, on each of two axes
    double range = 12.0;        // points further away are not seen
    double found = 0.8;         // share of the visible points that are found
    int max_features = 300;     // the points with the most contrast
    int clutter = 20;           // features that are no point of the world
  };

  FeatureWorld(std::uint32_t seed, const Options& options) : options_(options), random_(seed) {}

  // `count` points in a box, the one with the most contrast first.
  void Fill(const Eigen::Vector3d& low, const Eigen::Vector3d& high, int count) {
    for (int i = 0; i < count; ++i) {
      Eigen::Vector3d x;
      for (Eigen::Index k = 0; k < 3; ++k) x[k] = Uniform(low[k], high[k]);
      Add(x);
    }
  }
  // What is found at a pose; `visit` decides noise and what is missed.
  FeatureSet See(const Pose& pose, std::uint32_t visit) const {
    std::mt19937 random(visit * 7919U + 17U);
    const auto uniform = [&random] { return static_cast<double>(random()) / 4294967296.0; };
    const auto normal = [&uniform] {
      double sum = -6.0;
      for (int k = 0; k < 12; ++k) sum += uniform();
      return sum;
    };
    FeatureSet set;
    const auto add = [&](const Eigen::Vector3d& ray, const Descriptor& descriptor, double change) {
      Feature feature;
      feature.ray = ray;
      feature.sigma_rad = 4.0e-3;
      set.features.push_back(feature);
      for (const double value : descriptor) {
        set.descriptors.push_back(static_cast<std::int16_t>(
            std::clamp(value * (1.0 + change * (2.0 * uniform() - 1.0)), 0.0, 500.0)));
      }
    };
    for (const Point& point : points_) {
      if (set.size() == options_.max_features) break;
      const Eigen::Vector3d x = pose.CameraFromWorld(point.x);
      const double distance = x.norm();
      if (distance > options_.range || distance < 0.5 || uniform() > options_.found) continue;
      const Eigen::Vector3d ray = x / distance;
      const Eigen::Vector3d across = ray.unitOrthogonal();
      const double u = options_.sigma_rad * normal();
      const double v = options_.sigma_rad * normal();
      add((ray + u * across + v * ray.cross(across)).normalized(), point.descriptor, 0.15);
    }
    for (int i = 0; i < options_.clutter; ++i) {
      const double z = 2.0 * uniform() - 1.0;
      const double a = 2.0 * M_PI * uniform();
      const double r = std::sqrt(1.0 - z * z);
      add({r * std::cos(a), r * std::sin(a), z}, DescriptorFrom(random), 0.0);
    }
    return set;
  }

 private:
  using Descriptor = std::vector<double>;
  struct Point {
    Eigen::Vector3d x;
    Descriptor descriptor;
  };

  double Uniform(double low, double high) {
    return low + (high - low) * static_cast<double>(random_()) / 4294967296.0;
  }
  void Add(const Eigen::Vector3d& x) { points_.push_back({x, DescriptorFrom(random_)}); }

  // Not negative, of the length all have, and sparse, as gradient histograms are.
  static Descriptor DescriptorFrom(std::mt19937& random) {
    Descriptor descriptor(kDescriptorLength);
    double square = 0.0;
    for (double& value : descriptor) {
      value = -std::log((static_cast<double>(random()) + 1.0) / 4294967297.0);
      square += value * value;
    }
    for (double& value : descriptor) value *= kDescriptorNorm / std::sqrt(square);
    return descriptor;
  }

  Options options_;
  std::mt19937 random_;
  std::vector<Point> points_;  // those with the most contrast first
};

}  // namespace omnihdr::test
