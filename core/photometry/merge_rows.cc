#include "core/photometry/merge_rows.h"

#include <algorithm>
#include <bit>
#include <type_traits>
#include <variant>

#include "core/base/simd.h"
#include "core/photometry/measurement.h"

namespace omnihdr {
namespace {

constexpr int kLanes = 256;  // pixels in a chunk: the working set stays in the first-level cache

// Pixels of a chunk by channel, and 1 where some channel is saturated.
template <typename T>
struct Lanes {
  std::array<std::array<T, kLanes>, 3> values{};
  std::array<T, kLanes> bright{};
};

template <typename T>
OMNIHDR_ALWAYS_INLINE void SplitPixels(const T* pixels, int count, int channels, T largest, T high,
                                       Lanes<T>* __restrict out) {
  T* __restrict r = out->values[0].data();
  T* __restrict g = out->values[1].data();
  T* __restrict b = out->values[2].data();
  T* __restrict bright = out->bright.data();
  if (channels == 1) {
    for (int i = 0; i < count; ++i) {
      const T z = std::min(pixels[i], largest);
      r[i] = z;
      g[i] = z;
      b[i] = z;
      bright[i] = z > high ? 1 : 0;
    }
    return;
  }
  for (int i = 0; i < count; ++i) {
    r[i] = std::min(pixels[3 * i], largest);
    g[i] = std::min(pixels[3 * i + 1], largest);
    b[i] = std::min(pixels[3 * i + 2], largest);
  }
  for (int i = 0; i < count; ++i) bright[i] = std::max(std::max(r[i], g[i]), b[i]) > high ? 1 : 0;
}

OMNIHDR_SIMD_CLONES
void Split(const std::uint8_t* pixels, int count, int channels, std::uint8_t largest,
           std::uint8_t high, Lanes<std::uint8_t>* out) {
  SplitPixels(pixels, count, channels, largest, high, out);
}

OMNIHDR_SIMD_CLONES
void Split(const std::uint16_t* pixels, int count, int channels, std::uint16_t largest,
           std::uint16_t high, Lanes<std::uint16_t>* out) {
  SplitPixels(pixels, count, channels, largest, high, out);
}

struct Line {
  std::int32_t from = 0;
  float black = 0.0F;
  float scale = 0.0F;
  float below = 0.0F;
};

// E·t of every value.
template <typename T>
OMNIHDR_ALWAYS_INLINE void ExposeAll(const T* values, const Line& line, float* __restrict out) {
  for (int i = 0; i < kLanes; ++i) {
    const std::int32_t z = values[i];
    out[i] = z >= line.from ? (static_cast<float>(z) - line.black) * line.scale : line.below;
  }
}

// E·t of values that measure, 0 of the others; E·t itself is never 0.
template <typename T>
OMNIHDR_ALWAYS_INLINE void ExposeUsable(const T* values, const T* bright, std::int32_t low,
                                        const Line& line, float* __restrict out) {
  for (int i = 0; i < kLanes; ++i) {
    const std::int32_t z = values[i];
    const float e = z >= line.from ? (static_cast<float>(z) - line.black) * line.scale : line.below;
    out[i] = ((bright[i] == 0) & (z >= low)) ? e : 0.0F;
  }
}

OMNIHDR_SIMD_CLONES
void Expose(const std::uint8_t* values, const Line& line, float* out) {
  ExposeAll(values, line, out);
}

OMNIHDR_SIMD_CLONES
void Expose(const std::uint16_t* values, const Line& line, float* out) {
  ExposeAll(values, line, out);
}

OMNIHDR_SIMD_CLONES
void ExposeUsed(const std::uint8_t* values, const std::uint8_t* bright, std::int32_t low,
                const Line& line, float* out) {
  ExposeUsable(values, bright, low, line, out);
}

OMNIHDR_SIMD_CLONES
void ExposeUsed(const std::uint16_t* values, const std::uint16_t* bright, std::int32_t low,
                const Line& line, float* out) {
  ExposeUsable(values, bright, low, line, out);
}

template <typename T>
void ExposeByTable(const T* values, const float* table, float* __restrict out) {
  for (int i = 0; i < kLanes; ++i) out[i] = table[values[i]];
}

template <typename T>
void ExposeUsedByTable(const T* values, const T* bright, std::int32_t low, const float* table,
                       float* __restrict out) {
  for (int i = 0; i < kLanes; ++i) {
    const float e = table[values[i]];
    out[i] = ((bright[i] == 0) & (values[i] >= low)) ? e : 0.0F;
  }
}

// One frame alone: nothing to weigh.
template <typename T>
OMNIHDR_ALWAYS_INLINE void JoinFrame(const Lanes<T>& in,
                                     const std::array<std::array<float, kLanes>, 3>& exposures,
                                     std::int32_t low, std::int32_t high, float inverse_seconds,
                                     int count, float* __restrict radiance,
                                     std::uint8_t* __restrict flags) {
  for (int i = 0; i < count; ++i) {
    const auto at = static_cast<std::size_t>(i);
    std::int32_t flag = 0;
    for (std::size_t c = 0; c < 3; ++c) {
      const std::int32_t z = in.values[c][at];
      flag |= z > high ? kSaturatedR << c : 0;
      flag |= z < low ? kDarkR << c : 0;
      radiance[4 * i + static_cast<std::ptrdiff_t>(c)] = exposures[c][at] * inverse_seconds;
    }
    flags[i] = static_cast<std::uint8_t>(flag);
    radiance[4 * i + 3] = flag == 0 ? 1.0F : 0.0F;
  }
}

OMNIHDR_SIMD_CLONES
void JoinOne(const Lanes<std::uint8_t>& in,
             const std::array<std::array<float, kLanes>, 3>& exposures, std::int32_t low,
             std::int32_t high, float inverse_seconds, int count, float* radiance,
             std::uint8_t* flags) {
  JoinFrame(in, exposures, low, high, inverse_seconds, count, radiance, flags);
}

OMNIHDR_SIMD_CLONES
void JoinOne(const Lanes<std::uint16_t>& in,
             const std::array<std::array<float, kLanes>, 3>& exposures, std::int32_t low,
             std::int32_t high, float inverse_seconds, int count, float* radiance,
             std::uint8_t* flags) {
  JoinFrame(in, exposures, low, high, inverse_seconds, count, radiance, flags);
}

// One channel of one frame.
struct Input {
  const float* exposures = nullptr;  // 0 where it does not measure
  float seconds = 0.0F;              // in units of the longest exposure
};
struct Noise {
  float shot = 0.0F;  // in units of the read variance
  float prnu = 0.0F;
  float inverse_longest = 0.0F;  // 1 / seconds of the longest exposure
};
constexpr float kLeastWeight = 1e-35F;  // where no frame measures, sum and weight are 0

// 1 / x to rounding, of normal positive x below 2^126: an estimate from the exponent and three
// steps of Newton's method, in half the time of a division of vectors.
OMNIHDR_ALWAYS_INLINE float Reciprocal(float x) {
  constexpr std::uint32_t kEstimate = 0x7EF311C7U;
  float y = std::bit_cast<float>(kEstimate - std::bit_cast<std::uint32_t>(x));
  for (int step = 0; step < 3; ++step) y *= 2.0F - x * y;
  return y;
}

// The inverse-variance mean of N frames (Granados et al. 2010 with the signal of Hanji et al. 2020)
// with one reciprocal a pixel: all weights are multiplied by the product of all variances, and the
// variances by T², T the time of the frames that measure. 0 where none measures.
template <std::size_t N>
OMNIHDR_ALWAYS_INLINE void MergeFew(const Input* in, const Noise& noise, float* __restrict merged) {
  std::array<const float*, N> exposures;
  std::array<float, N> seconds;
  for (std::size_t k = 0; k < N; ++k) {
    exposures[k] = in[k].exposures;
    seconds[k] = in[k].seconds;
  }
  const Noise n = noise;
  for (int i = 0; i < kLanes; ++i) {
    std::array<float, N> x;
    std::array<float, N> t;
    float light = 0.0F;
    float time = 0.0F;
    for (std::size_t k = 0; k < N; ++k) {
      x[k] = exposures[k][i];
      t[k] = x[k] > 0.0F ? seconds[k] : 0.0F;
      light += x[k];
      time += t[k];
    }
    const float square = time * time;
    const float shot = n.shot * time * light;
    const float prnu = n.prnu * light * light;
    std::array<float, N> variance;
    for (std::size_t k = 0; k < N; ++k) variance[k] = square + t[k] * (shot + t[k] * prnu);
    float sum = 0.0F;
    float weight_sum = 0.0F;
    for (std::size_t k = 0; k < N; ++k) {
      float weight = t[k];
      for (std::size_t j = 0; j < N; ++j) {
        if (j != k) weight *= variance[j];
      }
      sum += weight * x[k];
      weight_sum += weight * t[k];
    }
    merged[i] = sum * n.inverse_longest * Reciprocal(std::max(weight_sum, kLeastWeight));
  }
}

OMNIHDR_SIMD_CLONES
void MergeTwo(const Input* in, const Noise& noise, float* merged) {
  MergeFew<2>(in, noise, merged);
}

OMNIHDR_SIMD_CLONES
void MergeThree(const Input* in, const Noise& noise, float* merged) {
  MergeFew<3>(in, noise, merged);
}

OMNIHDR_SIMD_CLONES
void AddLight(const Input& in, float* __restrict light, float* __restrict time) {
  const Input one = in;
  for (int i = 0; i < kLanes; ++i) {
    light[i] += one.exposures[i];
    time[i] += one.exposures[i] > 0.0F ? one.seconds : 0.0F;
  }
}

OMNIHDR_SIMD_CLONES
void AddByVariance(const Input& in, const Noise& noise, const float* light, const float* time,
                   float* __restrict sum, float* __restrict weight_sum) {
  const Input one = in;
  const Noise n = noise;
  for (int i = 0; i < kLanes; ++i) {
    const float exposure = one.exposures[i];
    const float used = exposure > 0.0F ? one.seconds : 0.0F;
    const float signal = light[i] / std::max(time[i], kLeastWeight) * one.seconds;
    const float weight = used / (1.0F + signal * (n.shot + n.prnu * signal));
    sum[i] += weight * exposure;
    weight_sum[i] += weight * one.seconds;
  }
}

template <typename T>
OMNIHDR_ALWAYS_INLINE void AddHat(const Input& in, const T* values, std::int32_t largest,
                                  float* __restrict sum, float* __restrict weight_sum) {
  const float inverse_seconds = 1.0F / in.seconds;
  const float scale = 1.0F / static_cast<float>(largest);
  for (int i = 0; i < kLanes; ++i) {
    const std::int32_t z = values[i];
    const std::int32_t hat = std::max(1, std::min(z, largest - z));
    const float weight = in.exposures[i] > 0.0F ? scale * static_cast<float>(hat) : 0.0F;
    sum[i] += weight * in.exposures[i] * inverse_seconds;
    weight_sum[i] += weight;
  }
}

OMNIHDR_SIMD_CLONES
void AddByHat(const Input& in, const std::uint8_t* values, std::int32_t largest, float* sum,
              float* weight_sum) {
  AddHat(in, values, largest, sum, weight_sum);
}

OMNIHDR_SIMD_CLONES
void AddByHat(const Input& in, const std::uint16_t* values, std::int32_t largest, float* sum,
              float* weight_sum) {
  AddHat(in, values, largest, sum, weight_sum);
}

OMNIHDR_SIMD_CLONES
void Divide(const float* sum, const float* weight, float factor, float* __restrict merged) {
  for (int i = 0; i < kLanes; ++i) merged[i] = sum[i] / std::max(weight[i], kLeastWeight) * factor;
}

// Flags a channel that no frame measures as dark.
OMNIHDR_SIMD_CLONES
void Join(const float* r, const float* g, const float* b, int count, float* __restrict radiance,
          std::uint8_t* __restrict flags) {
  for (int i = 0; i < count; ++i) {
    const std::int32_t flag =
        (r[i] > 0.0F ? 0 : kDarkR) | (g[i] > 0.0F ? 0 : kDarkG) | (b[i] > 0.0F ? 0 : kDarkB);
    flags[i] = static_cast<std::uint8_t>(flag);
    radiance[4 * i] = r[i];
    radiance[4 * i + 1] = g[i];
    radiance[4 * i + 2] = b[i];
    radiance[4 * i + 3] = flag == 0 ? 1.0F : 0.0F;
  }
}

Line LineOf(const ExposureTable& table, std::size_t c) {
  return {table.linear_from, table.linear_black, table.linear_scale[c], table.exposure[c].front()};
}

std::int32_t ValueAt(const FramePlan& frame, int x, int y, std::size_t c) {
  return std::visit(
      [&](const auto& image) {
        const std::int32_t z = image.pixel(x, y)[image.channels() == 3 ? c : 0];
        return std::min(z, frame.table->largest);
      },
      frame.image->pixels);
}

bool IsBright(const FramePlan& frame, int x, int y) {
  for (std::size_t c = 0; c < 3; ++c) {
    if (ValueAt(frame, x, y, c) > frame.table->high) return true;
  }
  return false;
}

float ExposureAt(const FramePlan& frame, int x, int y, std::size_t c) {
  return frame.table->exposure[c][static_cast<std::size_t>(ValueAt(frame, x, y, c))];
}

// Saturated in every frame: the shortest exposure speaks, with what it measured and with bounds.
// `shortest`: how many frames have it.
void MergeBlinded(const MergePlan& plan, std::size_t shortest, int x, int y, float* rgb,
                  std::uint8_t* flags) {
  int flag = 0;
  for (std::size_t c = 0; c < 3; ++c) {
    float sum = 0.0F;
    float bound = 0.0F;
    int measured = 0;
    bool is_dark = false;
    for (std::size_t k = 0; k < shortest; ++k) {
      const FramePlan& frame = plan.frames[k];
      const std::int32_t z = ValueAt(frame, x, y, c);
      const float e = ExposureAt(frame, x, y, c);
      bound = std::max(bound, e);
      if (z > frame.table->high) continue;
      sum += e;
      ++measured;
      is_dark = is_dark || z < frame.table->low;
    }
    rgb[c] = (measured > 0 ? sum / static_cast<float>(measured) : bound) *
             plan.frames[0].inverse_seconds;
    if (measured == 0) flag |= kSaturatedR << c;
    if (is_dark) flag |= kDarkR << c;
  }
  *flags = static_cast<std::uint8_t>(flag);
  rgb[3] = flag == 0 ? 1.0F : 0.0F;
}

// Dark wherever it is not saturated: the longest of those exposures says most, several averaged.
float MergeDark(const MergePlan& plan, std::size_t longest, int x, int y, std::size_t c) {
  const float seconds = plan.frames[longest].seconds;
  float sum = 0.0F;
  int count = 0;
  for (std::size_t k = longest + 1; k-- > 0 && plan.frames[k].seconds == seconds;) {
    if (IsBright(plan.frames[k], x, y)) continue;
    sum += ExposureAt(plan.frames[k], x, y, c);
    ++count;
  }
  return sum / static_cast<float>(count) * plan.frames[longest].inverse_seconds;
}

}  // namespace

// One frame's chunk in its own depth.
struct RowMerger::Chunk {
  std::variant<Lanes<std::uint8_t>, Lanes<std::uint16_t>> lanes;
  std::array<std::array<float, kLanes>, 3> exposures{};
};

RowMerger::RowMerger(const MergePlan& plan) : plan_(plan) {
  for (const FramePlan& frame : plan.frames) {
    Chunk& chunk = *chunks_.emplace_back(std::make_unique<Chunk>());
    if (frame.image->is_16_bit()) chunk.lanes.emplace<Lanes<std::uint16_t>>();
  }
  while (shortest_ < plan.frames.size() &&
         plan.frames[shortest_].seconds == plan.frames[0].seconds) {
    ++shortest_;
  }
  constexpr float kLargestRatio = 1e4F;
  constexpr float kLargestExposure = 1e3F;
  is_well_scaled_ = plan.frames.back().seconds <= kLargestRatio * plan.frames.front().seconds;
  for (const FramePlan& frame : plan.frames) {
    for (const std::vector<float>& table : frame.table->exposure) {
      is_well_scaled_ = is_well_scaled_ && table.back() <= kLargestExposure &&
                        table.front() >= 1e-6F / kLargestExposure;
    }
  }
}

RowMerger::~RowMerger() = default;

void RowMerger::Read(std::size_t k, int y, int x, int count) {
  const FramePlan& frame = plan_.frames[k];
  const ExposureTable& table = *frame.table;
  Chunk& chunk = *chunks_[k];
  const bool alone = chunks_.size() == 1;
  std::visit(
      [&](auto& lanes) {
        using T = std::decay_t<decltype(lanes.bright[0])>;
        const Image<T>& image = std::get<Image<T>>(frame.image->pixels);
        Split(image.pixel(x, y), count, image.channels(), static_cast<T>(table.largest),
              static_cast<T>(table.high), &lanes);
        for (std::size_t c = 0; c < 3; ++c) {
          const T* values = lanes.values[c].data();
          const T* bright = lanes.bright.data();
          const float* exposure = table.exposure[c].data();
          float* out = chunk.exposures[c].data();
          if (table.is_linear) {
            const Line line = LineOf(table, c);
            if (alone) {
              Expose(values, line, out);
            } else {
              ExposeUsed(values, bright, table.low, line, out);
            }
          } else if (alone) {
            ExposeByTable(values, exposure, out);
          } else {
            ExposeUsedByTable(values, bright, table.low, exposure, out);
          }
        }
      },
      chunk.lanes);
}

void RowMerger::Combine(std::size_t c) {
  const std::size_t count = chunks_.size();
  const FramePlan& longest = plan_.frames.back();
  const auto input = [&](std::size_t k) {
    return Input{chunks_[k]->exposures[c].data(),
                 plan_.frames[k].seconds * longest.inverse_seconds};
  };
  const Noise noise = {plan_.shot[c] / plan_.read[c], plan_.prnu / plan_.read[c],
                       longest.inverse_seconds};
  float* merged = merged_[c].data();
  const bool by_variance = plan_.weights == MergeWeights::kInverseVariance;
  if (by_variance && is_well_scaled_ && count <= 3) {
    const std::array<Input, 3> in = {input(0), input(1), input(count - 1)};
    if (count == 2) {
      MergeTwo(in.data(), noise, merged);
    } else {
      MergeThree(in.data(), noise, merged);
    }
    return;
  }
  std::array<float, kLanes> light{};
  std::array<float, kLanes> time{};
  std::array<float, kLanes> sum{};
  std::array<float, kLanes> weight{};
  if (by_variance) {
    for (std::size_t k = 0; k < count; ++k) AddLight(input(k), light.data(), time.data());
    for (std::size_t k = 0; k < count; ++k) {
      AddByVariance(input(k), noise, light.data(), time.data(), sum.data(), weight.data());
    }
  } else {
    for (std::size_t k = 0; k < count; ++k) {
      std::visit(
          [&](const auto& lanes) {
            AddByHat(input(k), lanes.values[c].data(), plan_.frames[k].table->largest, sum.data(),
                     weight.data());
          },
          chunks_[k]->lanes);
    }
  }
  Divide(sum.data(), weight.data(), longest.inverse_seconds, merged);
}

void RowMerger::MergeUnmeasured(int x, int y, float* rgb, std::uint8_t* flags) const {
  std::size_t longest = plan_.frames.size();
  while (longest > 0 && IsBright(plan_.frames[longest - 1], x, y)) --longest;
  if (longest == 0) {
    MergeBlinded(plan_, shortest_, x, y, rgb, flags);
    return;
  }
  for (std::size_t c = 0; c < 3; ++c) {
    if ((*flags & (kDarkR << c)) != 0) rgb[c] = MergeDark(plan_, longest - 1, x, y, c);
  }
}

void RowMerger::Merge(int y, float* radiance, std::uint8_t* flags) {
  const int width = plan_.frames.front().image->width();
  for (int x = 0; x < width; x += kLanes) {
    const int count = std::min(kLanes, width - x);
    for (std::size_t k = 0; k < chunks_.size(); ++k) Read(k, y, x, count);
    float* out = radiance + std::ptrdiff_t{4} * x;
    if (chunks_.size() == 1) {
      const FramePlan& frame = plan_.frames.front();
      std::visit(
          [&](const auto& lanes) {
            JoinOne(lanes, chunks_[0]->exposures, frame.table->low, frame.table->high,
                    frame.inverse_seconds, count, out, flags + x);
          },
          chunks_[0]->lanes);
      continue;
    }
    for (std::size_t c = 0; c < 3; ++c) Combine(c);
    Join(merged_[0].data(), merged_[1].data(), merged_[2].data(), count, out, flags + x);
    for (int i = 0; i < count; ++i) {
      if (flags[x + i] != 0) MergeUnmeasured(x + i, y, out + std::ptrdiff_t{4} * i, flags + x + i);
    }
  }
}

}  // namespace omnihdr
