#include "core/stereo/stereo_view.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "core/base/fast_math.h"
#include "core/base/parallel_for.h"
#include "core/base/simd.h"
#include "core/photometry/sampler.h"
#include "core/photometry/tonemap.h"
#include "core/stereo/row_geometry.h"

namespace omnihdr {
namespace {

constexpr std::uint8_t kLowestCode = 1;
constexpr std::uint8_t kHighestCode = 254;
constexpr float kGradientCodesPerLn = 60.0F;
// A dark channel still tells its radiance, if roughly, down to this many times the noise floor;
// below, it only says "at most".
constexpr float kDarkNoiseFloors = 2.0F;
constexpr std::uint64_t kNothing = 0x00FF00FF00FF00FFULL;  // every lane lo = 255, hi = 0

// Texels before packing, rows × width of each: radiance, or its code on the log scale.
struct LaneSamples {
  Image<float> red;
  Image<float> blue;
  Image<float> luminance;
  Image<std::uint8_t> flags;
};

// Code (LogScale) of each radiance, in place; of luminance the natural logarithm.
OMNIHDR_SIMD_CLONES
void ToLogarithms(float* __restrict red, float* __restrict blue, float* __restrict luminance,
                  int count, float floor, float ln_black, float codes_per_ln) {
  constexpr float kLn2 = std::numbers::ln2_v<float>;
  constexpr auto kFirst = static_cast<float>(kLowestCode);
  for (int j = 0; j < count; ++j) {
    const float r = red[j] > 0.0F ? red[j] : 0.0F;
    const float b = blue[j] > 0.0F ? blue[j] : 0.0F;
    const float y = luminance[j] > 0.0F ? luminance[j] : 0.0F;
    red[j] = kFirst + (kLn2 * FastLog2(r + floor) - ln_black) * codes_per_ln;
    blue[j] = kFirst + (kLn2 * FastLog2(b + floor) - ln_black) * codes_per_ln;
    luminance[j] = kLn2 * FastLog2(y + floor);
  }
}

std::uint64_t Byte(std::uint64_t value, int position) { return value << (8 * position); }

std::uint64_t Interval(float code, bool saturated, bool dark, int position) {
  const auto v = static_cast<std::uint64_t>(
      std::clamp(code + 0.5F, static_cast<float>(kLowestCode), static_cast<float>(kHighestCode)));
  return Byte(dark ? 0 : v, position) | Byte(saturated ? 255 : v, position + 1);
}

// `flags`: of both places; `change`: of the logarithm of luminance between them.
std::uint64_t Gradient(std::uint8_t flags, float change, int position) {
  if ((flags & (kMasked | kMover | kSaturatedAny | kDarkAny)) != 0) {
    return Byte(0, position) | Byte(255, position + 1);
  }
  const float code = 128.0F + kGradientCodesPerLn * 0.5F * change;
  const auto v = static_cast<std::uint64_t>(std::clamp(code + 0.5F, 1.0F, 254.0F));
  return Byte(v, position) | Byte(v, position + 1);
}

// Mean of the eight bytes of two texels, each rounded down.
OMNIHDR_ALWAYS_INLINE std::uint64_t MeanOfBytes(std::uint64_t a, std::uint64_t b) {
  return (a & b) + (((a ^ b) & 0xFEFEFEFEFEFEFEFEULL) >> 1U);
}

// Texels around every second one, weighed 1 2 1 each way. `middle`: `width` texels and the first
// again.
OMNIHDR_SIMD_CLONES
void HalveRow(const std::uint64_t* __restrict above, const std::uint64_t* __restrict middle,
              const std::uint64_t* __restrict below, int width, std::uint64_t* __restrict column,
              std::uint64_t* __restrict out) {
  for (int j = 0; j <= width; ++j) {
    column[j] = MeanOfBytes(MeanOfBytes(above[j], below[j]), middle[j]);
  }
  const int half = width / 2;
  out[0] = MeanOfBytes(MeanOfBytes(column[width - 1], column[1]), column[0]);
  for (int j = 1; j < half; ++j) {
    out[j] = MeanOfBytes(MeanOfBytes(column[2 * j - 1], column[2 * j + 1]), column[2 * j]);
  }
  out[half] = out[0];
}

}  // namespace

LogScale LogScale::For(float lowest_noise_floor, float highest_saturation) {
  LogScale scale;
  scale.floor = std::max(lowest_noise_floor, 1e-12F);
  scale.ln_black = std::log(scale.floor);
  const float brightest = std::max(highest_saturation * 1.2F, scale.floor * 16.0F);
  scale.codes_per_ln =
      std::min(60.0F, 253.0F / (std::log(brightest + scale.floor) - scale.ln_black));
  return scale;
}

StereoView HalveStereoView(const StereoView& view) {
  StereoView halved;
  halved.width = view.width / 2;
  halved.height = view.height / 2;
  halved.texels.resize(static_cast<std::size_t>(halved.height + 1) *
                       static_cast<std::size_t>(halved.width + 1));
  ParallelFor(halved.height + 1, 16, [&](int begin, int end) {
    std::vector<std::uint64_t> column(static_cast<std::size_t>(view.width) + 1);
    for (int i = begin; i < end; ++i) {
      HalveRow(view.row(std::max(0, 2 * i - 1)), view.row(2 * i),
               view.row(std::min(view.height, 2 * i + 1)), view.width, column.data(),
               halved.texels.data() + static_cast<std::ptrdiff_t>(i) * (halved.width + 1));
    }
  });
  return halved;
}

Measurement HalveMeasurement(const Measurement& m) {
  Measurement half;
  const int width = m.radiance.width() / 2;
  const int height = m.radiance.height() / 2;
  half.projection = m.projection.Resized(width, height);
  half.saturation = m.saturation;
  half.variance_floor = m.variance_floor;
  half.variance_per_radiance = m.variance_per_radiance;
  half.noise_floor = m.noise_floor;
  half.longest_exposure_s = m.longest_exposure_s;
  half.shortest_exposure_s = m.shortest_exposure_s;
  half.radiance = Image<float>(width, height, 4);
  half.flags = Image<std::uint8_t>(width, height);
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        float sum[4] = {};
        int measured = 0;
        std::uint8_t flags = 0;
        for (int k = 0; k < 4; ++k) {
          const int sx = 2 * x + (k & 1);
          const int sy = 2 * y + (k >> 1);
          const std::uint8_t f = m.flags.at(sx, sy);
          if ((f & kMasked) != 0) continue;
          flags |= f;
          ++measured;
          const float* p = m.radiance.pixel(sx, sy);
          for (int c = 0; c < 3; ++c) sum[c] += p[c];
        }
        float* out = half.radiance.pixel(x, y);
        if (measured == 0) {
          half.flags.at(x, y) = kMasked;
          continue;
        }
        for (int c = 0; c < 3; ++c) out[c] = sum[c] / static_cast<float>(measured);
        out[3] = flags == 0 && measured == 4 ? 1.0F : 0.0F;
        half.flags.at(x, y) = flags;
      }
    }
  });
  return half;
}

