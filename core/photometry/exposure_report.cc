#include "core/photometry/exposure_report.h"

#include <algorithm>
#include <cmath>

#include "core/photometry/tonemap.h"

namespace omnihdr {
namespace {

constexpr double kUnder = 5.0;
constexpr double kOver = 250.0;
constexpr double kLowPercentile = 0.001;

template <typename T>
ExposureCount Count(const Image<T>& image, double scale, ImageView<const std::uint8_t> mask) {
  ExposureCount count;
  for (int y = 0; y < image.height(); ++y) {
    const T* p = image.row(y);
    for (int x = 0; x < image.width(); ++x, p += image.channels()) {
      if (!mask.empty() && mask.at(x, y) < 128) continue;
      const double grey =
          scale * (image.channels() == 3 ? 0.299 * p[0] + 0.587 * p[1] + 0.114 * p[2] : p[0]);
      ++count.pixels;
      if (grey < kUnder) ++count.under;
      if (grey > kOver) ++count.over;
    }
  }
  return count;
}

}  // namespace

ExposureCount CountExposure(const DecodedImage& image, int bits,
                            ImageView<const std::uint8_t> mask) {
  if (const auto* narrow = std::get_if<Image<std::uint8_t>>(&image.pixels)) {
    return Count(*narrow, 1.0, mask);
  }
  const double largest = std::pow(2.0, std::clamp(bits, 8, 16)) - 1.0;
  return Count(std::get<Image<std::uint16_t>>(image.pixels), 255.0 / largest, mask);
}

double RadianceRange::Log2(double high, double low) {
  return low > 0.0 && high > 0.0 ? std::log2(high / low) : 0.0;
}

double RadianceRange::Decades() const { return Stops() * std::log10(2.0); }

RadianceRange RangeOfRadiance(const Image<float>& radiance, const Image<std::uint8_t>& counted) {
  std::vector<float> luminance;
  for (int y = 0; y < radiance.height(); ++y) {
    for (int x = 0; x < radiance.width(); ++x) {
      if (counted.at(x, y) == 0) continue;
      const float l = Luminance(radiance.pixel(x, y));
      if (l > 0.0F && std::isfinite(l)) luminance.push_back(l);
    }
  }
  RadianceRange range;
  range.pixels = luminance.size();
  if (luminance.empty()) return range;
  const auto [least, largest] = std::minmax_element(luminance.begin(), luminance.end());
  range.min = *least;
  range.max = *largest;
  const auto quantile = [&luminance](double q) -> double {
    const auto at =
        luminance.begin() +
        static_cast<std::ptrdiff_t>(std::llround(q * static_cast<double>(luminance.size() - 1)));
    std::nth_element(luminance.begin(), at, luminance.end());
    return *at;
  };
  range.low = quantile(kLowPercentile);
  range.high = quantile(1.0 - kLowPercentile);
  return range;
}

}  // namespace omnihdr
