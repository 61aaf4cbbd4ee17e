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
  RowSampler(const Measurement& m, Contrast contrast);
  void Sample(const float* x, const float* y, std::size_t count, SampledRow* out) const;

 private:
  const Measurement* m_;
  bool is_cylinder_;
  // Of the four pixels around a point whose upper left one is (x, y - 1): bits that any has, and,
  // from the ninth on, which of them not all have.
  Image<std::uint16_t> around_;
  Image<float> contrast_;
};

// Change of luminance per pixel: columns wrap round, rows end.
Image<float> ContrastOf(const Measurement& m);

}  // namespace omnihdr
