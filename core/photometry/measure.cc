#include "core/photometry/measure.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/photometry/noise_estimate.h"

namespace omnihdr {
namespace {

constexpr std::array<std::uint8_t, 3> kSaturatedBit = {kSaturatedR, kSaturatedG, kSaturatedB};
constexpr std::array<std::uint8_t, 3> kDarkBit = {kDarkR, kDarkG, kDarkB};

// What the merge needs of one frame: value -> E·t per channel, and the noise in those units.
struct PreparedFrame {
  const DecodedImage* image = nullptr;
  float inverse_seconds = 0.0F;
  float seconds = 0.0F;
  double value_scale = 1.0;  // file value to 8-bit units
  // Lookup for 8-bit frames, and for 16-bit ones with up to 16 bits of values.
  std::array<std::vector<float>, 3> exposure_of_value;
  std::uint32_t low = 0;  // usable file values: low..high
  std::uint32_t high = 0;
};

PreparedFrame Prepare(const ExposedFrame& frame, const Response& response, int bits,
                      const MeasureOptions& options) {
  PreparedFrame p;
  p.image = frame.image;
  p.seconds = static_cast<float>(frame.exposure.EffectiveSeconds());
  p.inverse_seconds = 1.0F / p.seconds;
  const std::size_t values =
      frame.image->is_16_bit() ? std::size_t{1} << std::clamp(bits, 8, 16) : std::size_t{256};
  p.value_scale = 255.0 / static_cast<double>(values - 1);
  for (int c = 0; c < 3; ++c) {
    std::vector<float>& table = p.exposure_of_value[static_cast<std::size_t>(c)];
    table.resize(values);
    for (std::size_t z = 0; z < values; ++z) {
      table[z] =
          static_cast<float>(response.ExposureFromValue(c, static_cast<double>(z) * p.value_scale));
    }
  }
  // A value of 0 stands for light between nothing and half a step above: a quarter, never "none".
  for (std::size_t c = 0; c < 3; ++c) {
    std::vector<float>& table = p.exposure_of_value[c];
    const auto first = std::find_if(table.begin(), table.end(), [](float e) { return e > 0.0F; });
    if (first != table.end()) std::fill(table.begin(), first, 0.25F * *first);
  }
  p.low = static_cast<std::uint32_t>(std::ceil(options.value_low / p.value_scale));
  p.high = static_cast<std::uint32_t>(std::floor(options.value_high / p.value_scale));
  return p;
}

// One pixel's file values; grey pictures count as R = G = B. Values beyond the declared bits are
// clipped.
struct Values {
  std::array<std::uint32_t, 3> z{};
};

template <typename T>
Values ReadValues(const Image<T>& image, int x, int y, std::uint32_t largest) {
  const T* p = image.pixel(x, y);
  Values v;
  for (std::size_t c = 0; c < 3; ++c) {
    v.z[c] = std::min<std::uint32_t>(p[image.channels() == 3 ? c : 0], largest);
  }
  return v;
}

class PixelMerger {
 public:
  PixelMerger(const std::vector<PreparedFrame>& frames, const MeasureOptions& options,
              const Response& response)
      : frames_(frames) {
    for (const PreparedFrame& frame : frames) {
      if (frame.seconds < frames_[shortest_].seconds) {
        shortest_ = static_cast<std::size_t>(&frame - frames.data());
      }
      if (frame.seconds > frames_[longest_].seconds) {
        longest_ = static_cast<std::size_t>(&frame - frames.data());
      }
    }
    for (std::size_t c = 0; c < 3; ++c) {
      const double slope = response.Slope(static_cast<int>(c), 128.0);
      read_variance_[c] = static_cast<float>(
          (options.noise.read * options.noise.read + 1.0 / 12.0) * slope * slope);
      shot_[c] = static_cast<float>(options.noise.gain * slope);
      prnu_ = static_cast<float>(options.noise.prnu * options.noise.prnu);
    }
  }

  // Writes R, G, B, usable to `out` and returns the flags.
  std::uint8_t Merge(int x, int y, float* out) const {
    std::uint8_t flags = 0;
    constexpr std::size_t kMax = 64;
    std::array<Values, kMax> values;
    std::array<bool, kMax> bright{};  // saturated in some channel
    const std::size_t count = std::min(frames_.size(), kMax);
    bool any_unsaturated = false;
    for (std::size_t k = 0; k < count; ++k) {
      const PreparedFrame& frame = frames_[k];
      const auto largest = static_cast<std::uint32_t>(frame.exposure_of_value[0].size() - 1);
      values[k] = std::visit([&](const auto& image) { return ReadValues(image, x, y, largest); },
                             frame.image->pixels);
      for (const std::uint32_t z : values[k].z) bright[k] = bright[k] || z > frame.high;
      any_unsaturated = any_unsaturated || !bright[k];
    }
    for (std::size_t c = 0; c < 3; ++c) {
      if (!any_unsaturated) {
        const PreparedFrame& frame = frames_[shortest_];
        const std::uint32_t z = values[shortest_].z[c];
        out[c] = frame.exposure_of_value[c][z] * frame.inverse_seconds;
        if (z > frame.high) flags = static_cast<std::uint8_t>(flags | kSaturatedBit[c]);
        if (z < frame.low) flags = static_cast<std::uint8_t>(flags | kDarkBit[c]);
        continue;
      }
      // First the total of the light over the total of the time (Hanji et al. 2020), then that
      // signal's variance in each frame for the weights.
      float light = 0.0F;
      float time = 0.0F;
      for (std::size_t k = 0; k < count; ++k) {
        if (bright[k] || values[k].z[c] < frames_[k].low) continue;
        light += frames_[k].exposure_of_value[c][values[k].z[c]];
        time += frames_[k].seconds;
      }
      if (time == 0.0F) {
        // Dark wherever it is not saturated: the longest of those says most.
        const PreparedFrame* best = nullptr;
        std::uint32_t z = 0;
        for (std::size_t k = 0; k < count; ++k) {
          if (bright[k] || (best != nullptr && frames_[k].seconds <= best->seconds)) continue;
          best = &frames_[k];
          z = values[k].z[c];
        }
        out[c] = best->exposure_of_value[c][z] * best->inverse_seconds;
        flags = static_cast<std::uint8_t>(flags | kDarkBit[c]);
        continue;
      }
      const float signal = light / time;
      float sum = 0.0F;
      float weight_sum = 0.0F;
      for (std::size_t k = 0; k < count; ++k) {
        if (bright[k] || values[k].z[c] < frames_[k].low) continue;
        const float x_signal = signal * frames_[k].seconds;
        const float variance =
            read_variance_[c] + shot_[c] * x_signal + prnu_ * x_signal * x_signal;
        const float weight = frames_[k].seconds * frames_[k].seconds / variance;
        sum +=
            weight * frames_[k].exposure_of_value[c][values[k].z[c]] * frames_[k].inverse_seconds;
        weight_sum += weight;
      }
      out[c] = sum / weight_sum;
    }
    out[3] = flags == 0 ? 1.0F : 0.0F;
    return flags;
  }

