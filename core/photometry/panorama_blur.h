#pragma once

#include "core/image/image.h"

namespace omnihdr {

// What lies beyond the edges of a picture. kPlane: nothing. kCylinder: the left and the right edge
// are neighbours. kSphere (lat-long): that, and over the poles the picture goes on half a turn
// further; a pixel is as wide as the sine of its row's angle from the pole says.
enum class PictureShape { kPlane, kCylinder, kSphere };

// Gaussian blur of a W×H×1 picture; sigma in pixels of a column (a row of a kSphere picture is
// blurred by sigma divided by the row's sine, so that the kernel covers about the same solid angle
// everywhere). A constant picture stays the same; where there is nothing beyond an edge the edge's
// pixels are repeated. `out` may not be `in`; it is made of the right size. Deterministic; all
// workers. Values must be finite.
void GaussianBlur(ImageView<const float> in, double sigma, PictureShape shape, Image<float>* out);

}  // namespace omnihdr
