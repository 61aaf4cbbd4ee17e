#pragma once

#include <cmath>
#include <cstdint>
#include <optional>
#include <string_view>

#include "core/base/result.h"
#include "core/base/simd.h"
#include "core/image/image.h"
#include "core/photometry/panorama_blur.h"

namespace omnihdr {

enum class ToneOperator {
  // Global photographic tone reproduction: Reinhard, Stark, Shirley and Ferwerda, "Photographic
  // Tone Reproduction for Digital Images", 2002, eqs. 1-4. The fastest, and monotone.
  kReinhard,
  // The same with dodging and burning: each pixel is compressed by the mean of the largest
  // neighbourhood without much contrast (eqs. 5-9).
  kReinhardLocal,
  // Drago, Myszkowski, Annen and Chiba, "Adaptive Logarithmic Mapping For Displaying High Contrast
  // Scenes", 2003, eq. 4. Monotone; for the greatest ranges.
  kDrago,
  // Durand and Dorsey, "Fast Bilateral Filtering for the Display of High-Dynamic-Range Images",
  // 2002: large-scale contrast compressed, detail kept. The filter is computed on the grid of
  // Paris and Durand, "A Fast Approximation of the Bilateral Filter", 2006.
  kDurand,
};
std::string_view ToString(ToneOperator tone_operator);  // "reinhard", "reinhard-local", ...
std::optional<ToneOperator> ToneOperatorFromString(std::string_view name);

struct ToneMapOptions {
  ToneOperator tone_operator = ToneOperator::kReinhard;
  PictureShape shape = PictureShape::kPlane;  // a kSphere's averages count solid angles
  // What the log-average luminance maps to, [0.0001, 1]: the automatic exposure (Reinhard eq. 2).
  // Not of kDurand, which brings the brightest large-scale luminance to white.
  double key = 0.18;
  double exposure_stops = 0.0;  // brighter (> 0) or darker than the automatic exposure, ±20
  // Share of the picture's area, [0.5, 1], whose luminance stays below white (Reinhard eq. 4) and
  // below Drago's maximum; the papers have the largest, which one hot pixel can decide.
  double white_percentile = 0.999;
  // kReinhardLocal: sharpening, [0, 20], and the contrast that ends a neighbourhood's
  // growth, [0.0001, 1] (phi and epsilon of eqs. 7 and 8).
  double sharpening = 8.0;
  double threshold = 0.05;
  double bias = 0.85;  // kDrago, [0.5, 1]: smaller lifts the dark parts more
  // kDurand: decades that the large-scale contrast is brought to, [0.3, 10], and the filter's
  // widths: share of the picture's longer side, [0.005, 0.2], and decades of luminance, [0.1, 2].
  double contrast_decades = 1.6;
  double sigma_space = 0.02;
  double sigma_range = 0.4;
  Status Validate() const;  // kConfig error naming the member and its range
};

// Linear RGB (W×H×3, or ×4, the fourth ignored) to 8-bit sRGB. Luminance is mapped and colours are
// scaled with it, so that hue stays as long as no channel clips. Automatic exposure: the absolute
// scale of the radiance does not matter. NaN reads as black, a luminance of zero or less too, an
// infinite one as white; none of them moves the rest of the picture. Equal bytes on any number of
// workers. `options` must be valid.
Image<std::uint8_t> ToneMap(ImageView<const float> radiance, const ToneMapOptions& options);

// ToneMap with kReinhard, whatever the options' operator.
Image<std::uint8_t> ToneMapReinhard(ImageView<const float> radiance, const ToneMapOptions& options);

// sRGB encoding (IEC 61966-2-1) of a linear value in 0..1 as a code of 0..255, not rounded, to
// within 0.001. Values outside are clamped, NaN reads as 0. x^(1/2.4) = q^(5/3) with q = x^(1/4),
// by a minimax polynomial of degree 6 in q; no branches, so that loops over it vectorise.
OMNIHDR_ALWAYS_INLINE float SrgbCode(float linear) {
  const float positive = linear > 0.0F ? linear : 0.0F;
  const float v = positive < 1.0F ? positive : 1.0F;
  const float q = std::sqrt(std::sqrt(v));
  float p = 17.3929901F;
  p = p * q - 81.1959152F;
  p = p * q + 167.582779F;
  p = p * q - 217.503967F;
  p = p * q + 348.309784F;
  p = p * q + 35.5990677F;
  p = p * q - 15.1843863F;
  return v < 0.0031308F ? 255.0F * 12.92F * v : p;
}
// The same, rounded to the nearest code.
OMNIHDR_ALWAYS_INLINE std::uint8_t EncodeSrgb(float linear) {
  return static_cast<std::uint8_t>(static_cast<int>(SrgbCode(linear) + 0.5F));
}

// Relative luminance of linear RGB with the Rec. 709 primaries.
inline float Luminance(const float* rgb) {
  return 0.2126F * rgb[0] + 0.7152F * rgb[1] + 0.0722F * rgb[2];
}

}  // namespace omnihdr