  std::size_t shortest() const { return shortest_; }
  std::size_t longest() const { return longest_; }
  float read_variance(std::size_t c) const { return read_variance_[c]; }
  float shot(std::size_t c) const { return shot_[c]; }

 private:
  const std::vector<PreparedFrame>& frames_;
  std::size_t shortest_ = 0;
  std::size_t longest_ = 0;
  std::array<float, 3> read_variance_{};
  std::array<float, 3> shot_{};
  float prnu_ = 0.0F;
};

}  // namespace

Result<Measurement> Measure(std::span<const ExposedFrame> frames, const Projection& projection,
                            const Response& response, int bits, ImageView<const std::uint8_t> mask,
                            const MeasureOptions& options) {
  if (frames.empty()) return Fail(ErrorKind::kSoftware, "no frame to measure");
  constexpr std::size_t kMaxFrames = 64;
  if (frames.size() > kMaxFrames) {
    return Fail(ErrorKind::kData, "{} frames at one position, expected at most {}", frames.size(),
                kMaxFrames);
  }
  const int width = frames.front().image->width();
  const int height = frames.front().image->height();
  std::vector<PreparedFrame> prepared;
  for (const ExposedFrame& frame : frames) {
    if (frame.image->width() != width || frame.image->height() != height) {
      return Fail(ErrorKind::kData, "frames of {}x{} and {}x{} at one position, expected one size",
                  width, height, frame.image->width(), frame.image->height());
    }
    if (frame.image->channels() != 1 && frame.image->channels() != 3) {
      return Fail(ErrorKind::kData, "a frame of {} channels, expected 1 or 3",
                  frame.image->channels());
    }
    if (!frame.exposure.IsValid()) {
      return Fail(ErrorKind::kData, "exposure {} s at {} dB, expected a positive finite time",
                  frame.exposure.time.seconds(), frame.exposure.gain.value);
    }
    prepared.push_back(Prepare(frame, response, bits, options));
  }
  if (!mask.empty() && (mask.width() != width || mask.height() != height)) {
    return Fail(ErrorKind::kData, "mask of {}x{} for frames of {}x{}, expected the same size",
                mask.width(), mask.height(), width, height);
  }

  MeasureOptions resolved = options;
  if (resolved.noise.read <= 0.0) {
    double sum = 0.0;
    for (const ExposedFrame& frame : frames) {
      sum += EstimateReadNoise(*frame.image, bits, response.black(), options.noise);
    }
    resolved.noise.read = sum / static_cast<double>(frames.size());
  }

  Measurement m;
  m.projection = projection;
  m.radiance = Image<float>(width, height, 4);
  m.flags = Image<std::uint8_t>(width, height);
  const PixelMerger merger(prepared, resolved, response);
  const PreparedFrame& shortest = prepared[merger.shortest()];
  const PreparedFrame& longest = prepared[merger.longest()];
  m.shortest_exposure_s = shortest.seconds;
  m.longest_exposure_s = longest.seconds;
  for (std::size_t c = 0; c < 3; ++c) {
    m.saturation[c] = shortest.exposure_of_value[c][shortest.high] * shortest.inverse_seconds;
    const float inverse_time = longest.inverse_seconds;
    m.variance_floor[c] = merger.read_variance(c) * inverse_time * inverse_time;
    m.variance_per_radiance[c] = merger.shot(c) * inverse_time;
  }
  // SNR 1: E² = variance(E).
  const float b = m.variance_per_radiance[1];
  m.noise_floor = 0.5F * (b + std::sqrt(b * b + 4.0F * m.variance_floor[1]));

  ParallelFor(height, 16, [&](int begin, int end) {
    for (int y = begin; y < end; ++y) {
      for (int x = 0; x < width; ++x) {
        if (!mask.empty() && mask.at(x, y) < 128) {
          m.flags.at(x, y) = kMasked;
          continue;
        }
        m.flags.at(x, y) = merger.Merge(x, y, m.radiance.pixel(x, y));
      }
    }
  });
  return m;
}

}  // namespace omnihdr
