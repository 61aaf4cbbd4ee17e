#pragma once

#include <vector>

#include "core/image/image.h"
#include "core/photometry/tonemap.h"

// What the tone mapping operators share. Not for others.
namespace omnihdr::tonemap {

// Of a picture's finite, positive luminances, weighted by solid angle on a sphere; from a regular
// sample of some ten thousand pixels.
struct LuminanceStatistics {
  bool any = false;
  double log_average = 1.0;  // exp(mean ln L)
  double high = 1.0;         // luminance at the white percentile
  double median = 1.0;
};
LuminanceStatistics StatisticsOf(ImageView<const float> radiance, const ToneMapOptions& options);

// Luminance of one row.
void LuminanceRow(const float* pixels, int channels, int count, float* luminance);
// out = sRGB(pixel · factor) of one row.
void EncodeRow(const float* pixels, int channels, const float* factor, int count,
               std::uint8_t* out);

// W×H factors, display luminance over luminance, of the two local operators.
Image<float> ReinhardLocalFactors(ImageView<const float> radiance, const ToneMapOptions& options,
                                  const LuminanceStatistics& statistics);
Image<float> DurandFactors(ImageView<const float> radiance, const ToneMapOptions& options,
                           const LuminanceStatistics& statistics);

// Larger luminances count as this, so that infinity stays out of the sums.
inline constexpr float kLargestLuminance = 1e30F;

}  // namespace omnihdr::tonemap
