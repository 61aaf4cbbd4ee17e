#pragma once

#include <array>
#include <cstddef>
#include <cstdint>

namespace omnihdr {

// Samples of one sensor for `count` consecutive pixels of the panorama (StitchTable). The arrays
// may be read kStitchPadding values beyond the end.
struct StitchSamples {
  const std::uint32_t* block = nullptr;
  const std::uint32_t* packed = nullptr;
  const float* shade = nullptr;
  int count = 0;
};

// How a sensor's values become radiance: channel c of a pixel is scale[c]·shade·value.
struct StitchScale {
  std::array<float, 3> scale{};
};

// A saturated channel holds the least of the values that it was made from: a bound that holds also
// at the rim of a clipped area. A pixel saturated in all channels is written neutral, at the least
// of their bounds, which holds for all of them: gains would make it pink.

// Writes R, G, B, usable (Measurement) and flags (PixelFlag) of every sample. All run on the best
// vector unit there is; the result does not depend on how a row is cut into calls.

// From merged radiance and states of a mosaic (RadianceMosaic).
void StitchMosaic(const float* radiance, const std::uint8_t* state, std::ptrdiff_t stride,
                  const StitchSamples& samples, const StitchScale& scale, float* rgba,
                  std::uint8_t* flags);
// The same with the mosaic's green at every place (GreenGuide, the mosaic's size): green is
// bilinear between the 2×2 places in the middle of the block, red and blue are the mosaic's values
// times the ratio of that green to the one interpolated from their own places. Colours that are
// saturated, and all where green is, are as without the guide: bounds stay bounds.
void StitchGuided(const float* radiance, const float* guide, const std::uint8_t* state,
                  std::ptrdiff_t stride, const StitchSamples& samples, const StitchScale& scale,
                  float* rgba, std::uint8_t* flags);
// Straight from the bytes of one exposure of a linear sensor: value − black, at least a quarter of
// a step; saturated above `high`, dark below `low`.
void StitchBytes(const std::uint8_t* bytes, std::ptrdiff_t stride, float black, std::uint32_t low,
                 std::uint32_t high, const StitchSamples& samples, const StitchScale& scale,
                 float* rgba, std::uint8_t* flags);
// From finished colour (3 channels) or grey (1), bilinear between the 2×2 pixels in the middle of
// the block.
void StitchColour(const float* radiance, const std::uint8_t* state, std::ptrdiff_t stride,
                  int channels, const StitchSamples& samples, const StitchScale& scale, float* rgba,
                  std::uint8_t* flags);

// Blends `sensors` rows of samples of the same pixels, k at rgba + 4·k·count, flags + k·count, by
// their shares. A sample with a saturated channel takes part only where all have one, but for those
// that are less than half of what a clipped sample of no smaller share proves: they show something
// else and are left out. Then a channel saturated in all is the largest of the bounds, and one that
// is not is blended from those in which it is not.
void BlendSamples(const float* rgba, const std::uint8_t* flags, const std::uint32_t* const* packed,
                  int sensors, int count, float* out_rgba, std::uint8_t* out_flags);

}  // namespace omnihdr
