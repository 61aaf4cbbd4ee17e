#pragma once

#include "core/image/image.h"

namespace omnihdr {

// Gaussian blur of a panorama whose left and right borders meet (rows beyond the top and bottom
// repeat the border row): `to` = blur of `from`. When `difference` is not null it gets `to` −
// `from`. All the same size, one channel. Runs on the best vector unit there is; uses the worker
// pool.
void BlurPanorama(const Image<float>& from, double sigma, Image<float>* to,
                  Image<float>* difference);

}  // namespace omnihdr
