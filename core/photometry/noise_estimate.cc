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

// Sum of a block's values but for its rim, and of the squared residuals there: in whole numbers,
// exact.
template <typename T>
std::int64_t SumOfBlock(const Image<T>& image, int x0, int y0, int channel) {
  std::int64_t sum = 0;
  for (int y = y0 + 1; y + 1 < y0 + kBlock; ++y) {
    const T* p = image.pixel(x0, y) + channel;
    for (int x = 1; x + 1 < kBlock; ++x) sum += p[x * image.channels()];
  }
  return sum;
}

template <typename T>
std::int64_t SquaresOfBlock(const Image<T>& image, int x0, int y0, int channel) {
  const int step = image.channels();
  std::int64_t squares = 0;
  for (int y = y0 + 1; y + 1 < y0 + kBlock; ++y) {
    const T* above = image.pixel(x0, y - 1) + channel;
    const T* here = image.pixel(x0, y) + channel;
    const T* below = image.pixel(x0, y + 1) + channel;
    for (int x = step; x + step < kBlock * step; x += step) {
      const std::int64_t residual =
          above[x - step] + above[x + step] + below[x - step] + below[x + step] -
          2 * (above[x] + below[x] + here[x - step] + here[x + step]) + 4 * here[x];
      squares += residual * residual;
    }
  }
  return squares;
}

template <typename T>
double Estimate(const Image<T>& image, double scale, double black, const NoiseModel& model) {
  constexpr int kCount = (kBlock - 2) * (kBlock - 2);
  const int channel = image.channels() == 3 ? 1 : 0;
  std::vector<double> read_variance;
  for (int y0 = 0; y0 + kBlock <= image.height(); y0 += kBlock) {
    for (int x0 = 0; x0 + kBlock <= image.width(); x0 += kBlock) {
      // Most blocks are too bright: their residuals are never needed.
      const auto sum = static_cast<double>(SumOfBlock(image, x0, y0, channel));
      const double mean = sum * scale / kCount - black;
      if (mean < kDarkest || mean > kBrightest) continue;
      const auto squares = static_cast<double>(SquaresOfBlock(image, x0, y0, channel));
      const double variance = squares * scale * scale / (36.0 * kCount);
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
