#include "core/photometry/mosaic.h"

#include <algorithm>
#include <cmath>

#include "core/base/parallel_for.h"
#include "core/base/simd.h"
#include "core/photometry/noise_estimate.h"

namespace omnihdr {
namespace {

constexpr std::size_t kMaxFrames = 64;

std::size_t ValuesOf(const DecodedImage& image, int bits) {
  return image.is_16_bit() ? std::size_t{1} << std::clamp(bits, 8, 16) : std::size_t{256};
}

// A frame's green values alone, as a grey picture of half the size; the mosaic's neighbours differ
// by colour, not by noise.
DecodedImage GreenOf(const DecodedImage& image, const Rig& rig, const std::vector<int>& rows) {
  return std::visit(
      [&](const auto& pixels) {
        using ImageType = std::decay_t<decltype(pixels)>;
        ImageType green(pixels.width() / 2, pixels.height() / 2, 1);
        for (std::size_t s = 0; s < rig.sensors.size(); ++s) {
          const int shift = BayerChannel(rig.sensors[s].bayer, 0, 0) == 1 ? 0 : 1;
          for (int y = rows[s]; y < rows[s + 1]; y += 2) {
            for (int x = 0; x < green.width(); ++x) {
              green.at(x, y / 2) = pixels.at(2 * x + shift, y);
            }
          }
        }
        return DecodedImage{std::move(green)};
      },
      image.pixels);
}

bool HasBayer(const Rig& rig) {
  return std::any_of(rig.sensors.begin(), rig.sensors.end(),
                     [](const RigSensor& s) { return s.bayer != BayerOrder::kNone; });
}

// What merging needs of one frame and sensor.
struct PreparedFrame {
  float seconds = 0.0F;
  float inverse_seconds = 0.0F;
  std::uint32_t low = 0;  // usable file values: low..high
  std::uint32_t high = 0;
  std::uint32_t largest = 0;
  std::array<std::vector<float>, 3> exposure_of_value;
  std::array<std::vector<float>, 3> radiance_of_value;  // exposure / seconds
};

PreparedFrame Prepare(const DecodedImage& image, const Exposure& exposure, const Response& response,
                      int bits, const MeasureOptions& options) {
  PreparedFrame p;
  p.seconds = static_cast<float>(exposure.EffectiveSeconds());
  p.inverse_seconds = 1.0F / p.seconds;
  const std::size_t values = ValuesOf(image, bits);
  const double scale = 255.0 / static_cast<double>(values - 1);
  for (int c = 0; c < 3; ++c) {
    std::vector<float>& table = p.exposure_of_value[static_cast<std::size_t>(c)];
    table.resize(values);
    for (std::size_t z = 0; z < values; ++z) {
      table[z] = static_cast<float>(response.ExposureFromValue(c, static_cast<double>(z) * scale));
    }
    // A value of 0 stands for light between nothing and half a step above: a quarter.
    const auto first = std::find_if(table.begin(), table.end(), [](float e) { return e > 0.0F; });
    if (first != table.end()) std::fill(table.begin(), first, 0.25F * *first);
    std::vector<float>& radiance = p.radiance_of_value[static_cast<std::size_t>(c)];
    radiance = table;
    for (float& e : radiance) e *= p.inverse_seconds;
  }
  p.low = static_cast<std::uint32_t>(std::ceil(options.value_low / scale));
  p.high =
      static_cast<std::uint32_t>(std::floor(response.HighestUsable(options.value_high) / scale));
  p.largest = static_cast<std::uint32_t>(values - 1);
  return p;
}

// One sensor's frames and its noise at the merge's slope.
struct SensorMerge {
  BayerOrder bayer = BayerOrder::kNone;
  std::vector<PreparedFrame> frames;
  std::size_t shortest = 0;
  std::size_t longest = 0;
  std::array<float, 3> read_variance{};
  std::array<float, 3> shot{};
  float prnu = 0.0F;

  std::size_t Channel(int x, int row_in_sensor) const {
    return bayer == BayerOrder::kNone
               ? 0
               : static_cast<std::size_t>(BayerChannel(bayer, x, row_in_sensor));
  }

