#pragma once

#include <cstdint>

#include "core/image/image.h"

namespace omnihdr {

struct ToneMapOptions {
  double key = 0.18;  // what the log-average luminance maps to (Reinhard et al. 2002, eq. 2)
  double white_percentile = 0.999;  // luminance that maps to white (eq. 4)
};

// Global photographic tone reproduction (Reinhard, Stark, Shirley and Ferwerda 2002, eqs. 1-4) of
// linear RGB (W×H×3 or ×4, the fourth ignored) to 8-bit sRGB. Scaling by luminance keeps hue; NaN
// and negative values read as black.
Image<std::uint8_t> ToneMapReinhard(ImageView<const float> radiance, const ToneMapOptions& options);

// sRGB encoding (IEC 61966-2-1) of a linear value in 0..1.
std::uint8_t EncodeSrgb(float linear);

// Relative luminance of linear RGB with the Rec. 709 primaries.
inline float Luminance(const float* rgb) {
  return 0.2126F * rgb[0] + 0.7152F * rgb[1] + 0.0722F * rgb[2];
}

}  // namespace omnihdr
