#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/photometry/mosaic.h"
#include "core/photometry/stitch_kernels.h"

namespace omnihdr {

// Where the sensors' samples of a stitched picture are read from: the bytes of one linear exposure,
// or the mosaic merged from the frames. Borrows
// them.
struct StitchSource {
  struct Sensor {
    StitchScale scale;
    bool is_mosaic = false;
    // Straight from the bytes.
    float black = 0.0F;
    std::uint32_t low = 0;
    std::uint32_t high = 0;
  };

  const std::uint8_t* bytes = nullptr;  // when set, `mosaic` does not count
  const RadianceMosaic* mosaic = nullptr;
  const Image<float>* guide = nullptr;  // GreenGuide of the mosaic, or nothing
  int width = 0;                        // of the stacked frame
  std::vector<Sensor> sensors;

  // Writes R, G, B, usable and flags of every sample, as the kernels do.
  void Sample(std::uint8_t sensor, const StitchSamples& samples, float* rgba,
              std::uint8_t* flags) const {
    const Sensor& s = sensors[sensor];
    if (bytes != nullptr) {
      StitchBytes(bytes, width, s.black, s.low, s.high, samples, s.scale, rgba, flags);
    } else if (s.is_mosaic && guide != nullptr) {
      StitchGuided(mosaic->radiance.data(), guide->data(), mosaic->state.data(), width, samples,
                   s.scale, rgba, flags);
    } else if (s.is_mosaic) {
      StitchMosaic(mosaic->radiance.data(), mosaic->state.data(), width, samples, s.scale, rgba,
                   flags);
    } else {
      const int channels = mosaic->radiance.channels();
      StitchColour(mosaic->radiance.data(), mosaic->state.data(),
                   static_cast<std::ptrdiff_t>(width) * channels, channels, samples, s.scale, rgba,
                   flags);
    }
  }
};

}  // namespace omnihdr
