#include "core/stereo/stereo_view.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "core/base/fast_math.h"
#include "core/base/parallel_for.h"
#include "core/base/simd.h"
#include "core/photometry/row_sampler.h"
#include "core/stereo/row_geometry.h"

namespace omnihdr {
namespace {

constexpr std::uint8_t kLowestCode = 1;
constexpr std::uint8_t kHighestCode = 254;
// A dark channel still tells its radiance, if roughly, down to this many times the noise floor;
// below, it only says "at most".
constexpr float kDarkNoiseFloors = 2.0F;
constexpr std::uint64_t kNothing = 0x00FF00FF00FF00FFULL;  // every lane lo = 255, hi = 0

// Texels before packing, rows × width of each: the lanes' bytes, and what the derivatives need.
struct LaneSamples {
  Image<std::uint16_t> red;  // lo, then hi
  Image<std::uint16_t> blue;
  std::array<Image<float>, 3> logs;  // natural logarithms of red, green and blue
  Image<std::uint8_t> flags;
};

// Natural logarithm of each radiance and `floor`.
OMNIHDR_SIMD_CLONES
void ToLogarithms(const float* __restrict radiance, int count, float floor, float* __restrict out) {
  constexpr float kLn2 = std::numbers::ln2_v<float>;
  for (int j = 0; j < count; ++j) {
    const float e = radiance[j] > 0.0F ? radiance[j] : 0.0F;
    out[j] = kLn2 * FastLog2(e + floor);
  }
}

// Channels that are dark but above `limit` are measured after all, if roughly.
OMNIHDR_SIMD_CLONES
void ForgiveDark(const float* __restrict radiance, int count, float limit, std::uint8_t bit,
                 std::uint8_t* __restrict flags) {
  for (int j = 0; j < count; ++j) {
    const auto kept = static_cast<std::uint8_t>(~bit);
    flags[j] = static_cast<std::uint8_t>(flags[j] & (radiance[j] >= limit ? kept : 255));
  }
}

// The interval of each logarithm's code (LogScale).
OMNIHDR_SIMD_CLONES
void Intervals(const float* __restrict logs, const std::uint8_t* __restrict flags, int count,
               float ln_black, float codes_per_ln, std::uint8_t saturated, std::uint8_t dark,
               std::uint16_t* __restrict out) {
  constexpr auto kLow = static_cast<float>(kLowestCode);
  constexpr auto kHigh = static_cast<float>(kHighestCode);
  for (int j = 0; j < count; ++j) {
    float rounded = kLow + (logs[j] - ln_black) * codes_per_ln + 0.5F;
    rounded = rounded > kLow ? rounded : kLow;
    rounded = rounded < kHigh ? rounded : kHigh;
    const int value = static_cast<int>(rounded);
    const int low = (flags[j] & dark) != 0 ? 0 : value;
    const int high = (flags[j] & saturated) != 0 ? 255 : value;
    out[j] = static_cast<std::uint16_t>(low | high << 8);
  }
}

// A row's logarithms by channel.
using LogRow = std::array<const float*, 3>;

// The interval of each derivative between two places, of which flags say what was measured: the
// mean over the channels that both have, by their say in luminance. Most edges change all channels
// by one factor, so that the rest speaks for a clipped one.
OMNIHDR_SIMD_CLONES
void Gradients(const LogRow& before, const LogRow& after,
               const std::uint8_t* __restrict flags_before,
               const std::uint8_t* __restrict flags_after, int count, float codes_per_ln,
               std::uint16_t* __restrict out) {
  const float* __restrict r0 = before[0];
  const float* __restrict g0 = before[1];
  const float* __restrict b0 = before[2];
  const float* __restrict r1 = after[0];
  const float* __restrict g1 = after[1];
  const float* __restrict b1 = after[2];
  for (int j = 0; j < count; ++j) {
    const int flags = flags_before[j] | flags_after[j];
    const float r = (flags & (kSaturatedR | kDarkR)) != 0 ? 0.0F : 0.2126F;
    const float g = (flags & (kSaturatedG | kDarkG)) != 0 ? 0.0F : 0.7152F;
    const float b = (flags & (kSaturatedB | kDarkB)) != 0 ? 0.0F : 0.0722F;
    const float weight = r + g + b;
    const float sum = r * (r1[j] - r0[j]) + g * (g1[j] - g0[j]) + b * (b1[j] - b0[j]);
    float rounded = 128.5F + 0.5F * codes_per_ln * sum / (weight > 0.0F ? weight : 1.0F);
    rounded = rounded > 1.0F ? rounded : 1.0F;
    rounded = rounded < 254.0F ? rounded : 254.0F;
    const int value = static_cast<int>(rounded);
    const bool measured = (flags & (kMasked | kMover)) == 0 && weight > 0.0F;
    out[j] = static_cast<std::uint16_t>(measured ? value | value << 8 : 255 << 8);
  }
}

OMNIHDR_SIMD_CLONES
void Pack(const std::uint16_t* __restrict red, const std::uint16_t* __restrict blue,
          const std::uint16_t* __restrict across, const std::uint16_t* __restrict down,
          const std::uint8_t* __restrict flags, int count, std::uint64_t* __restrict out) {
  for (int j = 0; j < count; ++j) {
    const std::uint64_t texel = std::uint64_t{red[j]} | std::uint64_t{blue[j]} << 16U |
                                std::uint64_t{across[j]} << 32U | std::uint64_t{down[j]} << 48U;
    out[j] = (flags[j] & (kMasked | kMover)) != 0 ? kNothing : texel;
  }
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
  view.texels.resize(static_cast<std::size_t>(rows) * static_cast<std::size_t>(width + 1));

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
      Image<std::uint16_t>::Uninitialized(width, rows),
      Image<std::uint16_t>::Uninitialized(width, rows),
      {Image<float>::Uninitialized(width, rows), Image<float>::Uninitialized(width, rows),
       Image<float>::Uninitialized(width, rows)},
      Image<std::uint8_t>::Uninitialized(width, rows)};
  const RowSampler row_sampler(measurement, RowSampler::Contrast::kNone);
  ParallelFor(rows, 8, [&](int begin, int end) {
    RayRow rays;
    rays.x.resize(static_cast<std::size_t>(width));
    rays.y.resize(static_cast<std::size_t>(width));
    rays.z.resize(static_cast<std::size_t>(width));
    PointRow points;
    SampledRow row;
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
      row_sampler.Sample(points.x.data(), points.y.data(), cos_sin.size(), &row);
      for (std::size_t c = 0; c < 3; ++c) {
        ForgiveDark(row.radiance[c].data(), width, dark_limit,
                    static_cast<std::uint8_t>(kDarkR << c), row.flags.data());
      }
      for (std::size_t c = 0; c < 3; ++c) {
        ToLogarithms(row.radiance[c].data(), width, scale.floor, samples.logs[c].row(i));
      }
      Intervals(samples.logs[0].row(i), row.flags.data(), width, scale.ln_black, scale.codes_per_ln,
                kSaturatedR, kDarkR, samples.red.row(i));
      Intervals(samples.logs[2].row(i), row.flags.data(), width, scale.ln_black, scale.codes_per_ln,
                kSaturatedB, kDarkB, samples.blue.row(i));
      std::copy(row.flags.begin(), row.flags.end(), samples.flags.row(i));
    }
  });

