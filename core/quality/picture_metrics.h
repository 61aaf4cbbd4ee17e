#pragma once

#include "core/image/image.h"
#include "core/quality/comparison_area.h"

namespace omnihdr {

// Peak signal-to-noise ratio in dB, 10·log10(peak² / mean squared difference), over all channels of
// the area's pixels that are finite in both pictures. Infinite for equal pictures, NaN when nothing
// can be compared.
double Psnr(ImageView<const float> tested, ImageView<const float> truth, double peak,
            const ComparisonArea& area);

// PSNR-µ: PSNR after the µ-law T(x) = ln(1 + µx) / ln(1 + µ), µ = 5000, of radiance divided by
// `white` and clipped to [0, 1] (Kalantari and Ramamoorthi, "Deep High Dynamic Range Imaging of
// Dynamic Scenes", 2017, eq. 1): counts errors in dark and bright parts about as a display would
// show them. The tested map must already be on the truth's scale.
double PsnrMu(ImageView<const float> tested, ImageView<const float> truth, double white,
              const ComparisonArea& area);

// Mean structural similarity of single-channel pictures (Wang, Bovik, Sheikh and Simoncelli, "Image
// Quality Assessment: From Error Visibility to Structural Similarity", 2004, eq. 13): 11×11
// Gaussian window, sigma 1.5, C1 = (0.01·peak)², C2 = (0.03·peak)². 1 = identical. Only windows
// that lie inside the picture and whose every pixel is in the area and finite in both count,
// weighted by the row of their centre. With `wraps` the picture's left and right edges are
// neighbours (panorama). NaN for no window. Without mask and wrapping it is scikit-image's
// structural_similarity(gaussian_weights=True, sigma=1.5, use_sample_covariance=False) to 1e-9.
double Ssim(ImageView<const float> tested, ImageView<const float> truth, double peak,
            const ComparisonArea& area, bool wraps = false);

// What the display shows of luminance, 0..1: the global operator of Reinhard, Stark, Shirley and
// Ferwerda
// ("Photographic Tone Reproduction for Digital Images", 2002, eqs. 1, 2 and 4) with key 0.18. Two
// pictures are compared under the same parameters, those of the truth.
struct ReinhardParameters {
  double log_average = 1.0;  // exp(mean ln L) over the area
  double white = 1.0;        // smallest scaled luminance shown as pure white: the area's largest
};
ReinhardParameters ReinhardParametersOf(ImageView<const float> luminance,
                                        const ComparisonArea& area);
Image<float> ReinhardDisplay(ImageView<const float> luminance,
                             const ReinhardParameters& parameters);

}  // namespace omnihdr