  // `z`: the value in every frame; `excluded`: frames in which it is not to be trusted.
  std::uint8_t Merge(std::size_t c, const std::uint32_t* z, const bool* excluded,
                     float* out) const {
    float light = 0.0F;
    float time = 0.0F;
    std::size_t darkest = frames.size();  // the longest of the unsaturated
    for (std::size_t k = 0; k < frames.size(); ++k) {
      if (excluded[k]) continue;
      if (darkest == frames.size() || frames[k].seconds > frames[darkest].seconds) darkest = k;
      if (z[k] < frames[k].low) continue;
      light += frames[k].exposure_of_value[c][z[k]];
      time += frames[k].seconds;
    }
    if (darkest == frames.size()) {
      const PreparedFrame& f = frames[shortest];
      *out = f.radiance_of_value[c][z[shortest]];
      if (z[shortest] > f.high) return kMosaicSaturated;
      return z[shortest] < f.low ? kMosaicDark : kMosaicUsable;
    }
    if (time == 0.0F) {
      *out = frames[darkest].radiance_of_value[c][z[darkest]];
      return kMosaicDark;
    }
    // The variance of the signal the frames agree on, not of the single noisy value (Measure).
    const float signal = light / time;
    float sum = 0.0F;
    float weights = 0.0F;
    for (std::size_t k = 0; k < frames.size(); ++k) {
      const PreparedFrame& f = frames[k];
      if (excluded[k] || z[k] < f.low) continue;
      const float x = signal * f.seconds;
      const float weight = f.seconds * f.seconds / (read_variance[c] + shot[c] * x + prnu * x * x);
      sum += weight * f.radiance_of_value[c][z[k]];
      weights += weight;
    }
    *out = sum / weights;
    return kMosaicUsable;
  }
};

std::vector<SensorMerge> PrepareMerges(std::span<const RigFrame> frames, const Rig& rig,
                                       std::span<const Response> responses, int bits,
                                       const MeasureOptions& options,
                                       const std::vector<double>& read_noise) {
  std::vector<SensorMerge> merges(rig.sensors.size());
  for (std::size_t s = 0; s < merges.size(); ++s) {
    SensorMerge& merge = merges[s];
    const Response& response = responses[responses.size() == 1 ? 0 : s];
    merge.bayer = rig.sensors[s].bayer;
    for (const RigFrame& frame : frames) {
      merge.frames.push_back(Prepare(*frame.image, frame.ExposureOf(s), response, bits, options));
    }
    for (std::size_t k = 0; k < merge.frames.size(); ++k) {
      if (merge.frames[k].seconds < merge.frames[merge.shortest].seconds) merge.shortest = k;
      if (merge.frames[k].seconds > merge.frames[merge.longest].seconds) merge.longest = k;
    }
    const double read = read_noise[read_noise.size() == 1 ? 0 : s];
    for (std::size_t c = 0; c < 3; ++c) {
      const double slope = response.Slope(static_cast<int>(c), 128.0);
      merge.read_variance[c] = static_cast<float>((read * read + 1.0 / 12.0) * slope * slope);
      merge.shot[c] = static_cast<float>(options.noise.gain * slope);
    }
    merge.prnu = static_cast<float>(options.noise.prnu * options.noise.prnu);
  }
  return merges;
}

std::vector<MosaicNoise> NoiseOf(const std::vector<SensorMerge>& merges) {
  std::vector<MosaicNoise> noise(merges.size());
  for (std::size_t s = 0; s < merges.size(); ++s) {
    const SensorMerge& merge = merges[s];
    const PreparedFrame& shortest = merge.frames[merge.shortest];
    const PreparedFrame& longest = merge.frames[merge.longest];
    MosaicNoise& n = noise[s];
    n.shortest_exposure_s = shortest.seconds;
    n.longest_exposure_s = longest.seconds;
    for (std::size_t c = 0; c < 3; ++c) {
      n.saturation[c] = shortest.radiance_of_value[c][shortest.high];
      n.variance_floor[c] =
          merge.read_variance[c] * longest.inverse_seconds * longest.inverse_seconds;
      n.variance_per_radiance[c] = merge.shot[c] * longest.inverse_seconds;
    }
  }
  return noise;
}

// One value for the whole rig: the sensors are of one kind, and a dark one lends its estimate to a
// bright one.
std::vector<double> ReadNoiseOf(std::span<const RigFrame> frames, const Rig& rig,
                                std::span<const Response> responses, int bits,
                                const MeasureOptions& options, const std::vector<int>& rows) {
  if (options.noise.read > 0.0) return {options.noise.read};
  double sum = 0.0;
  for (const RigFrame& frame : frames) {
    const double black = responses.front().black();
    sum += HasBayer(rig)
               ? EstimateReadNoise(GreenOf(*frame.image, rig, rows), bits, black, options.noise)
               : EstimateReadNoise(*frame.image, bits, black, options.noise);
  }
  return {sum / static_cast<double>(frames.size())};
}

// A single exposure needs no weights: two tables, by the parity of the column.
template <typename T>
void LineariseRow(const T* in, int width, const float* even, const float* odd,
                  const PreparedFrame& frame, float* out, std::uint8_t* state) {
  const auto largest = static_cast<T>(frame.largest);
  for (int x = 0; x + 1 < width; x += 2) {
    out[x] = even[std::min(in[x], largest)];
    out[x + 1] = odd[std::min(in[x + 1], largest)];
  }
  if (width % 2 != 0) out[width - 1] = even[std::min(in[width - 1], largest)];
  for (int x = 0; x < width; ++x) {
    const std::uint32_t z = in[x];
    state[x] = static_cast<std::uint8_t>(static_cast<int>(z >= frame.low) +
                                         static_cast<int>(z > frame.high));
  }
}

template <typename T>
void MergeValues(const std::vector<const T*>& in, int width, int row_in_sensor,
                 const SensorMerge& merge, float* out, std::uint8_t* state) {
  std::array<std::uint32_t, kMaxFrames> z{};
  std::array<bool, kMaxFrames> excluded{};
  for (int x = 0; x < width; ++x) {
    for (std::size_t k = 0; k < in.size(); ++k) {
      z[k] = std::min<std::uint32_t>(in[k][x], merge.frames[k].largest);
      excluded[k] = z[k] > merge.frames[k].high;
    }
    state[x] = merge.Merge(merge.Channel(x, row_in_sensor), z.data(), excluded.data(), out + x);
  }
}

template <typename T>
void MergeColours(const std::vector<const T*>& in, int width, const SensorMerge& merge, float* out,
                  std::uint8_t* state) {
  std::array<std::array<std::uint32_t, kMaxFrames>, 3> z{};
  std::array<bool, kMaxFrames> excluded{};
  for (int x = 0; x < width; ++x) {
    for (std::size_t k = 0; k < in.size(); ++k) {
      excluded[k] = false;
      for (std::size_t c = 0; c < 3; ++c) {
        z[c][k] =
            std::min<std::uint32_t>(in[k][3 * x + static_cast<int>(c)], merge.frames[k].largest);
        excluded[k] = excluded[k] || z[c][k] > merge.frames[k].high;
      }
    }
    for (std::size_t c = 0; c < 3; ++c) {
      const int i = 3 * x + static_cast<int>(c);
      state[i] = merge.Merge(c, z[c].data(), excluded.data(), out + i);
    }
  }
}

template <typename T>
void MergeRows(std::span<const RigFrame> frames, const std::vector<int>& rows,
               const std::vector<SensorMerge>& merges, RadianceMosaic* mosaic) {
  const int width = mosaic->radiance.width();
  const int channels = mosaic->radiance.channels();
  ParallelFor(mosaic->radiance.height(), 16, [&](int begin, int end) {
    std::vector<const T*> in(frames.size());
    for (int y = begin; y < end; ++y) {
      const auto s = static_cast<std::size_t>(std::upper_bound(rows.begin(), rows.end(), y) -
                                              rows.begin() - 1);
      const SensorMerge& merge = merges[s];
      const int row_in_sensor = y - rows[s];
      for (std::size_t k = 0; k < frames.size(); ++k) {
        in[k] = std::get<Image<T>>(frames[k].image->pixels).row(y);
      }
      float* out = mosaic->radiance.row(y);
      std::uint8_t* state = mosaic->state.row(y);
      if (channels == 3) {
        MergeColours(in, width, merge, out, state);
      } else if (in.size() == 1) {
        const PreparedFrame& f = merge.frames.front();
        LineariseRow(in[0], width, f.radiance_of_value[merge.Channel(0, row_in_sensor)].data(),
                     f.radiance_of_value[merge.Channel(1, row_in_sensor)].data(), f, out, state);
      } else {
        MergeValues(in, width, row_in_sensor, merge, out, state);
      }
    }
  });
}

}  // namespace

Result<std::vector<int>> StackedRows(const Rig& rig) {
  std::vector<int> rows{0};
  for (const RigSensor& sensor : rig.sensors) {
    if (sensor.lens.width() != rig.sensors.front().lens.width()) {
      return Fail(ErrorKind::kData,
                  "sensor \"{}\": {} pixels wide, expected {} as sensor \"{}\": stacked sensors "
                  "have one width",
                  sensor.name, sensor.lens.width(), rig.sensors.front().lens.width(),
                  rig.sensors.front().name);
    }
    rows.push_back(rows.back() + sensor.lens.height());
  }
  return rows;
}

Status CheckRigFrames(std::span<const RigFrame> frames, const Rig& rig) {
  if (frames.empty()) return Fail(ErrorKind::kSoftware, "no frame to measure");
  if (frames.size() > kMaxFrames) {
    return Fail(ErrorKind::kData, "{} frames at one position, expected at most {}", frames.size(),
                kMaxFrames);
  }
  OMNIHDR_ASSIGN(const std::vector<int> rows, StackedRows(rig));
  const int width = rig.sensors.front().lens.width();
  const DecodedImage& first = *frames.front().image;
  for (const RigFrame& frame : frames) {
    const DecodedImage& image = *frame.image;
    if (image.width() != width || image.height() != rows.back()) {
      return Fail(ErrorKind::kData,
                  "a frame of {}x{}, expected {}x{}: {} sensors of the rig stacked", image.width(),
                  image.height(), width, rows.back(), rig.sensors.size());
    }
    if (HasBayer(rig) ? image.channels() != 1 : image.channels() != 1 && image.channels() != 3) {
      return Fail(ErrorKind::kData, "a frame of {} channels, expected {}", image.channels(),
                  HasBayer(rig) ? "1, a Bayer mosaic" : "1 or 3");
    }
    if (image.channels() != first.channels() || image.is_16_bit() != first.is_16_bit()) {
      return Fail(ErrorKind::kData,
                  "frames of different kinds at one position: {} channels of {} "
                  "bits and {} of {}, expected one kind",
                  first.channels(), first.is_16_bit() ? 16 : 8, image.channels(),
                  image.is_16_bit() ? 16 : 8);
    }
    if (frame.exposures.size() != 1 && frame.exposures.size() != rig.sensors.size()) {
      return Fail(ErrorKind::kData, "{} exposures, expected 1 or one for each of {} sensors",
                  frame.exposures.size(), rig.sensors.size());
    }
    for (const Exposure& exposure : frame.exposures) {
      if (!exposure.IsValid()) {
        return Fail(ErrorKind::kData, "exposure {} s at {} dB, expected a positive finite time",
                    exposure.time.seconds(), exposure.gain.value);
      }
    }
  }
  return {};
}

std::vector<MosaicNoise> NoiseOfRigFrames(std::span<const RigFrame> frames, const Rig& rig,
                                          std::span<const Response> responses, int bits,
                                          const MeasureOptions& options) {
  const std::vector<int> rows = StackedRows(rig).value();
  return NoiseOf(PrepareMerges(frames, rig, responses, bits, options,
                               ReadNoiseOf(frames, rig, responses, bits, options, rows)));
}

Status MergeMosaic(std::span<const RigFrame> frames, const Rig& rig,
                   std::span<const Response> responses, int bits, const MeasureOptions& options,
                   RadianceMosaic* mosaic) {
  OMNIHDR_TRY(CheckRigFrames(frames, rig));
  OMNIHDR_ASSIGN(const std::vector<int> rows, StackedRows(rig));
  const std::vector<SensorMerge> merges =
      PrepareMerges(frames, rig, responses, bits, options,
                    ReadNoiseOf(frames, rig, responses, bits, options, rows));
  const DecodedImage& first = *frames.front().image;
  const bool same_size = mosaic->radiance.width() == first.width() &&
                         mosaic->radiance.height() == first.height() &&
                         mosaic->radiance.channels() == first.channels();
  if (!same_size) {
    mosaic->radiance = Image<float>::Uninitialized(first.width(), first.height(), first.channels());
    mosaic->state =
        Image<std::uint8_t>::Uninitialized(first.width(), first.height(), first.channels());
  }
  if (first.is_16_bit()) {
    MergeRows<std::uint16_t>(frames, rows, merges, mosaic);
  } else {
    MergeRows<std::uint8_t>(frames, rows, merges, mosaic);
  }
  mosaic->noise = NoiseOf(merges);
  return {};
}

}  // namespace omnihdr
