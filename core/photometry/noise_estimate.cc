#include "core/photometry/noise_estimate.h"

#include <algorithm>
#include <cmath>
#include <vector>

namespace omnihdr {
namespace {

constexpr int kBlock = 8;
constexpr double kDarkest =
    1.0;  // of a block's mean above black: below, clipping at black hides noise
constexpr double kBrightest = 10.0;
constexpr std::size_t kLeastBlocks = 100;
constexpr double kLeastReadNoise = 0.1;

template <typename T>
double Estimate(const Image<T>& image, double scale, double black, const NoiseModel& model) {
  const int channel = image.channels() == 3 ? 1 : 0;
  std::vector<double> read_variance;
  for (int y0 = 0; y0 + kBlock <= image.height(); y0 += kBlock) {
    for (int x0 = 0; x0 + kBlock <= image.width(); x0 += kBlock) {
      double sum = 0.0;
      double squares = 0.0;
      int count = 0;
      for (int y = y0 + 1; y + 1 < y0 + kBlock; ++y) {
        for (int x = x0 + 1; x + 1 < x0 + kBlock; ++x) {
          const auto v = [&](int dx, int dy) -> double {
            return image.pixel(x + dx, y + dy)[channel];
          };
          const double residual = v(-1, -1) + v(1, -1) + v(-1, 1) + v(1, 1) -
                                  2.0 * (v(0, -1) + v(0, 1) + v(-1, 0) + v(1, 0)) + 4.0 * v(0, 0);
          squares += residual * residual;
          sum += v(0, 0);
          ++count;
        }
      }
      const double mean = sum * scale / count - black;
      if (mean < kDarkest || mean > kBrightest) continue;
      const double variance = squares * scale * scale / (36.0 * count);
      read_variance.push_back(variance - model.gain * mean - 1.0 / 12.0);
    }
  }
  if (read_variance.size() < kLeastBlocks) return kTypicalReadNoise;
  const auto quartile =
      read_variance.begin() + static_cast<std::ptrdiff_t>(read_variance.size() / 4);
  std::nth_element(read_variance.begin(), quartile, read_variance.end());
  return std::sqrt(std::max(*quartile, kLeastReadNoise * kLeastReadNoise));
}

}  // namespace

double EstimateReadNoise(const DecodedImage& image, int bits, double black,
                         const NoiseModel& model) {
  if (const auto* narrow = std::get_if<Image<std::uint8_t>>(&image.pixels)) {
    return Estimate(*narrow, 1.0, black, model);
  }
  const double largest = std::pow(2.0, std::clamp(bits, 8, 16)) - 1.0;
  return Estimate(std::get<Image<std::uint16_t>>(image.pixels), 255.0 / largest, black, model);
}

}  // namespace omnihdr
