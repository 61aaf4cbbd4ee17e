#include "drivers/sim/scene_builder.h"

namespace omnihdr::sim {
namespace {

constexpr float kPi = std::numbers::pi_v<float>;

}  // namespace

Path Oval(double length, double squash) {
  const auto curvature = [=](double s) {
    return 2 * std::numbers::pi / length *
           (1.0 - squash * std::cos(4 * std::numbers::pi * s / length));
  };
  // Half-turn symmetry: the centre is half-way between a point and the one half the length on.
  const Path trial({0, 0, 0}, length, true, curvature);
  const Path::Point opposite = trial.At(length / 2);
  return {{-opposite.x / 2, -opposite.y / 2, 0.0}, length, true, curvature};
}

Path Weave(double start_x, double start_y, double length, double amplitude, double wave) {
  const double k = 2 * std::numbers::pi / wave;
  const auto curvature = [=](double s) { return -amplitude * k * k * std::sin(k * s); };
  return {{start_x, start_y, std::atan(amplitude * k)}, length, false, curvature};
}

Vec3 Direction(float azimuth_deg, float elevation_deg) {
  const float a = azimuth_deg * kPi / 180.0F;
  const float e = elevation_deg * kPi / 180.0F;
  return {std::cos(e) * std::cos(a), std::cos(e) * std::sin(a), std::sin(e)};
}

OutdoorMaterials AddOutdoorMaterials(Builder& b) {
  return {b.Mat(Pattern::kGrass, {0.10F, 0.20F, 0.04F}, {0.22F, 0.24F, 0.09F}),
          b.Mat(Pattern::kBark, {0.16F, 0.11F, 0.07F}),
          b.Mat(Pattern::kFoliage, {0.05F, 0.14F, 0.025F}, {0.20F, 0.32F, 0.07F}),
          b.Mat(Pattern::kFoliage, {0.025F, 0.08F, 0.02F}, {0.12F, 0.20F, 0.05F})};
}

void House(Builder& b, float x, float y, Vec3 size, float yaw, int wall, int roof, int glass,
           int frame) {
  b.Standing(x, y, 0.0F, size, wall, yaw).texel = 0.3F;
  const float c = std::cos(yaw);
  const float s = std::sin(yaw);
  const auto at = [&](float lx, float ly, float z) {
    return Vec3{x + c * lx - s * ly, y + s * lx + c * ly, z};
  };
  // Two slanted slabs.
  const float pitch = 0.62F;
  const float run = size.y * 0.5F + 0.5F;
  const float slope = run / std::cos(pitch);
  for (const float side : {-1.0F, 1.0F}) {
    Primitive& slab = b.Add(
        Shape::kBox, at(0.0F, side * run * 0.5F, size.z + run * 0.5F * std::tan(pitch) - 0.25F),
        {size.x * 0.5F + 0.4F, slope * 0.5F, 0.09F}, roof, yaw);
    const Vec3 across = slab.axis_y;
    slab.axis_y = across * std::cos(pitch) - Vec3{0, 0, side * std::sin(pitch)};
    slab.axis_z = Cross(slab.axis_x, slab.axis_y);
    slab.texel = 0.3F;
  }
  const int columns = std::max(1, static_cast<int>(size.x / 2.4F));
  const int floors = std::max(1, static_cast<int>(size.z / 2.7F));
  for (int side = 0; side < 2; ++side) {
    const float ly = (side == 0 ? -1.0F : 1.0F) * (size.y * 0.5F + 0.02F);
    for (int floor = 0; floor < floors; ++floor) {
      for (int column = 0; column < columns; ++column) {
        const float lx =
            size.x * ((static_cast<float>(column) + 0.5F) / static_cast<float>(columns) - 0.5F);
        const float z = 1.7F + 2.7F * static_cast<float>(floor);
        b.Add(Shape::kBox, at(lx, ly, z), {0.55F, 0.03F, 0.72F}, frame, yaw);
        b.Add(Shape::kBox, at(lx, ly * 1.004F, z), {0.46F, 0.03F, 0.62F}, glass, yaw);
      }
    }
  }
}

void Garage(Builder& b, float gx, float gy, int black, int planks) {
  b.Block({gx - 2.4F, gy - 5.4F, 0}, {gx + 2.4F, gy - 5.2F, 2.7F}, black);
  b.Block({gx - 2.4F, gy - 5.4F, 0}, {gx - 2.2F, gy, 2.7F}, black);
  b.Block({gx + 2.2F, gy - 5.4F, 0}, {gx + 2.4F, gy, 2.7F}, black);
  b.Block({gx - 2.8F, gy - 5.8F, 2.6F}, {gx + 2.8F, gy + 0.5F, 2.8F}, black);
  b.Block({gx - 2.2F, gy - 5.2F, -0.1F}, {gx + 2.2F, gy, 0.015F}, black);
  b.Block({gx - 2.65F, gy - 5.6F, 0}, {gx - 2.4F, gy + 0.1F, 2.7F}, planks);
  b.Block({gx + 2.4F, gy - 5.6F, 0}, {gx + 2.65F, gy + 0.1F, 2.7F}, planks);
  b.Block({gx - 2.4F, gy - 0.15F, 2.2F}, {gx + 2.4F, gy + 0.05F, 2.6F}, planks);
  b.Standing(gx - 1.2F, gy - 4.4F, 0.0F, {1.2F, 0.7F, 1.1F}, black);
}

void ScaleLight(Scene& scene, float factor) {
  Sky& sky = scene.sky;
  for (Vec3* light :
       {&sky.zenith, &sky.horizon, &sky.below, &sky.cloud, &sky.sun_irradiance, &sky.glow}) {
    *light = *light * factor;
  }
  for (Primitive& p : scene.primitives) p.emission = p.emission * factor;
  for (AreaLight& light : scene.lights) light.radiance = light.radiance * factor;
}

}  // namespace omnihdr::sim
