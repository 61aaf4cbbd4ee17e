#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <vector>

#include "core/base/result.h"
#include "core/image/image.h"
#include "core/photometry/measure.h"

namespace omnihdr {

// A pixel value, 8-bit units (fractions from 16-bit pictures and from means over a window), and the
// exposure it was seen under, an index into ResponseSamples::seconds.
struct ResponseObservation {
  float value = 0.0F;
  std::uint32_t exposure = 0;
};

// What a response is recovered from: spots of the scene, each seen under two exposures or more.
// Every channel has spots of its own.
struct ResponseSamples {
  struct Channel {
    std::vector<ResponseObservation> observations;  // one spot's after the other's
    std::vector<std::uint32_t> begin = {0};         // spot i: [begin[i], begin[i + 1])
    std::size_t size() const { return begin.size() - 1; }
    std::span<const ResponseObservation> spot(std::size_t i) const {
      return std::span(observations).subspan(begin[i], begin[i + 1] - begin[i]);
    }
    void Add(std::span<const ResponseObservation> spot);
  };
  std::vector<double> seconds;     // effective exposure (time and gain) of each picture
  std::vector<std::string> names;  // of the pictures, for messages; as many as seconds
  std::array<Channel, 3> channels;
  // Values below do not follow the light (film fog, flare, black clipping) and were left out.
  std::array<double, 3> floor{};
  // Spots left out because a value falls while the exposure grows: something moved there.
  std::size_t moving = 0;
};

struct SampleOptions {
  // Usable values, 8-bit units: nearer to the ends a value may be clipped.
  double value_low = 5.0;
  double value_high = 250.0;
  int max_spots = 4000;  // per channel, 16 to 100000
  int radius = 1;        // a value is the mean over (2·radius + 1)² pixels, 0 to 8
  Status Validate() const;
};

// Spots of pictures taken from one place (a tripod bracket), chosen by themselves: in every cell of
// a grid over the picture the place of the least change between neighbouring pixels, which noise,
// lens blur and a shift of a fraction of a pixel hurt least; from those the smoothest, rougher ones
// only where they bring pixel values that the others lack. A spot counts under the exposures in
// which its whole window is usable, in a channel that has two such exposures. Deterministic.
// `bits`: significant bits of 16-bit pictures. `mask`: empty, or of the pictures' size, under 128 =
// do not use. `names`: of the pictures, for messages.
// Errors (kData) with their reason: fewer than two pictures, sizes that differ, exposures that are
// not positive or all equal, everything masked, saturated throughout, dark throughout, values that
// fall while the exposure grows (naming the two pictures), too few spots.
Result<ResponseSamples> SamplesFromBracket(std::span<const ExposedFrame> frames,
                                           std::span<const std::string> names, int bits,
                                           ImageView<const std::uint8_t> mask,
                                           const SampleOptions& options);

// Least ratio of the longest exposure to the shortest from which a response is recovered.
inline constexpr double kLeastExposureRatio = 1.1;
// Least number of spots of a channel.
inline constexpr std::size_t kLeastSpots = 40;

// The checks that all sources of samples share: exposures positive and different, enough spots in
// every channel, values that rise with exposure.
Status CheckSamples(const ResponseSamples& samples);

}  // namespace omnihdr
