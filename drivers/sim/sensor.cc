#include "drivers/sim/sensor.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>
#include <memory>
#include <vector>

#include "core/base/parallel_for.h"

namespace omnihdr::sim {
namespace {

// Quantile function of the normal distribution (Acklam's rational approximation, |error| < 1.2e-9
// relative), for p in (0, 0.5].
double LowerNormalQuantile(double p) {
  if (p < 0.02425) {
    const double q = std::sqrt(-2 * std::log(p));
    return (((((-7.784894002430293e-03 * q - 3.223964580411365e-01) * q - 2.400758277161838) * q -
              2.549732539343734) *
                 q +
             4.374664141464968) *
                q +
            2.938163982698783) /
           ((((7.784695709041462e-03 * q + 3.224671290700398e-01) * q + 2.445134137142996) * q +
             3.754408661907416) *
                q +
            1.0);
  }
  const double q = p - 0.5;
  const double r = q * q;
  return (((((-3.969683028665376e+01 * r + 2.209460984245205e+02) * r - 2.759285104469687e+02) * r +
            1.383577518672690e+02) *
               r -
           3.066479806614716e+01) *
              r +
          2.506628277459239) *
         q /
         (((((-5.447609879822406e+01 * r + 1.615858368580409e+02) * r - 1.556989798598866e+02) * r +
            6.680131188771972e+01) *
               r -
           1.328068155288572e+01) *
              r +
          1.0);
}

constexpr std::size_t kQuantiles = 1U << 14U;

// Normal deviates by table: exact out to four sigma, and the same on every machine.
const std::vector<float>& NormalTable() {
  static const std::vector<float> table = [] {
    std::vector<float> values(kQuantiles);
    for (std::size_t i = 0; i < kQuantiles / 2; ++i) {
      const double p = (static_cast<double>(i) + 0.5) / static_cast<double>(kQuantiles);
      values[i] = static_cast<float>(LowerNormalQuantile(p));
      values[kQuantiles - 1 - i] = -values[i];
    }
    return values;
  }();
  return table;
}

std::uint64_t Mix(std::uint64_t z) {
  z = (z ^ (z >> 30U)) * 0xbf58476d1ce4e5b9ULL;
  z = (z ^ (z >> 27U)) * 0x94d049bb133111ebULL;
  return z ^ (z >> 31U);
}

Status CheckRange(const char* name, double value, double low, double high) {
  if (value >= low && value <= high) return {};
  return Fail(ErrorKind::kConfig, "{}: {}: expected {} to {}", name, value, low, high);
}

}  // namespace

Status SensorOptions::Validate() const {
  OMNIHDR_TRY(CheckRange("full_well_e", full_well_e, 100.0, 1e7));
  OMNIHDR_TRY(CheckRange("read_noise", read_noise, 0.0, 20.0));
  OMNIHDR_TRY(CheckRange("prnu", prnu, 0.0, 0.1));
  OMNIHDR_TRY(CheckRange("white", white, 64.0, 255.0));
  return {};
}

Image<std::uint8_t> Expose(ImageView<const float> radiance, const Exposure& exposure,
                           const SensorOptions& options, std::uint64_t frame) {
  const int width = radiance.width();
  const int height = radiance.height();
  const int channels = radiance.channels();
  Image<std::uint8_t> values(width, height, channels);
  const auto scale = static_cast<float>(128.0 * exposure.EffectiveSeconds());
  const double gain = exposure.gain.Factor();
  const auto shot = static_cast<float>(gain * 255.0 / options.full_well_e);
  const auto read = static_cast<float>(gain * gain * options.read_noise * options.read_noise);
  const auto prnu = static_cast<float>(options.prnu);
  const auto most = static_cast<float>(std::floor(options.white));
  const std::vector<float>& normal = NormalTable();
  const std::uint64_t frame_key = Mix(Mix(options.seed + 0x9e3779b97f4a7c15ULL) + frame);
  const std::uint64_t pattern_key = Mix(options.seed + 0xd1b54a32d192ed03ULL);
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      const float* in = radiance.row(y);
      std::uint8_t* out = values.row(y);
      for (int x = 0; x < width; ++x) {
        const std::uint64_t pixel =
            (static_cast<std::uint64_t>(y) * static_cast<std::uint64_t>(width) +
             static_cast<std::uint64_t>(x)) *
            0x9e3779b97f4a7c15ULL;
        // Four 14-bit numbers to a hash: enough for the channels of a pixel.
        std::uint64_t noise = Mix(frame_key + pixel);
        std::uint64_t pattern = Mix(pattern_key + pixel);
        for (int c = 0; c < channels; ++c) {
          const int i = x * channels + c;
          const float sensitivity = 1.0F + prnu * normal[pattern % kQuantiles];
          const float mean = std::min(in[i] * scale * sensitivity, 1e6F);
          const float sigma = std::sqrt(read + shot * mean);
          const float value = mean + sigma * normal[noise % kQuantiles];
          out[i] = static_cast<std::uint8_t>(std::clamp(value + 0.5F, 0.0F, most));
          noise >>= 16U;
          pattern >>= 16U;
        }
      }
    }
  });
  return values;
}

}  // namespace omnihdr::sim