StereoView MakeStereoView(const Measurement& measurement,
                          const Eigen::Quaterniond& world_from_camera, int width,
                          const LogScale& scale) {
  if (measurement.radiance.width() > width + width / 2) {
    return MakeStereoView(HalveMeasurement(measurement), world_from_camera, width, scale);
  }
  StereoView view;
  view.width = width;
  view.height = width / 2;
  const int rows = view.height + 1;
  view.texels.assign(static_cast<std::size_t>(rows) * static_cast<std::size_t>(width + 1),
                     kNothing);

  const Eigen::Matrix3f camera_from_world =
      world_from_camera.conjugate().toRotationMatrix().cast<float>();
  const PanoramaSampler sampler(measurement);
  const float dark_limit = kDarkNoiseFloors * measurement.noise_floor;
  std::vector<std::array<float, 2>> cos_sin(static_cast<std::size_t>(width));
  for (int j = 0; j < width; ++j) {
    const double theta = std::numbers::pi - 2.0 * std::numbers::pi * j / width;
    cos_sin[static_cast<std::size_t>(j)] = {static_cast<float>(std::cos(theta)),
                                            static_cast<float>(std::sin(theta))};
  }
  LaneSamples samples = {
      Image<float>::Uninitialized(width, rows), Image<float>::Uninitialized(width, rows),
      Image<float>::Uninitialized(width, rows), Image<std::uint8_t>::Uninitialized(width, rows)};
  ParallelFor(rows, 8, [&](int begin, int end) {
    RayRow rays;
    rays.x.resize(static_cast<std::size_t>(width));
    rays.y.resize(static_cast<std::size_t>(width));
    rays.z.resize(static_cast<std::size_t>(width));
    PointRow points;
    for (int i = begin; i < end; ++i) {
      const double phi = std::numbers::pi * i / view.height;
      const auto sin_phi = static_cast<float>(std::sin(phi));
      const auto cos_phi = static_cast<float>(std::cos(phi));
      for (std::size_t j = 0; j < cos_sin.size(); ++j) {
        rays.x[j] = sin_phi * cos_sin[j][0];
        rays.y[j] = sin_phi * cos_sin[j][1];
        rays.z[j] = cos_phi;
      }
      PointsInView(rays, camera_from_world, sampler, &points);
      float* red = samples.red.row(i);
      float* blue = samples.blue.row(i);
      float* luminance = samples.luminance.row(i);
      std::uint8_t* flags = samples.flags.row(i);
      for (std::size_t j = 0; j < cos_sin.size(); ++j) {
        const RadianceSample sample = sampler.SampleAt(points.x[j], points.y[j]);
        flags[j] = sample.flags;
        for (std::size_t k = 0; k < 3; ++k) {
          if (sample.rgb[k] >= dark_limit) {
            flags[j] = static_cast<std::uint8_t>(flags[j] & ~(kDarkR << k));
          }
        }
        red[j] = sample.rgb[0];
        blue[j] = sample.rgb[2];
        luminance[j] = Luminance(sample.rgb.data());
      }
      ToLogarithms(red, blue, luminance, width, scale.floor, scale.ln_black, scale.codes_per_ln);
    }
  });

  constexpr int kStep =
      2;  // derivative over one pixel of a map of half the lattice's size each side
  ParallelFor(rows, 8, [&](int begin, int end) {
    for (int i = begin; i < end; ++i) {
      std::uint64_t* out = view.texels.data() + static_cast<std::ptrdiff_t>(i) * (width + 1);
      const int above = std::max(0, i - kStep);
      const int below = std::min(view.height, i + kStep);
      const float* red = samples.red.row(i);
      const float* blue = samples.blue.row(i);
      const float* luminance = samples.luminance.row(i);
      const float* luminance_above = samples.luminance.row(above);
      const float* luminance_below = samples.luminance.row(below);
      const std::uint8_t* flags = samples.flags.row(i);
      const std::uint8_t* flags_above = samples.flags.row(above);
      const std::uint8_t* flags_below = samples.flags.row(below);
      for (int j = 0; j < width; ++j) {
        const std::uint8_t f = flags[j];
        if ((f & (kMasked | kMover)) != 0) continue;
        const int left = j >= kStep ? j - kStep : j - kStep + width;
        const int right = j + kStep < width ? j + kStep : j + kStep - width;
        out[j] = Interval(red[j], (f & kSaturatedR) != 0, (f & kDarkR) != 0, 0) |
                 Interval(blue[j], (f & kSaturatedB) != 0, (f & kDarkB) != 0, 2) |
                 Gradient(static_cast<std::uint8_t>(flags[left] | flags[right]),
                          luminance[right] - luminance[left], 4) |
                 Gradient(static_cast<std::uint8_t>(flags_above[j] | flags_below[j]),
                          luminance_below[j] - luminance_above[j], 6);
      }
      out[width] = out[0];
    }
  });
  return view;
}

}  // namespace omnihdr
