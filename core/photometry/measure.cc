#include "core/photometry/measure.h"

#include <algorithm>
#include <cmath>
#include <optional>
#include <vector>

#include "core/base/parallel_for.h"
#include "core/photometry/merge_rows.h"
#include "core/photometry/noise_estimate.h"

namespace omnihdr {
namespace {

// E·t of a value, finite where the curve overflows.
double BoundedExposure(const Response& response, int channel, double value) {
  constexpr double kLargest = 1e9;  // times that of value 128
  const double e = response.ExposureFromValue(channel, value);
  return e < kLargest ? e : kLargest;
}

ExposureTable MakeTable(const Response& response, int bits, const MeasureOptions& options) {
  ExposureTable t;
  const std::size_t values = std::size_t{1} << bits;
  const double value_scale = 255.0 / static_cast<double>(values - 1);
  t.largest = static_cast<std::int32_t>(values - 1);
  t.low = static_cast<std::int32_t>(std::ceil(options.value_low / value_scale));
  t.high = static_cast<std::int32_t>(
      std::floor(response.HighestUsable(options.value_high) / value_scale));
  for (std::size_t c = 0; c < 3; ++c) {
    std::vector<float>& table = t.exposure[c];
    table.resize(values);
    for (std::size_t z = 0; z < values; ++z) {
      const double e =
          BoundedExposure(response, static_cast<int>(c), static_cast<double>(z) * value_scale);
      table[z] = static_cast<float>(options.white_balance[c] * e);
    }
    // A value of 0 stands for light between nothing and half a step above: a quarter, never "none".
    const auto first = std::find_if(table.begin(), table.end(), [](float e) { return e > 0.0F; });
    if (first != table.end()) std::fill(table.begin(), first, 0.25F * *first);
    if (response.model() == ResponseModel::kLinear) {
      t.linear_from = static_cast<std::int32_t>(first - table.begin());
      t.linear_scale[c] = static_cast<float>(
          options.white_balance[c] * response.Slope(static_cast<int>(c), 128.0) * value_scale);
    }
  }
  t.is_linear = response.model() == ResponseModel::kLinear;
  t.linear_black = static_cast<float>(response.black() / value_scale);
  return t;
}

}  // namespace

Status CheckFrames(std::span<const ExposedFrame> frames, ImageView<const std::uint8_t> mask) {
  if (frames.empty()) return Fail(ErrorKind::kSoftware, "no frame to measure");
  constexpr std::size_t kMaxFrames = 64;
  if (frames.size() > kMaxFrames) {
    return Fail(ErrorKind::kData, "{} frames at one position, expected at most {}", frames.size(),
                kMaxFrames);
  }
  const int width = frames.front().image->width();
  const int height = frames.front().image->height();
  for (const ExposedFrame& frame : frames) {
    if (frame.image->width() != width || frame.image->height() != height) {
      return Fail(ErrorKind::kData, "frames of {}x{} and {}x{} at one position, expected one size",
                  width, height, frame.image->width(), frame.image->height());
    }
    if (frame.image->channels() != 1 && frame.image->channels() != 3) {
      return Fail(ErrorKind::kData, "a frame of {} channels, expected 1 or 3",
                  frame.image->channels());
    }
    constexpr double kShortest = 1e-9;
    constexpr double kLongest = 1e6;
    const double seconds = frame.exposure.EffectiveSeconds();
    if (!frame.exposure.IsValid() || !(seconds >= kShortest && seconds <= kLongest)) {
      return Fail(ErrorKind::kData, "exposure {} s at {} dB, expected {} to {} s at 0 dB",
                  frame.exposure.time.seconds(), frame.exposure.gain.value, kShortest, kLongest);
    }
  }
  if (!mask.empty() && (mask.width() != width || mask.height() != height)) {
    return Fail(ErrorKind::kData, "mask of {}x{} for frames of {}x{}, expected the same size",
                mask.width(), mask.height(), width, height);
  }
  return {};
}

Result<Measurement> Measure(std::span<const ExposedFrame> frames, const Projection& projection,
                            const Response& response, int bits, ImageView<const std::uint8_t> mask,
                            const MeasureOptions& options) {
  OMNIHDR_TRY(CheckFrames(frames, mask));
  NoiseModel noise = options.noise;
  if (noise.read <= 0.0) {
    double sum = 0.0;
    for (const ExposedFrame& frame : frames) {
      sum += EstimateReadNoise(*frame.image, bits, response.black(), options.noise);
    }
    noise.read = sum / static_cast<double>(frames.size());
  }
  // One table serves all frames of a bit depth.
  std::optional<ExposureTable> narrow;
  std::optional<ExposureTable> wide;
  MergePlan plan;
  plan.weights = options.weights;
  for (const ExposedFrame& frame : frames) {
    std::optional<ExposureTable>& table = frame.image->is_16_bit() ? wide : narrow;
    if (!table) {
      table = MakeTable(response, frame.image->is_16_bit() ? std::clamp(bits, 8, 16) : 8, options);
    }
    const auto seconds = static_cast<float>(frame.exposure.EffectiveSeconds());
    plan.frames.push_back({frame.image, &*table, seconds, 1.0F / seconds});
  }
  std::stable_sort(plan.frames.begin(), plan.frames.end(),
                   [](const FramePlan& a, const FramePlan& b) { return a.seconds < b.seconds; });
  plan.prnu = static_cast<float>(noise.prnu * noise.prnu);
  for (std::size_t c = 0; c < 3; ++c) {
    // A curve that is flat where it is judged would be a sensor without noise.
    const auto channel = static_cast<int>(c);
    const double slope = response.model() == ResponseModel::kLinear
                             ? response.Slope(channel, 128.0)
                             : std::max(BoundedExposure(response, channel, 128.5) -
                                            BoundedExposure(response, channel, 127.5),
                                        1e-4 * BoundedExposure(response, channel, 255.0));
    const double balanced = options.white_balance[c] * slope;
    plan.read[c] = static_cast<float>((noise.read * noise.read + 1.0 / 12.0) * balanced * balanced);
    plan.shot[c] = static_cast<float>(noise.gain * balanced);
  }

  Measurement m;
  m.projection = projection;
  const int width = frames.front().image->width();
  const int height = frames.front().image->height();
  m.radiance = Image<float>::Uninitialized(width, height, 4);
  m.flags = Image<std::uint8_t>::Uninitialized(width, height);
  const FramePlan& shortest = plan.frames.front();
  const FramePlan& longest = plan.frames.back();
  m.shortest_exposure_s = shortest.seconds;
  m.longest_exposure_s = longest.seconds;
  for (std::size_t c = 0; c < 3; ++c) {
    const std::vector<float>& table = shortest.table->exposure[c];
    m.saturation[c] =
        table[static_cast<std::size_t>(shortest.table->high)] * shortest.inverse_seconds;
    const float inverse_time = longest.inverse_seconds;
    m.variance_floor[c] = plan.read[c] * inverse_time * inverse_time;
    m.variance_per_radiance[c] = plan.shot[c] * inverse_time;
  }
  // SNR 1: E² = variance(E).
  const float b = m.variance_per_radiance[1];
  m.noise_floor = 0.5F * (b + std::sqrt(b * b + 4.0F * m.variance_floor[1]));

  ParallelFor(height, 16, [&](int begin, int end) {
    RowMerger merger(plan);
    for (int y = begin; y < end; ++y) {
      float* radiance = m.radiance.row(y);
      std::uint8_t* flags = m.flags.row(y);
      merger.Merge(y, radiance, flags);
      if (mask.empty()) continue;
      for (int x = 0; x < width; ++x) {
        if (mask.at(x, y) >= 128) continue;
        flags[x] = kMasked;
        std::fill_n(radiance + std::ptrdiff_t{4} * x, 4, 0.0F);
      }
    }
  });
  return m;
}

}  // namespace omnihdr
