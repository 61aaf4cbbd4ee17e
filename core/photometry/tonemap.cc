#include "core/photometry/tonemap.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "core/base/parallel_for.h"

namespace omnihdr {
namespace {

// EncodeSrgb by table: 4096 steps are finer than 8-bit output needs above black, where the curve is
// steepest a second table over the first 1/64 keeps it exact to one code.
class SrgbTable {
 public:
  SrgbTable() {
    for (std::size_t i = 0; i < fine_.size(); ++i) {
      fine_[i] = Encode(static_cast<float>(i) / (64.0F * static_cast<float>(fine_.size() - 1)));
      coarse_[i] = Encode(static_cast<float>(i) / static_cast<float>(coarse_.size() - 1));
    }
  }
  std::uint8_t operator()(float linear) const {
    if (!(linear > 0.0F)) return 0;
    if (linear >= 1.0F) return 255;
    const float scale = static_cast<float>(fine_.size() - 1);
    if (linear < 1.0F / 64.0F)
      return fine_[static_cast<std::size_t>(linear * 64.0F * scale + 0.5F)];
    return coarse_[static_cast<std::size_t>(linear * scale + 0.5F)];
  }

 private:
  static std::uint8_t Encode(float linear) {
    const float v =
        linear <= 0.0031308F ? 12.92F * linear : 1.055F * std::pow(linear, 1.0F / 2.4F) - 0.055F;
    return static_cast<std::uint8_t>(std::clamp(v * 255.0F + 0.5F, 0.0F, 255.0F));
  }
  std::array<std::uint8_t, 4096> fine_{};
  std::array<std::uint8_t, 4096> coarse_{};
};

const SrgbTable& Srgb() {
  static const SrgbTable table;
  return table;
}

}  // namespace

std::uint8_t EncodeSrgb(float linear) { return Srgb()(linear); }

Image<std::uint8_t> ToneMapReinhard(ImageView<const float> radiance,
                                    const ToneMapOptions& options) {
  const int width = radiance.width();
  const int height = radiance.height();
  // Log-average and white point from a sample: every pixel adds nothing a 16th of them does not
  // tell.
  std::vector<float> luminance;
  luminance.reserve(static_cast<std::size_t>(width) * static_cast<std::size_t>(height) / 16 + 1);
  for (int y = 1; y < height; y += 4) {
    for (int x = 1; x < width; x += 4) {
      const float l = Luminance(radiance.pixel(x, y));
      if (std::isfinite(l) && l > 0.0F) luminance.push_back(l);
    }
  }
  double log_sum = 0.0;
  for (const float l : luminance) log_sum += std::log(static_cast<double>(l));
  const double log_average =
      luminance.empty() ? 1.0 : std::exp(log_sum / static_cast<double>(luminance.size()));
  const auto scale = static_cast<float>(options.key / log_average);
  float white = 1.0F;
  if (!luminance.empty()) {
    const auto nth =
        luminance.begin() + static_cast<std::ptrdiff_t>(options.white_percentile *
                                                        static_cast<double>(luminance.size() - 1));
    std::nth_element(luminance.begin(), nth, luminance.end());
    white = std::max(scale * *nth, 1.0F);
  }
  const float inverse_white_squared = 1.0F / (white * white);

  Image<std::uint8_t> out(width, height, 3);
  const SrgbTable& srgb = Srgb();
  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        const float* in = radiance.pixel(x, y);
        std::uint8_t* o = out.pixel(x, y);
        const float l = scale * Luminance(in);
        if (!(l > 0.0F) || !std::isfinite(l)) continue;
        const float factor = scale * (1.0F + l * inverse_white_squared) / (1.0F + l);
        for (int c = 0; c < 3; ++c) o[c] = srgb(in[c] * factor);
      }
    }
  });
  return out;
}

}  // namespace omnihdr
