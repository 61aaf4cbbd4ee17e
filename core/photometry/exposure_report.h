#pragma once

#include <cstdint>
#include <vector>

#include "core/image/image.h"
#include "core/image/image_io.h"

namespace omnihdr {

// Pixels of one frame outside the range in which it says something, by grey level (Rec. 601 luma,
// 8-bit units): the thesis's tables 6.2 and 6.4.
struct ExposureCount {
  std::size_t pixels = 0;  // not masked
  std::size_t under = 0;   // grey level below 5
  std::size_t over = 0;    // grey level above 250
  double UnderPercent() const { return Percent(under); }
  double OverPercent() const { return Percent(over); }

 private:
  double Percent(std::size_t n) const {
    return pixels == 0 ? 0.0 : 100.0 * static_cast<double>(n) / static_cast<double>(pixels);
  }
};
// `bits`: significant bits of a 16-bit image. `mask`: empty or the image's size, below 128 = leave
// out. Grey and Bayer pictures count by their values.
ExposureCount CountExposure(const DecodedImage& image, int bits,
                            ImageView<const std::uint8_t> mask);

// Range of luminance of a radiance map.
struct RadianceRange {
  double min = 0.0;
  double max = 0.0;
  double low = 0.0;   // 0.1st percentile
  double high = 0.0;  // 99.9th percentile
  std::size_t pixels = 0;
  // Of the percentiles, and of the extremes; 0 when nothing was measured.
  double Stops() const { return Log2(high, low); }
  double Decades() const;
  double FullStops() const { return Log2(max, min); }

 private:
  static double Log2(double high, double low);
};
// `radiance`: R, G, B first of its channels. `counted`: one value a pixel, non-zero = measured.
RadianceRange RangeOfRadiance(const Image<float>& radiance, const Image<std::uint8_t>& counted);

}  // namespace omnihdr
