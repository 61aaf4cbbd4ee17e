#include "tests/support/chart_scene.h"

#include <algorithm>
#include <cmath>
#include <random>
#include <vector>

namespace omnihdr {
namespace {

using Rgb = std::array<double, 3>;

struct Box {
  double x0, y0, x1, y1;
  Rgb light;
};

class Renderer {
 public:
  explicit Renderer(const ChartScene& scene) : scene_(scene), random_(scene.seed) {
    std::uniform_real_distribution<double> unit(0.0, 1.0);
    for (int i = 0; i < 60 && scene.clutter; ++i) {
      const double x = 2.4 * unit(random_) - 1.2;
      const double y = 2.0 * unit(random_) - 1.0;
      const double w = 0.03 + 0.15 * unit(random_);
      const double h = 0.03 + 0.15 * unit(random_);
      boxes_.push_back({x, y, x + w, y + h, {unit(random_), unit(random_), unit(random_)}});
    }
  }

  Eigen::Vector2d PixelFromChart(const Eigen::Vector2d& at) const {
    const Eigen::Vector3d p = scene_.camera_from_chart.WorldFromCamera({at.x(), at.y(), 0.0});
    const double rho = p.head<2>().norm();
    const double r =
        scene_.fisheye ? scene_.focal * std::atan2(rho, p.z()) : scene_.focal * rho / p.z();
    const Eigen::Vector2d d =
        rho > 0.0 ? Eigen::Vector2d(p.head<2>() * (r / rho)) : Eigen::Vector2d::Zero();
    const double x = 0.5 * scene_.width + d.x();
    return {scene_.mirrored ? scene_.width - x : x, 0.5 * scene_.height + d.y()};
  }

  Rgb LightAt(double px, double py) const {
    const double x = (scene_.mirrored ? scene_.width - px : px) - 0.5 * scene_.width;
    const double y = py - 0.5 * scene_.height;
    const double r = std::hypot(x, y);
    const double theta = scene_.fisheye ? r / scene_.focal : std::atan(r / scene_.focal);
    const double s = r > 0.0 ? std::sin(theta) / r : 0.0;
    const Eigen::Vector3d ray(s * x, s * y, std::cos(theta));
    const Pose chart_from_camera = scene_.camera_from_chart.Inverse();
    const Eigen::Vector3d from = chart_from_camera.translation;
    const Eigen::Vector3d along = chart_from_camera.rotation * ray;
    Rgb light = {0.05, 0.05, 0.05};
    // The chart's plane carries the boxes; the wall is half a metre behind it.
    const double t = -from.z() / along.z();
    const double t_wall = (0.5 - from.z()) / along.z();
    if (t > 0.0)
      light = OnPlane(from.x() + t * along.x(), from.y() + t * along.y(),
                      from.x() + t_wall * along.x(), from.y() + t_wall * along.y());
    const double fade = 1.0 - scene_.shading * (px / scene_.width);
    const double rho = r / (0.5 * std::hypot(scene_.width, scene_.height));
    const double lens = Vignetting{scene_.falloff}.At(rho);
    const double mean = (light[0] + light[1] + light[2]) / 3.0;
    for (std::size_t c = 0; c < 3; ++c) {
      light[c] = (light[c] * (1.0 - scene_.crosstalk) + mean * scene_.crosstalk) * fade * lens *
                 scene_.gain[c] * scene_.exposure;
    }
    return light;
  }

