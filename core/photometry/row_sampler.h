#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/image/image.h"
#include "core/photometry/measurement.h"
#include "core/photometry/sampler.h"

namespace omnihdr {

// What a measurement holds along a row of points, one array a quantity.
struct SampledRow {
  std::array<std::vector<float>, 3> radiance;
  std::vector<float> contrast;  // change of luminance per pixel around the nearest pixel
  std::vector<std::uint8_t> flags;
  std::vector<float> clipped;  // the clipped pixels' share of the blend (Rim::kBound only)
  std::size_t size() const { return flags.size(); }
};

inline RadianceSample SampleOf(const SampledRow& row, std::size_t i) {
  return {{row.radiance[0][i], row.radiance[1][i], row.radiance[2][i]}, row.flags[i]};
}

// PanoramaSampler::SampleAt for whole rows of points, in vectors. Borrowed: the measurement must
// outlive it. Thread-safe.
class RowSampler {
 public:
  enum class Contrast { kNone, kSampled };
  // What is said where only some of the four pixels around a point are clipped: the nearest pixel
  // alone, as PanoramaSampler; or the blend of all four, which is a bound (the channels that any
  // has clipped are saturated; those that all have dark are dark), and how much of it is clipped.
  // Less than a 256th counts for nothing.
  enum class Rim : std::uint8_t { kNearest, kBound };
  RowSampler(const Measurement& m, Contrast contrast, Rim rim = Rim::kNearest);
  void Sample(const float* x, const float* y, std::size_t count, SampledRow* out) const;

 private:
  const Measurement* m_;
  Rim rim_;
  bool is_cylinder_;
  // Of the four pixels around a point whose upper left one is (x, y - 1): the blend's flags, and,
  // from the ninth on, bits that only some have and for which the nearest is taken.
  Image<std::uint16_t> around_;
  Image<float> contrast_;
};

// Change of luminance per pixel: columns wrap round, rows end.
Image<float> ContrastOf(const Measurement& m);

}  // namespace omnihdr
