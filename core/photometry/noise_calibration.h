#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/image/image_io.h"
#include "core/photometry/noise_model.h"

namespace omnihdr {

// Two pictures of an evenly lit surface at the same exposure. Borrowed.
struct FlatPair {
  const DecodedImage* first = nullptr;
  const DecodedImage* second = nullptr;
  std::string name;  // for messages
};

struct NoiseCalibrationOptions {
  double black = 0.0;  // 8-bit units, [0, 128)
  int bits = 8;        // significant bits of 16-bit pictures
  // Bayer mosaics: neighbours of one colour are two pixels apart.
  bool mosaic = false;
  Status Validate() const;
};

// One level of the photon transfer curve, 8-bit units: mean of many tiles of about that value.
struct TransferPoint {
  double mean = 0.0;      // above black
  double temporal = 0.0;  // variance from frame to frame, quantisation included
  double temporal_error = 0.0;
  double pattern = 0.0;  // variance from pixel to pixel that stays: the sensor's pattern
  std::size_t tiles = 0;
};

struct Estimate {
  double value = 0.0;
  double standard_error = 0.0;
};

struct NoiseCalibration {
  NoiseModel model;        // what the pipeline takes
  Estimate gain;           // variance per code value
  Estimate read;           // code values rms
  Estimate prnu;           // a fraction
  Estimate full_well_e;    // electrons at value 255
  Estimate read_e;         // electrons rms
  double r_squared = 0.0;  // of the straight line through the points
  std::vector<TransferPoint> points;
  std::size_t tiles = 0;    // used
  std::size_t clipped = 0;  // left out: values at an end of the range
};

// Photon transfer (Janesick 2007): in small tiles the half variance of the difference of two equal
// pictures is read² + gain·Z + 1/12 and knows nothing of the sensor's pattern or of uneven light;
// what the variance of their mean has beyond that is prnu²·Z². Tiles see light that varies over the
// picture as more levels, so a vignetted flat serves. Errors (kData): no pairs, sizes or channels
// that differ, two pictures that are no pair (their levels differ by over 2 %), everything clipped
// or dark, levels too close to each other, a surface that is not flat within tiles, variance that
// does not grow with the signal.
Result<NoiseCalibration> CalibrateNoise(std::span<const FlatPair> pairs,
                                        const NoiseCalibrationOptions& options);

}  // namespace omnihdr
