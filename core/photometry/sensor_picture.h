#pragma once

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/image/image_io.h"
#include "core/sphere/rig.h"

namespace omnihdr {

// What one sensor saw, for calibration: pixel values in 8-bit units (a 16-bit file of `bits`
// significant bits is scaled to 0..255, fractions kept), 1 channel (grey or Bayer) or 3 (RGB).
struct SensorPicture {
  Image<float> values;
  BayerOrder bayer = BayerOrder::kNone;  // kNone for three channels

  int width() const { return values.width(); }
  int height() const { return values.height(); }
  // Whether the picture says anything about colour.
  bool has_colour() const { return values.channels() == 3 || bayer != BayerOrder::kNone; }
};

// Rows [first_row, first_row + height) of a decoded picture: one sensor of a stacked frame, or all
// of it with height = the picture's. A Bayer order on a three-channel picture is ignored: it is
// developed already. `bits` counts for 16-bit pictures only. Errors (kData): rows outside the
// picture, bits outside 8..16.
Result<SensorPicture> MakeSensorPicture(const DecodedImage& image, int bits, BayerOrder bayer,
                                        int first_row, int height);

}  // namespace omnihdr