  constexpr int kStep =
      2;  // derivative over one pixel of a map of half the lattice's size each side
  ParallelFor(rows, 8, [&](int begin, int end) {
    const auto texels = static_cast<std::size_t>(width);
    std::vector<std::uint16_t> across(texels);
    std::vector<std::uint16_t> down(texels);
    // With the last ones before the first and the first after the last.
    std::array<std::vector<float>, 3> logs;
    for (std::vector<float>& channel : logs) channel.resize(texels + 2 * kStep);
    std::vector<std::uint8_t> flags(texels + 2 * kStep);
    const auto wrap = [&](const auto* row, auto* wrapped) {
      std::copy_n(row, width, wrapped->begin() + kStep);
      std::copy_n(row + width - kStep, kStep, wrapped->begin());
      std::copy_n(row, kStep, wrapped->end() - kStep);
    };
    for (int i = begin; i < end; ++i) {
      const int above = std::max(0, i - kStep);
      const int below = std::min(view.height, i + kStep);
      for (std::size_t c = 0; c < 3; ++c) wrap(samples.logs[c].row(i), &logs[c]);
      wrap(samples.flags.row(i), &flags);
      const auto from = [&](int column) {
        return LogRow{logs[0].data() + column, logs[1].data() + column, logs[2].data() + column};
      };
      const auto at_row = [&](int row) {
        return LogRow{samples.logs[0].row(row), samples.logs[1].row(row), samples.logs[2].row(row)};
      };
      Gradients(from(0), from(2 * kStep), flags.data(), flags.data() + 2 * kStep, width,
                scale.gradient_codes_per_ln, across.data());
      Gradients(at_row(above), at_row(below), samples.flags.row(above), samples.flags.row(below),
                width, scale.gradient_codes_per_ln, down.data());
      std::uint64_t* out = view.texels.data() + static_cast<std::ptrdiff_t>(i) * (width + 1);
      Pack(samples.red.row(i), samples.blue.row(i), across.data(), down.data(),
           samples.flags.row(i), width, out);
      out[width] = out[0];
    }
  });
  return view;
}

}  // namespace omnihdr
