#include "core/photometry/stitch_kernels.h"

#include <algorithm>
#include <cstring>

#include "core/photometry/measurement.h"
#include "core/photometry/mosaic.h"
#include "core/photometry/stitch_table.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/photometry/stitch_kernels.cc"
#include <hwy/foreach_target.h>
//
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace omnihdr {
namespace HWY_NAMESPACE {
namespace hn = hwy::HWY_NAMESPACE;

using F = hn::ScalableTag<float>;
using U = hn::RebindToUnsigned<F>;
using I = hn::RebindToSigned<F>;
using VF = hn::Vec<F>;
using VU = hn::Vec<U>;
using VI = hn::Vec<I>;

// Four bytes at `bytes` + offset, unaligned.
HWY_INLINE VU GatherBytes(const std::uint8_t* bytes, VI offset) {
  const U du;
  return hn::GatherOffset(du, reinterpret_cast<const std::uint32_t*>(bytes), offset);
}

// The larger of each byte of the words.
HWY_INLINE VU MaxBytes(VU a, VU b) {
#if HWY_TARGET == HWY_SCALAR
  std::uint32_t most = 0;
  for (unsigned shift = 0; shift < 32U; shift += 8U) {
    most |= std::max(a.raw >> shift & 255U, b.raw >> shift & 255U) << shift;
  }
  return hn::Set(U(), most);
#else
  const hn::Repartition<std::uint8_t, U> d8;
  return hn::BitCast(U(), hn::Max(hn::BitCast(d8, a), hn::BitCast(d8, b)));
#endif
}

// The four values of a row of the block, and those values' states or counts as bytes of a word.
struct ByteRows {
  const std::uint8_t* base;
  std::ptrdiff_t stride;
  VI offset;

  HWY_INLINE VU Word(int row) const { return GatherBytes(base + row * stride, offset); }
  HWY_INLINE void Values(int /*row*/, VU word, VF (&value)[4]) const {
    const F d;
    const I di;
    const U du;
    const VU mask = hn::Set(du, 255U);
    value[0] = hn::ConvertTo(d, hn::BitCast(di, hn::And(word, mask)));
    value[1] = hn::ConvertTo(d, hn::BitCast(di, hn::And(hn::ShiftRight<8>(word), mask)));
    value[2] = hn::ConvertTo(d, hn::BitCast(di, hn::And(hn::ShiftRight<16>(word), mask)));
    value[3] = hn::ConvertTo(d, hn::BitCast(di, hn::ShiftRight<24>(word)));
  }
};

struct MosaicRows {
  const float* radiance;
  const std::uint8_t* state;
  std::ptrdiff_t stride;
  VI offset;

  HWY_INLINE VU Word(int row) const { return GatherBytes(state + row * stride, offset); }
  HWY_INLINE void Values(int row, VU /*word*/, VF (&value)[4]) const {
    const F d;
    const float* from = radiance + row * stride;
    value[0] = hn::GatherIndex(d, from, offset);
    value[1] = hn::GatherIndex(d, from + 1, offset);
    value[2] = hn::GatherIndex(d, from + 2, offset);
    value[3] = hn::GatherIndex(d, from + 3, offset);
  }
};

struct Planes {
  VF value[4];  // of the tile's places, row by row
  VU most[4];   // largest byte of those taken
};

// The tile's four places, each bilinear at its own density.
template <typename Rows>
HWY_INLINE Planes Interpolate(const Rows& rows, VU packed) {
  const F d;
  const I di;
  const U du;
  const VF one = hn::Set(d, 1.0F);
  const VF half = hn::Set(d, 0.5F);
  const VF step = hn::Set(d, 1.0F / 512.0F);
  const VU byte = hn::Set(du, 255U);
  // Half the fraction: the distance between values of one place is two pixels.
  const VF hx = hn::Mul(hn::ConvertTo(d, hn::BitCast(di, hn::And(packed, byte))), step);
  const VF hy =
      hn::Mul(hn::ConvertTo(d, hn::BitCast(di, hn::And(hn::ShiftRight<8>(packed), byte))), step);
  const VF wx[4] = {hn::Sub(half, hx), hn::Sub(one, hx), hn::Add(half, hx), hx};
  const VF wy[4] = {hn::Sub(half, hy), hn::Sub(one, hy), hn::Add(half, hy), hy};

  VF sum[4];   // [row place][column place]
  VU most[2];  // of rows 0, 2 and 1, 3: columns in bytes
  for (int row = 0; row < 4; ++row) {
    const VU word = rows.Word(row);
    VF value[4];
    rows.Values(row, word, value);
    const VF a = hn::MulAdd(wx[2], value[2], hn::Mul(wx[0], value[0]));
    const VF b = hn::MulAdd(wx[3], value[3], hn::Mul(wx[1], value[1]));
    const int place = row & 1;
    if (row < 2) {
      sum[2 * place] = hn::Mul(wy[row], a);
      sum[2 * place + 1] = hn::Mul(wy[row], b);
      most[place] = word;
    } else {
      sum[2 * place] = hn::MulAdd(wy[row], a, sum[2 * place]);
      sum[2 * place + 1] = hn::MulAdd(wy[row], b, sum[2 * place + 1]);
      most[place] = MaxBytes(most[place], word);
    }
  }
  VU byte_most[4];
  for (int place = 0; place < 2; ++place) {
    const VU folded = MaxBytes(most[place], hn::ShiftRight<16>(most[place]));
    byte_most[2 * place] = hn::And(folded, byte);
    byte_most[2 * place + 1] = hn::And(hn::ShiftRight<8>(folded), byte);
  }
  // From places in the block to places in the tile.
  const auto odd_column = hn::MaskFromVec(
      hn::BitCast(d, hn::BroadcastSignBit(hn::BitCast(di, hn::ShiftLeft<1>(packed)))));
  const auto odd_row =
      hn::MaskFromVec(hn::BitCast(d, hn::BroadcastSignBit(hn::BitCast(di, packed))));
  Planes planes;
  VF column_value[4];
  VF column_most[4];
  for (int k = 0; k < 4; ++k) {
    column_value[k] = hn::IfThenElse(odd_column, sum[k ^ 1], sum[k]);
    column_most[k] =
        hn::IfThenElse(odd_column, hn::BitCast(d, byte_most[k ^ 1]), hn::BitCast(d, byte_most[k]));
  }
  for (int k = 0; k < 4; ++k) {
    planes.value[k] = hn::IfThenElse(odd_row, column_value[k ^ 2], column_value[k]);
    planes.most[k] = hn::BitCast(du, hn::IfThenElse(odd_row, column_most[k ^ 2], column_most[k]));
  }
  return planes;
}

struct Limits {
  std::uint32_t low = kMosaicUsable;  // usable: low..high
  std::uint32_t high = kMosaicUsable;
  float black = 0.0F;
  float least = 0.0F;
};

HWY_INLINE VU FlagBits(VU most, VU low, VU high, std::uint32_t saturated, std::uint32_t dark) {
  const U du;
  const I di;
  const VI m = hn::BitCast(di, most);
  const auto above = hn::RebindMask(du, hn::Gt(m, hn::BitCast(di, high)));
  const auto below = hn::RebindMask(du, hn::Lt(m, hn::BitCast(di, low)));
  return hn::Or(hn::IfThenElseZero(above, hn::Set(du, saturated)),
                hn::IfThenElseZero(below, hn::Set(du, dark)));
}

template <typename MakeRows>
HWY_INLINE void StitchAll(const MakeRows& make_rows, const Limits& limits,
                          const StitchSamples& samples, const StitchScale& scale, float* rgba,
                          std::uint8_t* flags) {
  const F d;
  const U du;
  const I di;
  const hn::Rebind<std::uint8_t, I> d8;
  const int lanes = static_cast<int>(hn::Lanes(d));
  const VU low = hn::Set(du, limits.low);
  const VU high = hn::Set(du, limits.high);
  const VF black = hn::Set(d, limits.black);
  const VF least = hn::Set(d, limits.least);
  const VF half = hn::Set(d, 0.5F);
  const VF one = hn::Set(d, 1.0F);
  const int green_1 = scale.red == 0 || scale.red == 3 ? 1 : 0;
  const int green_2 = 3 - green_1;
  HWY_ALIGN float tail_rgba[4 * HWY_MAX_BYTES / sizeof(float)];
  HWY_ALIGN std::uint8_t tail_flags[HWY_MAX_BYTES];
  for (int x = 0; x < samples.count; x += lanes) {
    const VU packed = hn::LoadU(du, samples.packed + x);
    const VI offset = hn::BitCast(di, hn::LoadU(du, samples.block + x));
    const VF shade = hn::LoadU(d, samples.shade + x);
    const Planes planes = Interpolate(make_rows(offset), packed);
    const VF green = hn::Mul(half, hn::Add(planes.value[green_1], planes.value[green_2]));
    const auto radiance = [&](VF value, float factor) HWY_ATTR {
      return hn::Mul(hn::Max(hn::Sub(value, black), least), hn::Mul(shade, hn::Set(d, factor)));
    };
    const VF r = radiance(planes.value[scale.red], scale.scale[0]);
    const VF g = radiance(green, scale.scale[1]);
    const VF b = radiance(planes.value[scale.blue], scale.scale[2]);
    const VU most_green = hn::Max(planes.most[green_1], planes.most[green_2]);
    const VU bits =
        hn::Or(FlagBits(planes.most[scale.red], low, high, kSaturatedR, kDarkR),
               hn::Or(FlagBits(most_green, low, high, kSaturatedG, kDarkG),
                      FlagBits(planes.most[scale.blue], low, high, kSaturatedB, kDarkB)));
    const VF usable = hn::IfThenElseZero(hn::RebindMask(d, hn::Eq(bits, hn::Zero(du))), one);
    const bool whole = x + lanes <= samples.count;
    hn::StoreInterleaved4(r, g, b, usable, d, whole ? rgba + 4 * x : tail_rgba);
    hn::StoreU(hn::DemoteTo(d8, hn::BitCast(di, bits)), d8, whole ? flags + x : tail_flags);
    if (!whole) {
      const auto rest = static_cast<std::size_t>(samples.count - x);
      std::memcpy(rgba + 4 * x, tail_rgba, 4 * rest * sizeof(float));
      std::memcpy(flags + x, tail_flags, rest);
    }
  }
}

void StitchMosaicRow(const float* radiance, const std::uint8_t* state, std::ptrdiff_t stride,
                     const StitchSamples& samples, const StitchScale& scale, float* rgba,
                     std::uint8_t* flags) {
  StitchAll(
      [&](VI offset) HWY_ATTR {
        return MosaicRows{radiance, state, stride, offset};
      },
      Limits{}, samples, scale, rgba, flags);
}

void StitchBytesRow(const std::uint8_t* bytes, std::ptrdiff_t stride, float black,
                    std::uint32_t low, std::uint32_t high, const StitchSamples& samples,
                    const StitchScale& scale, float* rgba, std::uint8_t* flags) {
  StitchAll(
      [&](VI offset) HWY_ATTR {
        return ByteRows{bytes, stride, offset};
      },
      Limits{low, high, black, 0.25F}, samples, scale, rgba, flags);
}

}  // namespace HWY_NAMESPACE
}  // namespace omnihdr
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace omnihdr {
namespace {

HWY_EXPORT(StitchMosaicRow);
HWY_EXPORT(StitchBytesRow);

constexpr std::array<std::uint8_t, 3> kSaturatedBit = {kSaturatedR, kSaturatedG, kSaturatedB};
constexpr std::array<std::uint8_t, 3> kDarkBit = {kDarkR, kDarkG, kDarkB};

}  // namespace

void StitchMosaic(const float* radiance, const std::uint8_t* state, std::ptrdiff_t stride,
                  const StitchSamples& samples, const StitchScale& scale, float* rgba,
                  std::uint8_t* flags) {
  HWY_DYNAMIC_DISPATCH(StitchMosaicRow)(radiance, state, stride, samples, scale, rgba, flags);
}

void StitchBytes(const std::uint8_t* bytes, std::ptrdiff_t stride, float black, std::uint32_t low,
                 std::uint32_t high, const StitchSamples& samples, const StitchScale& scale,
                 float* rgba, std::uint8_t* flags) {
  HWY_DYNAMIC_DISPATCH(StitchBytesRow)
  (bytes, stride, black, low, high, samples, scale, rgba, flags);
}

void StitchColour(const float* radiance, const std::uint8_t* state, std::ptrdiff_t stride,
                  int channels, const StitchSamples& samples, const StitchScale& scale, float* rgba,
                  std::uint8_t* flags) {
  for (int x = 0; x < samples.count; ++x) {
    const std::uint32_t packed = samples.packed[x];
    const float fx = static_cast<float>(packed & 255U) * (1.0F / 256.0F);
    const float fy = static_cast<float>(packed >> 8U & 255U) * (1.0F / 256.0F);
    const std::ptrdiff_t first =
        static_cast<std::ptrdiff_t>(samples.block[x]) * channels + stride + channels;
    const std::array<std::ptrdiff_t, 4> at = {first, first + channels, first + stride,
                                              first + stride + channels};
    const std::array<float, 4> weight = {(1.0F - fx) * (1.0F - fy), fx * (1.0F - fy),
                                         (1.0F - fx) * fy, fx * fy};
    std::uint8_t bits = 0;
    float* out = rgba + 4 * x;
    for (std::size_t c = 0; c < 3; ++c) {
      const std::ptrdiff_t channel = channels == 3 ? static_cast<std::ptrdiff_t>(c) : 0;
      float sum = 0.0F;
      std::uint8_t most = 0;
      for (std::size_t k = 0; k < 4; ++k) {
        sum += weight[k] * radiance[at[k] + channel];
        most = std::max(most, state[at[k] + channel]);
      }
      out[c] = sum * samples.shade[x] * scale.scale[c];
      if (most == kMosaicSaturated) bits = static_cast<std::uint8_t>(bits | kSaturatedBit[c]);
      if (most == kMosaicDark) bits = static_cast<std::uint8_t>(bits | kDarkBit[c]);
    }
    out[3] = bits == 0 ? 1.0F : 0.0F;
    flags[x] = bits;
  }
}

void BlendSamples(const float* rgba, const std::uint8_t* flags, const std::uint32_t* const* packed,
                  int sensors, int count, float* out_rgba, std::uint8_t* out_flags) {
  for (int x = 0; x < count; ++x) {
    std::uint8_t any = 0;
    for (int k = 0; k < sensors; ++k) any = static_cast<std::uint8_t>(any | flags[k * count + x]);
    float* out = out_rgba + 4 * x;
    if ((any & kSaturatedAny) == 0) {
      std::array<float, 4> sum{};
      float shares = 0.0F;
      for (int k = 0; k < sensors; ++k) {
        const auto share = static_cast<float>(ShareOf(packed[k][x]));
        const float* in = rgba + 4 * (k * count + x);
        for (std::size_t c = 0; c < 4; ++c) sum[c] += share * in[c];
        shares += share;
      }
      const float inverse = 1.0F / shares;
      for (std::size_t c = 0; c < 3; ++c) out[c] = sum[c] * inverse;
      out[3] = any == 0 ? 1.0F : 0.0F;
      out_flags[x] = any;
      continue;
    }
    bool some_clean = false;
    for (int k = 0; k < sensors; ++k) {
      some_clean = some_clean || (flags[k * count + x] & kSaturatedAny) == 0;
    }
    std::uint8_t bits = 0;
    for (std::size_t c = 0; c < 3; ++c) {
      float sum = 0.0F;
      float shares = 0.0F;
      float bound = 0.0F;
      for (int k = 0; k < sensors; ++k) {
        const std::uint8_t f = flags[k * count + x];
        const float value = rgba[4 * (k * count + x) + static_cast<int>(c)];
        if (some_clean ? (f & kSaturatedAny) != 0 : (f & kSaturatedBit[c]) != 0) {
          bound = std::max(bound, value);
          continue;
        }
        const auto share = static_cast<float>(ShareOf(packed[k][x]));
        sum += share * value;
        shares += share;
        bits = static_cast<std::uint8_t>(bits | (f & kDarkBit[c]));
      }
      if (shares > 0.0F) {
        out[c] = sum / shares;
      } else {
        out[c] = bound;
        bits = static_cast<std::uint8_t>(bits | kSaturatedBit[c]);
      }
    }
    out[3] = bits == 0 ? 1.0F : 0.0F;
    out_flags[x] = bits;
  }
}

}  // namespace omnihdr
#endif
