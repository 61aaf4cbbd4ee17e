#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/image/image.h"
#include "core/photometry/panorama_blur.h"

namespace omnihdr {

// Pictures of maps, in colours a person can read. All are RGB, 8 bits. The colour map is Turbo
// (A. Mikhailov, 2019): dark blue, cyan, green, yellow, dark red. Unknown (NaN) is a grey hatch,
// which no value has.

// Where a value lies between the map's ends, in 0..1; NaN = unknown. Values outside are clamped.
Image<std::uint8_t> LevelColours(ImageView<const float> levels);

// Disparity: 0 is the cool end, `nearest` and above the warm one. Levels are the square root of the
// share, which spreads the far half, where most of a scene lies.
Image<float> DisparityLevels(ImageView<const float> disparity, double nearest);
Image<std::uint8_t> DisparityColours(ImageView<const float> disparity, double nearest);
// The disparity below which 98 % of a map lies; 0 when nothing is known.
double NearDisparity(ImageView<const float> disparity);

// Luminance (W×H×1) on a logarithmic scale from `low` to `high`, both positive. Zero and less are
// the cool end.
Image<float> RadianceLevels(ImageView<const float> luminance, double low, double high);
// Luminances that 0.5 % and 99.9 % of the positive, finite pixels lie below; at least a decade
// apart. {0.1, 1} when there are none.
struct LuminanceRange {
  double low = 0.1;
  double high = 1.0;
};
LuminanceRange RangeOf(ImageView<const float> luminance);

// Signed differences (W×H×1): white = none, red = `full` and more, blue = −`full` and less; 96 grey
// where unknown.
Image<std::uint8_t> DifferenceColours(ImageView<const float> difference, double full);
// The same of log10(tested / truth) of luminance.
Image<float> LogError(ImageView<const float> tested, ImageView<const float> truth);
Image<std::uint8_t> ErrorColours(ImageView<const float> tested, ImageView<const float> truth,
                                 double full);

// A picture of kinds, each with its colour; other values are magenta.
struct Kind {
  float value = 0.0F;
  std::string name;
  std::uint8_t red = 0;
  std::uint8_t green = 0;
  std::uint8_t blue = 0;
};
Image<std::uint8_t> KindColours(ImageView<const float> kinds, const std::vector<Kind>& legend);

// A bar below a picture that says what its colours mean.
struct ScaleBar {
  struct Tick {
    double level = 0.0;  // 0 = left end, 1 = right end
    std::string label;   // left out where an earlier tick's label stands
  };
  std::string title;  // what and in which unit
  std::vector<Tick> ticks;
  bool is_signed = false;  // DifferenceColours' colours rather than Turbo's
  bool has_unknown = true;
};
Image<std::uint8_t> WithScaleBar(ImageView<const std::uint8_t> picture, const ScaleBar& bar);
Image<std::uint8_t> WithLegend(ImageView<const std::uint8_t> picture, const std::string& title,
                               const std::vector<Kind>& legend);

// Round numbers (1, 2 or 5 times a power of ten) on the bars of the two scales above, so far apart
// that labels rarely touch. `unit`: of distance, "m"; disparities are labelled by both.
std::vector<ScaleBar::Tick> DisparityTicks(double nearest, const std::string& unit);
std::vector<ScaleBar::Tick> RadianceTicks(double low, double high);

}  // namespace omnihdr
