#pragma once

#include <benchmark/benchmark.h>

#include <cmath>
#include <cstdint>
#include <random>

#include "core/image/image.h"

// Registers `function` as `name`, "Subject/omnihdr" or "Subject/peer": scripts/bench pairs them by
// the subject. Times are of the whole process (all threads) and by the clock on the wall.
#define OMNIHDR_BENCHMARK(function, name) \
  BENCHMARK(function)                     \
      ->Name(name)                        \
      ->Unit(benchmark::kMillisecond)     \
      ->MeasureProcessCPUTime()           \
      ->UseRealTime()

namespace omnihdr {

// The size all picture benchmarks use: 1.77 million pixels.
inline constexpr int kBenchWidth = 1536;
inline constexpr int kBenchHeight = 1152;

// A scene of five decades of radiance, W×H×3: smooth shading, edges, lamps, and noise of the
// strength a merge leaves. The same pixels for the same arguments.
inline Image<float> BenchScene(int width = kBenchWidth, int height = kBenchHeight,
                               std::uint32_t seed = 1) {
  std::mt19937 generator(seed);
  std::normal_distribution<float> noise(1.0F, 0.02F);
  Image<float> scene(width, height, 3);
  for (int y = 0; y < height; ++y) {
    const float v = static_cast<float>(y) / static_cast<float>(height);
    for (int x = 0; x < width; ++x) {
      const float u = static_cast<float>(x) / static_cast<float>(width);
      float level = 0.02F * std::pow(10.0F, 2.0F * std::sin(6.2831853F * u) * (1.0F - v));
      if ((x / 96 + y / 96) % 2 == 0) level *= 3.0F;
      const float dx = std::fmod(u * 4.0F, 1.0F) - 0.5F;
      const float dy = std::fmod(v * 3.0F, 1.0F) - 0.5F;
      if (dx * dx + dy * dy < 0.003F) level = 200.0F;
      float* pixel = scene.pixel(x, y);
      pixel[0] = level * noise(generator) * (0.8F + 0.4F * u);
      pixel[1] = level * noise(generator);
      pixel[2] = level * noise(generator) * (1.2F - 0.4F * v);
    }
  }
  return scene;
}

}  // namespace omnihdr