 private:
  Rgb OnPlane(double x, double y, double wall_x, double wall_y) const {
    const double u = x / scene_.patch_step + 0.5 * kChartColumns;
    const double v = y / scene_.patch_step + 0.5 * kChartRows;
    if (scene_.chart && u > -0.3 && v > -0.3 && u < kChartColumns + 0.3 && v < kChartRows + 0.3) {
      const double fu = std::abs(u - std::floor(u) - 0.5);
      const double fv = std::abs(v - std::floor(v) - 0.5);
      const bool on_patch = u > 0.0 && v > 0.0 && u < kChartColumns && v < kChartRows &&
                            std::max(fu, fv) < 0.5 * scene_.patch_share;
      if (!on_patch) return {0.035, 0.034, 0.033};
      return ChartLinearLight(static_cast<int>(v) * kChartColumns + static_cast<int>(u));
    }
    for (const Box& box : boxes_) {
      if (x > box.x0 && x < box.x1 && y > box.y0 && y < box.y1) return box.light;
    }
    if (!scene_.clutter) return {0.3, 0.32, 0.34};
    // Bricks of 20 × 7 cm in mortar, each of its own shade.
    const double row = std::floor(wall_y / 0.07);
    const double shift = std::fmod(std::abs(row), 2.0) * 0.1;
    const double column = std::floor((wall_x + shift) / 0.2);
    const double in_x = wall_x + shift - column * 0.2;
    const double in_y = wall_y - row * 0.07;
    if (in_x < 0.012 || in_y < 0.012) return {0.45, 0.43, 0.40};
    const double shade = 0.75 + 0.25 * std::sin(12.9898 * row + 78.233 * column);
    return {0.32 * shade, 0.13 * shade, 0.09 * shade};
  }

  ChartScene scene_;
  std::mt19937 random_;
  std::vector<Box> boxes_;
};

double Encoded(const ChartScene& scene, double light) {
  if (!scene.srgb) return 255.0 * light;
  const double v = std::max(light, 0.0);
  return 255.0 * (v <= 0.0031308 ? 12.92 * v : 1.055 * std::pow(v, 1.0 / 2.4) - 0.055);
}

template <typename T>
Image<T> Develop(const ChartScene& scene, const Renderer& renderer) {
  std::mt19937 random(scene.seed + 7919);
  std::normal_distribution<double> normal(0.0, 1.0);
  const double scale = scene.bits > 8 ? ((1 << scene.bits) - 1) / 255.0 : 1.0;
  const double largest = 255.0 * scale;
  Image<T> image(scene.width, scene.height, scene.bayer == BayerOrder::kNone ? 3 : 1);
  for (int y = 0; y < scene.height; ++y) {
    for (int x = 0; x < scene.width; ++x) {
      Rgb sum{};
      for (const auto& [dx, dy] :
           {std::pair{0.25, 0.25}, {0.75, 0.25}, {0.25, 0.75}, {0.75, 0.75}}) {
        const Rgb light = renderer.LightAt(x + dx, y + dy);
        for (std::size_t c = 0; c < 3; ++c) sum[c] += 0.25 * light[c];
      }
      for (int c = 0; c < image.channels(); ++c) {
        const int channel = image.channels() == 3 ? c : BayerChannel(scene.bayer, x, y);
        const double light = sum[static_cast<std::size_t>(channel)];
        const double sigma = scene.noise * (0.2 + std::sqrt(std::max(light, 0.0)));
        const double value = Encoded(scene, light) + sigma * normal(random);
        image.at(x, y, c) = static_cast<T>(std::lround(std::clamp(scale * value, 0.0, largest)));
      }
    }
  }
  return image;
}

}  // namespace

RenderedChart RenderChart(const ChartScene& scene) {
  const Renderer renderer(scene);
  RenderedChart out;
  for (int patch = 0; patch < kChartPatches; ++patch) {
    const double u = (patch % kChartColumns + 0.5 - 0.5 * kChartColumns) * scene.patch_step;
    const double v = (patch / kChartColumns + 0.5 - 0.5 * kChartRows) * scene.patch_step;
    out.centres[static_cast<std::size_t>(patch)] = renderer.PixelFromChart({u, v});
    const double half = 0.5 * scene.patch_share * scene.patch_step;
    const double side =
        (renderer.PixelFromChart({u + half, v}) - renderer.PixelFromChart({u - half, v})).norm() +
        (renderer.PixelFromChart({u, v + half}) - renderer.PixelFromChart({u, v - half})).norm();
    out.patch_side += 0.5 * side / kChartPatches;
  }
  if (scene.bits > 8) {
    out.image.pixels = Develop<std::uint16_t>(scene, renderer);
  } else {
    out.image.pixels = Develop<std::uint8_t>(scene, renderer);
  }
  return out;
}

}  // namespace omnihdr
