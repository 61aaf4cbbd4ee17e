#include "drivers/sim/material.h"

#include <algorithm>
#include <cmath>

namespace omnihdr::sim {
namespace {

inline std::uint32_t Hash(std::int32_t x, std::int32_t y, std::uint32_t seed) {
  std::uint32_t h = static_cast<std::uint32_t>(x) * 0x8da6b343U ^
                    static_cast<std::uint32_t>(y) * 0xd8163841U ^ seed * 0xcb1ab31fU;
  h ^= h >> 15U;
  h *= 0x2c1b3c6dU;
  h ^= h >> 12U;
  h *= 0x297a2d39U;
  h ^= h >> 15U;
  return h;
}
inline float HashUnit(std::int32_t x, std::int32_t y, std::uint32_t seed) {
  return static_cast<float>(Hash(x, y, seed) >> 8U) * 0x1p-24F;
}
inline float Signed(std::uint32_t h) { return static_cast<float>(h >> 8U) * 0x1p-23F - 1.0F; }
inline std::int32_t Floor(float v) {
  const auto i = static_cast<std::int32_t>(v);
  return i - (static_cast<float>(i) > v ? 1 : 0);
}
inline float Fade(float t) { return t * t * (3.0F - 2.0F * t); }
inline float Mix(float a, float b, float t) { return a + (b - a) * t; }
inline float Clamp01(float v) { return std::min(1.0F, std::max(0.0F, v)); }
inline float SmoothStep(float a, float b, float v) { return Fade(Clamp01((v - a) / (b - a))); }

// How much of a detail of size `period` survives averaging over the pixel's footprint.
inline float Visible(float period, float footprint) {
  return Clamp01(1.6F - 1.8F * footprint / period);
}

// Octaves of noise from `period` down to period/2^octaves, each `gain` times weaker.
float Fbm(const SurfacePoint& at, float period, int octaves, float gain, std::uint32_t salt) {
  float sum = 0.0F;
  float amplitude = 1.0F;
  for (int octave = 0; octave < octaves; ++octave) {
    const float visible = Visible(period, at.footprint);
    if (visible <= 0.0F) break;
    const float f = 1.0F / period;
    const std::uint32_t seed = at.seed * 31U + salt + static_cast<std::uint32_t>(octave) * 977U;
    const float n = at.solid ? ValueNoise(at.local.x * f, at.local.y * f, at.local.z * f, seed)
                             : ValueNoise(at.u * f, at.v * f, seed);
    sum += amplitude * visible * n;
    amplitude *= gain;
    period *= 0.49F;
  }
  return sum;
}

// Noise stretched along v.
float Streaks(const SurfacePoint& at, float period, float stretch, int octaves,
              std::uint32_t salt) {
  SurfacePoint squeezed = at;
  squeezed.v = at.v / stretch;
  return Fbm(squeezed, period, octaves, 0.65F, salt);
}

struct Cell {
  std::int32_t column = 0;
  std::int32_t row = 0;
  float inside = 1.0F;  // 0 in the joint, 1 on the brick, blurred by the footprint
};

Cell BrickCell(const SurfacePoint& at, float width, float height, float joint, bool running_bond) {
  Cell cell;
  const float y = at.v / height;
  cell.row = Floor(y);
  const float x = at.u / width + (running_bond && (cell.row & 1) != 0 ? 0.5F : 0.0F);
  cell.column = Floor(x);
  const float dx =
      std::min(x - static_cast<float>(cell.column), static_cast<float>(cell.column) + 1.0F - x) *
      width;
  const float dy =
      std::min(y - static_cast<float>(cell.row), static_cast<float>(cell.row) + 1.0F - y) * height;
  const float blur = std::max(0.25F * joint, 0.5F * at.footprint);
  const float sharp = SmoothStep(joint - blur, joint + blur, std::min(dx, dy));
  // Far away the joints average out to their share of the area.
  const float mean = (1.0F - 2.0F * joint / width) * (1.0F - 2.0F * joint / height);
  cell.inside = Mix(mean, sharp, Visible(2.0F * height, at.footprint));
  return cell;
}

Vec3 Shade(Vec3 colour, float factor) { return colour * std::max(0.05F, factor); }

}  // namespace

float ValueNoise(float x, float y, std::uint32_t seed) {
  const std::int32_t ix = Floor(x);
  const std::int32_t iy = Floor(y);
  const float fx = Fade(x - static_cast<float>(ix));
  const float fy = Fade(y - static_cast<float>(iy));
  const float top = Mix(Signed(Hash(ix, iy, seed)), Signed(Hash(ix + 1, iy, seed)), fx);
  const float bottom = Mix(Signed(Hash(ix, iy + 1, seed)), Signed(Hash(ix + 1, iy + 1, seed)), fx);
  return Mix(top, bottom, fy);
}

float ValueNoise(float x, float y, float z, std::uint32_t seed) {
  const std::int32_t iz = Floor(z);
  const float fz = Fade(z - static_cast<float>(iz));
  const std::uint32_t low = seed + static_cast<std::uint32_t>(iz) * 0x9e3779b9U;
  return Mix(ValueNoise(x, y, low), ValueNoise(x, y, low + 0x9e3779b9U), fz);
}

Vec3 MeanAlbedo(const Material& m) {
  switch (m.pattern) {
    case Pattern::kBrick:
      return Lerp(m.colour, m.second, 0.2F);
    case Pattern::kTiles:
      return Lerp(m.colour, m.second, 0.08F);
    case Pattern::kCarpet:
    case Pattern::kFoliage:
    case Pattern::kGrass:
    case Pattern::kBooks:
    case Pattern::kPicture:
      return Lerp(m.colour, m.second, 0.4F);
    default:
      return m.colour;
  }
}

Vec3 Albedo(const Material& m, const SurfacePoint& at) {
  Vec3 c = m.colour;
  const float k = m.contrast;
  switch (m.pattern) {
    case Pattern::kPlain:
      c = Shade(c, 1.0F + 0.02F * k * Fbm(at, 1.1F, 2, 0.5F, 1));
      break;
    case Pattern::kPlaster:
      c = Shade(
          c, 1.0F + k * (0.05F * Fbm(at, 0.9F, 3, 0.6F, 1) + 0.05F * Fbm(at, 0.05F, 3, 0.7F, 2)));
      break;
    case Pattern::kBrick: {
      const Cell cell = BrickCell(at, m.size, m.size * 0.32F, m.size * 0.028F, true);
      const float tone = HashUnit(cell.column, cell.row, at.seed + 7U) - 0.5F;
      const float visible = Visible(m.size, at.footprint);
      const Vec3 brick =
          Shade(c, 1.0F + k * (0.6F * tone * visible + 0.16F * Fbm(at, 0.06F, 3, 0.7F, 3)));
      c = Lerp(Shade(m.second, 1.0F + 0.15F * k * Fbm(at, 0.03F, 2, 0.6F, 4)), brick, cell.inside);
      c = Shade(c, 1.0F + 0.18F * k * Fbm(at, 1.7F, 3, 0.55F, 5));
      break;
    }
    case Pattern::kPlanks: {
      const Cell cell = BrickCell(at, m.size * 9.0F, m.size, 0.003F, true);
      const float tone = HashUnit(cell.column, cell.row, at.seed + 11U) - 0.5F;
      SurfacePoint along = at;
      along.u = at.v + static_cast<float>(cell.row) * 3.7F;
      along.v = at.u + static_cast<float>(cell.column) * 5.3F;
      const float grain = Streaks(along, 0.05F, 9.0F, 4, 13U);
      c = Shade(c, 1.0F + k * (0.45F * tone * Visible(m.size, at.footprint) + 0.2F * grain));
      c = Lerp(m.second, c, cell.inside);
      break;
    }
    case Pattern::kTiles: {
      const Cell cell = BrickCell(at, m.size, m.size, 0.004F, false);
      const float tone = HashUnit(cell.column, cell.row, at.seed + 17U) - 0.5F;
      c = Shade(c, 1.0F + k * (0.35F * tone * Visible(m.size, at.footprint) +
                               0.22F * Fbm(at, 0.31F, 5, 0.6F, 19U)));
      c = Lerp(m.second, c, cell.inside);
      break;
    }
    case Pattern::kCarpet: {
      const float visible = Visible(m.size * 0.5F, at.footprint);
      const float a = std::sin(6.2832F * at.u / m.size) * std::sin(6.2832F * at.v / m.size);
      const float b = std::cos(6.2832F * (at.u + at.v) / (2.7F * m.size));
      const float mix = 0.5F + 0.5F * visible * std::clamp(1.6F * (a + 0.6F * b), -1.0F, 1.0F);
      c = Lerp(c, m.second, Clamp01(mix));
      c = Shade(c, 1.0F + k * (0.30F * Fbm(at, 0.03F, 3, 0.8F, 23U) +
                               0.15F * Fbm(at, 0.6F, 2, 0.6F, 24U)));
      break;
    }
    case Pattern::kGrass: {
      const float patch = Fbm(at, 2.3F, 3, 0.6F, 29U);
      const float blades = Fbm(at, 0.25F, 6, 0.85F, 31U);
      c = Lerp(c, m.second, Clamp01(0.4F + 0.4F * patch));
      c = Shade(c, 1.0F + 0.38F * k * blades);
      break;
    }
    case Pattern::kFoliage: {
      const float leaves = Fbm(at, 0.30F, 4, 0.85F, 37U);
      c = Lerp(c, m.second, Clamp01(0.45F + 0.45F * leaves));
      c = Shade(c, 1.0F + 0.5F * k * leaves);
      break;
    }
    case Pattern::kBark:
      c = Shade(c, 1.0F + 0.5F * k * Streaks(at, 0.08F, 5.0F, 4, 41U) +
                       0.2F * k * Fbm(at, 0.7F, 2, 0.6F, 42U));
      break;
    case Pattern::kAsphalt: {
      const float crack = std::abs(Fbm(at, 1.9F, 4, 0.55F, 43U));
      c = Shade(c, 1.0F + k * (0.34F * Fbm(at, 0.06F, 5, 0.95F, 44U) +
                               0.2F * Fbm(at, 3.1F, 3, 0.6F, 45U)));
      c = Shade(c, 1.0F - 0.55F * (1.0F - SmoothStep(0.0F, 0.05F + at.footprint, crack)) *
                              Visible(0.15F, at.footprint));
      break;
    }
    case Pattern::kConcrete: {
      const Cell cell = BrickCell(at, m.size * 1.6F, m.size, 0.008F, false);
      const float tone = HashUnit(cell.column, cell.row, at.seed + 47U) - 0.5F;
      c = Shade(c, 1.0F + k * (0.14F * Fbm(at, 1.3F, 4, 0.65F, 48U) +
                               0.12F * Fbm(at, 0.07F, 3, 0.75F, 49U) +
                               0.1F * Streaks(at, 0.35F, 6.0F, 2, 50U) + 0.12F * tone));
      c = Lerp(Shade(c, 0.45F), c, cell.inside);
      break;
    }
    case Pattern::kBooks: {
      const float shelf = at.v / (7.0F * m.size);
      const std::int32_t row = Floor(shelf);
      // Backs of unequal width: the column's number after a smooth warp.
      const float warped =
          at.u / m.size +
          0.45F * ValueNoise(at.u / (2.1F * m.size), static_cast<float>(row) * 9.3F, at.seed + 51U);
      const std::int32_t column = Floor(warped);
      const Vec3 back{HashUnit(column, row, at.seed + 52U), HashUnit(column, row, at.seed + 53U),
                      HashUnit(column, row, at.seed + 54U)};
      const float in_shelf = shelf - static_cast<float>(row);
      const float height = 0.68F + 0.22F * HashUnit(column, row, at.seed + 55U);
      Vec3 book = Lerp(c, Vec3{0.08F, 0.06F, 0.05F} + back * 0.5F, 0.75F);
      const float title = SmoothStep(0.02F, 0.0F, std::abs(in_shelf - 0.45F) - 0.12F);
      book = Lerp(book, Vec3{0.75F, 0.68F, 0.45F},
                  0.5F * title * HashUnit(column, row, at.seed + 56U));
      const float gap = SmoothStep(
          0.0F, 0.12F,
          std::min(warped - static_cast<float>(column), static_cast<float>(column) + 1 - warped));
      book = Shade(book, 0.35F + 0.65F * gap);
      const float above = SmoothStep(height - 0.02F, height + 0.02F, in_shelf);
      c = Lerp(book, m.second * 0.25F, above);
      const float board = SmoothStep(0.06F, 0.04F, in_shelf);
      c = Lerp(c, m.second, board);
      const Vec3 mean = Lerp(m.colour, m.second, 0.5F) * 0.6F;
      c = Lerp(mean, c, Visible(2.0F * m.size, at.footprint));
      c = Shade(c, 1.0F + 0.12F * k * Fbm(at, 0.04F, 2, 0.7F, 57U));
      break;
    }
    case Pattern::kPicture: {
      const float wx = at.u + 0.3F * m.size * Fbm(at, m.size, 2, 0.5F, 58U);
      const float wy = at.v + 0.3F * m.size * Fbm(at, m.size, 2, 0.5F, 59U);
      const std::int32_t ix = Floor(wx / m.size);
      const std::int32_t iy = Floor(wy / m.size);
      const Vec3 patch{HashUnit(ix, iy, at.seed + 60U), HashUnit(ix, iy, at.seed + 61U),
                       HashUnit(ix, iy, at.seed + 62U)};
      c = Lerp(Lerp(c, m.second, patch.x), patch * 0.8F, 0.6F);
      c = Shade(c, 1.0F + k * 0.3F * Fbm(at, 0.12F, 4, 0.7F, 63U));
      break;
    }
    case Pattern::kRoof: {
      const Cell cell = BrickCell(at, m.size * 0.8F, m.size, 0.012F, true);
      const float tone = HashUnit(cell.column, cell.row, at.seed + 64U) - 0.5F;
      const float down = at.v / m.size - static_cast<float>(cell.row);
      const float visible = Visible(m.size, at.footprint);
      c = Shade(c, 1.0F + k * (0.5F * tone * visible + 0.35F * (down - 0.5F) * visible +
                               0.15F * Fbm(at, 0.9F, 5, 0.65F, 65U)));
      c = Lerp(m.second, c, cell.inside);
      break;
    }
    case Pattern::kStripes: {
      const float wave = std::sin(6.2832F * at.u / m.size + 0.8F * Fbm(at, 0.8F, 2, 0.5F, 66U));
      c = Lerp(c, m.second, 0.5F + 0.5F * wave * Visible(m.size, at.footprint));
      c = Shade(c, 1.0F + k * 0.10F * Fbm(at, 0.04F, 3, 0.7F, 67U));
      break;
    }
    case Pattern::kLitRoom: {
      const float frame =
          SmoothStep(0.03F, 0.04F + at.footprint,
                     std::abs(at.u / m.size - std::floor(at.u / m.size) - 0.5F) * m.size);
      c = Lerp(c, m.second, Clamp01(0.5F + 0.5F * Fbm(at, 0.6F, 3, 0.6F, 68U)));
      c = Shade(c, 0.25F + 0.75F * frame);
      break;
    }
  }
  const auto limit = [](float v) { return std::clamp(v, 0.002F, 0.95F); };
  return {limit(c.x), limit(c.y), limit(c.z)};
}

}  // namespace omnihdr::sim
