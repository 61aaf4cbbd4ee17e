#include "core/photometry/stitch_kernels.h"

#include <algorithm>
#include <cstring>
#include <limits>

#include "core/photometry/measurement.h"
#include "core/photometry/mosaic.h"
#include "core/photometry/stitch_table.h"

// Vectors are kept in arrays here, which those of ARM's SVE, without a size, cannot be: NEON there.
#define HWY_DISABLED_TARGETS (HWY_SVE | HWY_SVE2 | HWY_SVE_256 | HWY_SVE2_128)
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

// Pixels prepared at a time. Plain loads into a buffer are faster than the gather instructions of
// today's processors, and with a batch the reads do not wait for the writes.
constexpr int kBatch = 64;
static_assert(kBatch <= static_cast<int>(kStitchPadding));
// Sensors of one pixel (StitchSegment).
constexpr int kMostBlended = 4;

// Rows of the blocks as words of four bytes: word[row][pixel].
HWY_INLINE void GatherWords(const std::uint8_t* bytes, std::ptrdiff_t stride,
                            const std::uint32_t* block, int count, std::uint32_t (*word)[kBatch]) {
  for (int k = 0; k < count; ++k) {
    const std::uint8_t* from = bytes + block[k];
    asm volatile("" : "+r"(from));
    for (int row = 0; row < 4; ++row) {
      std::memcpy(&word[row][k], from + row * stride, sizeof(std::uint32_t));
    }
  }
}

// Weights of the block's columns and rows: values of one place of the tile are two pixels apart.
struct Weights {
  VF x[4];
  VF y[4];
};

HWY_INLINE Weights WeightsOf(VU packed) {
  const F d;
  const I di;
  const U du;
  const VF one = hn::Set(d, 1.0F);
  const VF half = hn::Set(d, 0.5F);
  const VF step = hn::Set(d, 1.0F / 512.0F);
  const VU byte = hn::Set(du, 255U);
  const VF hx = hn::Mul(hn::ConvertTo(d, hn::BitCast(di, hn::And(packed, byte))), step);
  const VF hy =
      hn::Mul(hn::ConvertTo(d, hn::BitCast(di, hn::And(hn::ShiftRight<8>(packed), byte))), step);
  return {{hn::Sub(half, hx), hn::Sub(one, hx), hn::Add(half, hx), hx},
          {hn::Sub(half, hy), hn::Sub(one, hy), hn::Add(half, hy), hy}};
}

// By the block's places, row by row: the interpolated value, and the largest byte of those taken.
struct Planes {
  // One of the compiler's own would not be for the target.
  HWY_ATTR Planes() {}  // NOLINT(modernize-use-equals-default)
  VF value[4];
  VU most[4];
};

HWY_INLINE void MostOf(const VU (&word)[4], VU (&most)[4]) {
  const VU byte = hn::Set(U(), 255U);
  for (int row = 0; row < 2; ++row) {
    const VU columns = MaxBytes(word[row], word[row + 2]);
    const VU folded = MaxBytes(columns, hn::ShiftRight<16>(columns));
    most[2 * row] = hn::And(folded, byte);
    most[2 * row + 1] = hn::And(hn::ShiftRight<8>(folded), byte);
  }
}

HWY_INLINE void ValuesOfBytes(const VU (&word)[4], VU packed, VF (&value)[4]) {
  const F d;
  const I di;
  const VU byte = hn::Set(U(), 255U);
  const Weights w = WeightsOf(packed);
  const auto to_float = [&](VU v) HWY_ATTR { return hn::ConvertTo(d, hn::BitCast(di, v)); };
  for (int row = 0; row < 4; ++row) {
    const VF c0 = to_float(hn::And(word[row], byte));
    const VF c1 = to_float(hn::And(hn::ShiftRight<8>(word[row]), byte));
    const VF c2 = to_float(hn::And(hn::ShiftRight<16>(word[row]), byte));
    const VF c3 = to_float(hn::ShiftRight<24>(word[row]));
    const VF a = hn::MulAdd(w.x[2], c2, hn::Mul(w.x[0], c0));
    const VF b = hn::MulAdd(w.x[3], c3, hn::Mul(w.x[1], c1));
    const int place = 2 * (row & 1);
    value[place] = row < 2 ? hn::Mul(w.y[row], a) : hn::MulAdd(w.y[row], a, value[place]);
    value[place + 1] = row < 2 ? hn::Mul(w.y[row], b) : hn::MulAdd(w.y[row], b, value[place + 1]);
  }
}

// The interpolated values of a batch's places, four to a pixel.
HWY_INLINE void ValuesOfMosaic(const float* radiance, std::ptrdiff_t stride,
                               const StitchSamples& samples, int x, int count, float* values) {
  const F d;
  const U du;
  HWY_ALIGN float wx[4 * kBatch];
  HWY_ALIGN float wy[4 * kBatch];
  const int lanes = static_cast<int>(hn::Lanes(d));
  for (int k = 0; k < count; k += lanes) {
    const Weights w = WeightsOf(hn::LoadU(du, samples.packed + x + k));
    hn::StoreInterleaved4(w.x[0], w.x[1], w.x[2], w.x[3], d, wx + 4 * k);
    hn::StoreInterleaved4(w.y[0], w.y[1], w.y[2], w.y[3], d, wy + 4 * k);
  }
  for (int k = 0; k < count; ++k) {
    const float* from = radiance + samples.block[x + k];
    const float* y = wy + 4 * k;
#if HWY_TARGET == HWY_SCALAR
    for (int place = 0; place < 4; ++place) {
      const int row = place / 2;
      const int column = place % 2;
      const auto at = [&](int r) {
        const float* p = from + r * stride + column;
        return wx[4 * k + column] * p[0] + wx[4 * k + column + 2] * p[2];
      };
      values[4 * k + place] = y[row] * at(row) + y[row + 2] * at(row + 2);
    }
#else
    const hn::Simd<float, 4, 0> d4;
    const auto columns = hn::Load(d4, wx + 4 * k);
    const auto rows = [&](int row) HWY_ATTR {
      const auto upper = hn::Mul(hn::Set(d4, y[row]), hn::LoadU(d4, from + row * stride));
      return hn::Mul(columns, hn::MulAdd(hn::Set(d4, y[row + 2]),
                                         hn::LoadU(d4, from + (row + 2) * stride), upper));
    };
    const auto a = rows(0);
    const auto b = rows(1);
    // Columns 0 + 2 and 1 + 3 of both.
    hn::Store(hn::Add(hn::ConcatLowerLower(d4, b, a), hn::ConcatUpperUpper(d4, b, a)), d4,
              values + 4 * k);
#endif
  }
}

// From places in the block to those of the tile: red, green, green, blue.
HWY_INLINE Planes ByTile(const Planes& block, VU packed) {
  const F d;
  const I di;
  const U du;
  const auto odd_column = hn::MaskFromVec(
      hn::BitCast(d, hn::BroadcastSignBit(hn::BitCast(di, hn::ShiftLeft<1>(packed)))));
  const auto odd_row =
      hn::MaskFromVec(hn::BitCast(d, hn::BroadcastSignBit(hn::BitCast(di, packed))));
  Planes columns;
  Planes tile;
  for (int k = 0; k < 4; ++k) {
    columns.value[k] = hn::IfThenElse(odd_column, block.value[k ^ 1], block.value[k]);
    columns.most[k] =
        hn::IfThenElse(hn::RebindMask(du, odd_column), block.most[k ^ 1], block.most[k]);
  }
  for (int k = 0; k < 4; ++k) {
    tile.value[k] = hn::IfThenElse(odd_row, columns.value[k ^ 2], columns.value[k]);
    tile.most[k] =
        hn::IfThenElse(hn::RebindMask(du, odd_row), columns.most[k ^ 2], columns.most[k]);
  }
  return tile;
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

// Colours, scale and flags of a vector of pixels.
class Finisher {
 public:
  HWY_INLINE Finisher(const Limits& limits, const StitchScale& scale)
      : limits_(limits), scale_(scale) {}

  HWY_INLINE void Write(const Planes& block, VU packed, VF shade, float* rgba,
                        std::uint8_t* flags) const {
    const Planes planes = ByTile(block, packed);
    Finish(planes, planes.value[0], Green(planes), planes.value[3], shade, rgba, flags);
  }

  // `guide`: green interpolated from the block's places; `middle`: green at the point itself.
  HWY_INLINE void WriteGuided(const Planes& block, const Planes& guide, VF middle, VU packed,
                              VF shade, float* rgba, std::uint8_t* flags) const {
    const F d;
    const I di;
    const Planes planes = ByTile(block, packed);
    const Planes greens = ByTile(guide, packed);
    const auto saturated = [&](VU most) HWY_ATTR {
      return hn::RebindMask(d, hn::Gt(hn::BitCast(di, most), hn::Set(di, kMosaicUsable)));
    };
    const VU most_green = hn::Max(planes.most[1], planes.most[2]);
    const auto guided = [&](int place) HWY_ATTR {
      const VF ratio = hn::Div(middle, hn::Max(greens.value[place], hn::Set(d, 1e-30F)));
      return hn::IfThenElse(saturated(hn::Max(most_green, planes.most[place])), planes.value[place],
                            hn::Mul(planes.value[place], ratio));
    };
    Finish(planes, guided(0), hn::IfThenElse(saturated(most_green), Green(planes), middle),
           guided(3), shade, rgba, flags);
  }

 private:
  static HWY_INLINE VF Green(const Planes& planes) {
    return hn::Mul(hn::Set(F(), 0.5F), hn::Add(planes.value[1], planes.value[2]));
  }

  HWY_INLINE void Finish(const Planes& planes, VF red, VF green, VF blue, VF shade, float* rgba,
                         std::uint8_t* flags) const {
    const F d;
    const U du;
    const I di;
    const hn::Rebind<std::uint8_t, I> d8;
    const auto radiance = [&](VF value, float factor) HWY_ATTR {
      return hn::Mul(hn::Max(hn::Sub(value, hn::Set(d, limits_.black)), hn::Set(d, limits_.least)),
                     hn::Mul(shade, hn::Set(d, factor)));
    };
    const VU low = hn::Set(du, limits_.low);
    const VU high = hn::Set(du, limits_.high);
    const VU most_green = hn::Max(planes.most[1], planes.most[2]);
    const VU bits = hn::Or(FlagBits(planes.most[0], low, high, kSaturatedR, kDarkR),
                           hn::Or(FlagBits(most_green, low, high, kSaturatedG, kDarkG),
                                  FlagBits(planes.most[3], low, high, kSaturatedB, kDarkB)));
    const VF usable =
        hn::IfThenElseZero(hn::RebindMask(d, hn::Eq(bits, hn::Zero(du))), hn::Set(d, 1.0F));
    const VF r = radiance(red, scale_.scale[0]);
    const VF g = radiance(green, scale_.scale[1]);
    const VF b = radiance(blue, scale_.scale[2]);
    // Clipped altogether: neutral, at the bound that holds for all channels, in spite of the gains.
    const VU saturated = hn::Set(du, std::uint32_t{kSaturatedAny});
    const auto white = hn::RebindMask(d, hn::Eq(hn::And(bits, saturated), saturated));
    const VF bound = hn::Min(r, hn::Min(g, b));
    hn::StoreInterleaved4(hn::IfThenElse(white, bound, r), hn::IfThenElse(white, bound, g),
                          hn::IfThenElse(white, bound, b), usable, d, rgba);
    hn::StoreU(hn::DemoteTo(d8, hn::BitCast(di, bits)), d8, flags);
  }

  const Limits limits_;
  const StitchScale scale_;
};

// `fill` prepares a batch from its first pixel on; `write` finishes the vector that begins at a
// pixel of the batch, of whose blocks it gets the bytes.
template <typename Fill, typename Write>
HWY_INLINE void StitchAll(const std::uint8_t* bytes, std::ptrdiff_t stride, const Fill& fill,
                          const Write& write, const StitchSamples& samples, float* rgba,
                          std::uint8_t* flags) {
  const F d;
  const U du;
  const int lanes = static_cast<int>(hn::Lanes(d));
  HWY_ALIGN std::uint32_t words[4][kBatch];
  HWY_ALIGN float tail_rgba[4 * HWY_MAX_BYTES / sizeof(float)];
  HWY_ALIGN std::uint8_t tail_flags[HWY_MAX_BYTES];
  for (int first = 0; first < samples.count; first += kBatch) {
    const int end = std::min(samples.count, first + kBatch);
    const int whole_vectors = (end - first + lanes - 1) / lanes * lanes;
    GatherWords(bytes, stride, samples.block + first, whole_vectors, words);
    fill(first, whole_vectors);
    for (int x = first; x < end; x += lanes) {
      const VU packed = hn::LoadU(du, samples.packed + x);
      const VU word[4] = {
          hn::Load(du, words[0] + (x - first)), hn::Load(du, words[1] + (x - first)),
          hn::Load(du, words[2] + (x - first)), hn::Load(du, words[3] + (x - first))};
      const VF shade = hn::LoadU(d, samples.shade + x);
      const bool is_whole = x + lanes <= samples.count;
      // One call, so that it is inlined.
      write(x - first, word, packed, shade, is_whole ? rgba + 4 * x : tail_rgba,
            is_whole ? flags + x : tail_flags);
      if (!is_whole) {
        const auto rest = static_cast<std::size_t>(samples.count - x);
        std::memcpy(rgba + 4 * x, tail_rgba, 4 * rest * sizeof(float));
        std::memcpy(flags + x, tail_flags, rest);
      }
    }
  }
}

void StitchMosaicRow(const float* radiance, const std::uint8_t* state, std::ptrdiff_t stride,
                     const StitchSamples& samples, const StitchScale& scale, float* rgba,
                     std::uint8_t* flags) {
  const Finisher finisher(Limits{}, scale);
  HWY_ALIGN float batch[4 * kBatch];
  StitchAll(
      state, stride,
      [&](int first, int count)
          HWY_ATTR { ValuesOfMosaic(radiance, stride, samples, first, count, batch); },
      [&](int k, const VU(&word)[4], VU packed, VF shade, float* to, std::uint8_t* to_flags)
          HWY_ATTR {
            Planes planes;
            MostOf(word, planes.most);
            hn::LoadInterleaved4(F(), batch + 4 * k, planes.value[0], planes.value[1],
                                 planes.value[2], planes.value[3]);
            finisher.Write(planes, packed, shade, to, to_flags);
          },
      samples, rgba, flags);
}

void StitchGuidedRow(const float* radiance, const float* guide, const std::uint8_t* state,
                     std::ptrdiff_t stride, const StitchSamples& samples, const StitchScale& scale,
                     float* rgba, std::uint8_t* flags) {
  const Finisher finisher(Limits{}, scale);
  HWY_ALIGN float batch[4 * kBatch];
  HWY_ALIGN float greens[4 * kBatch];
  HWY_ALIGN float middle[kBatch];
  StitchAll(
      state, stride,
      [&](int first, int count) HWY_ATTR {
        ValuesOfMosaic(radiance, stride, samples, first, count, batch);
        ValuesOfMosaic(guide, stride, samples, first, count, greens);
        for (int k = 0; k < count; ++k) {
          const float* at = guide + samples.block[first + k] + stride + 1;
          const std::uint32_t packed = samples.packed[first + k];
          const float fx = static_cast<float>(packed & 255U) * (1.0F / 256.0F);
          const float fy = static_cast<float>(packed >> 8U & 255U) * (1.0F / 256.0F);
          const float upper = at[0] + fx * (at[1] - at[0]);
          const float lower = at[stride] + fx * (at[stride + 1] - at[stride]);
          middle[k] = upper + fy * (lower - upper);
        }
      },
      [&](int k, const VU(&word)[4], VU packed, VF shade, float* to, std::uint8_t* to_flags)
          HWY_ATTR {
            Planes planes;
            Planes guides;
            MostOf(word, planes.most);
            MostOf(word, guides.most);
            hn::LoadInterleaved4(F(), batch + 4 * k, planes.value[0], planes.value[1],
                                 planes.value[2], planes.value[3]);
            hn::LoadInterleaved4(F(), greens + 4 * k, guides.value[0], guides.value[1],
                                 guides.value[2], guides.value[3]);
            finisher.WriteGuided(planes, guides, hn::Load(F(), middle + k), packed, shade, to,
                                 to_flags);
          },
      samples, rgba, flags);
}

void StitchBytesRow(const std::uint8_t* bytes, std::ptrdiff_t stride, float black,
                    std::uint32_t low, std::uint32_t high, const StitchSamples& samples,
                    const StitchScale& scale, float* rgba, std::uint8_t* flags) {
  const Finisher finisher(Limits{low, high, black, 0.25F}, scale);
  StitchAll(
      bytes, stride, [](int, int) {},
      [&](int, const VU(&word)[4], VU packed, VF shade, float* to, std::uint8_t* to_flags)
          HWY_ATTR {
            Planes planes;
            MostOf(word, planes.most);
            ValuesOfBytes(word, packed, planes.value);
            finisher.Write(planes, packed, shade, to, to_flags);
          },
      samples, rgba, flags);
}

// A vector of pixels that several sensors see: R, G, B, usable, flags and packed samples of each.
HWY_INLINE void BlendVector(const float* const* rgba, const std::uint8_t* const* flags,
                            const std::uint32_t* const* packed, int sensors, float* out_rgba,
                            std::uint8_t* out_flags) {
  const F d;
  const U du;
  const I di;
  const hn::Rebind<std::uint8_t, I> d8;
  const VU zero = hn::Zero(du);
  const VU all = hn::Set(du, std::uint32_t{kSaturatedAny});
  const VF one = hn::Set(d, 1.0F);
  VU state[kMostBlended];
  VF share[kMostBlended];
  VF value[3][kMostBlended];
  VU any = zero;
  for (int k = 0; k < sensors; ++k) {
    VF usable;
    hn::LoadInterleaved4(d, rgba[k], value[0][k], value[1][k], value[2][k], usable);
    state[k] = hn::PromoteTo(du, hn::LoadU(d8, flags[k]));
    const VU bits = hn::And(hn::ShiftRight<16>(hn::LoadU(du, packed[k])), hn::Set(du, kFullShare));
    share[k] = hn::ConvertTo(d, hn::BitCast(di, bits));
    any = hn::Or(any, state[k]);
  }
  VF out[3];
  VU bits = any;
  if (hn::AllTrue(du, hn::Eq(hn::And(any, all), zero))) {
    VF shares = hn::Zero(d);
    for (int k = 0; k < sensors; ++k) shares = hn::Add(shares, share[k]);
    const VF inverse = hn::Div(one, shares);
    for (int c = 0; c < 3; ++c) {
      VF sum = hn::Zero(d);
      for (int k = 0; k < sensors; ++k) sum = hn::MulAdd(share[k], value[c][k], sum);
      out[c] = hn::Mul(sum, inverse);
    }
  } else {
    // A clean sample far below what a clipped one proves shows something else: where they meet at
    // another distance than the sensors were aligned for. The sensor of the larger share is right.
    const VF half = hn::Set(d, 0.5F);
    VU clean = zero;
    VU lost[kMostBlended];
    for (int k = 0; k < sensors; ++k) {
      lost[k] = zero;
      for (int j = 0; j < sensors; ++j) {
        for (int c = 0; c < 3; ++c) {
          const VU saturated = hn::Set(du, std::uint32_t{kSaturatedR} << static_cast<unsigned>(c));
          const auto is_bound = hn::RebindMask(d, hn::Ne(hn::And(state[j], saturated), zero));
          const auto is_below = hn::Lt(value[c][k], hn::Mul(half, value[c][j]));
          const auto outweighs = hn::Ge(share[j], share[k]);
          lost[k] =
              hn::Or(lost[k],
                     hn::VecFromMask(
                         du, hn::RebindMask(du, hn::And(is_bound, hn::And(is_below, outweighs)))));
        }
      }
      const VU unclipped = hn::VecFromMask(du, hn::Eq(hn::And(state[k], all), zero));
      lost[k] = hn::And(lost[k], unclipped);
      clean = hn::Or(clean, hn::AndNot(lost[k], unclipped));
    }
    bits = zero;
    for (int c = 0; c < 3; ++c) {
      const VU saturated = hn::Set(du, std::uint32_t{kSaturatedR} << static_cast<unsigned>(c));
      const VU dark = hn::Set(du, std::uint32_t{kDarkR} << static_cast<unsigned>(c));
      // What keeps a sample out: any saturated channel, where another sensor has none.
      const VU barred = hn::Or(hn::And(clean, all), saturated);
      VF sum = hn::Zero(d);
      VF shares = hn::Zero(d);
      VF bound = hn::Zero(d);
      for (int k = 0; k < sensors; ++k) {
        const auto stays = hn::Eq(lost[k], zero);
        const auto enters = hn::And(stays, hn::Eq(hn::And(state[k], barred), zero));
        const auto enters_f = hn::RebindMask(d, enters);
        const VF part = hn::IfThenElseZero(enters_f, share[k]);
        sum = hn::MulAdd(part, value[c][k], sum);
        shares = hn::Add(shares, part);
        bound = hn::Max(bound, hn::IfThenElseZero(hn::RebindMask(d, stays),
                                                  hn::IfThenZeroElse(enters_f, value[c][k])));
        bits = hn::Or(bits, hn::IfThenElseZero(enters, hn::And(state[k], dark)));
      }
      const auto known = hn::Gt(shares, hn::Zero(d));
      out[c] = hn::IfThenElse(known, hn::Mul(sum, hn::Div(one, shares)), bound);
      bits = hn::Or(bits, hn::IfThenZeroElse(hn::RebindMask(du, known), saturated));
    }
    const auto white = hn::RebindMask(d, hn::Eq(hn::And(bits, all), all));
    const VF least = hn::Min(out[0], hn::Min(out[1], out[2]));
    for (VF& v : out) v = hn::IfThenElse(white, least, v);
  }
  const VF usable = hn::IfThenElseZero(hn::RebindMask(d, hn::Eq(bits, zero)), one);
  hn::StoreInterleaved4(out[0], out[1], out[2], usable, d, out_rgba);
  hn::StoreU(hn::DemoteTo(d8, hn::BitCast(di, bits)), d8, out_flags);
}

void BlendRow(const float* rgba, const std::uint8_t* flags, const std::uint32_t* const* packed,
              int sensors, int count, float* out_rgba, std::uint8_t* out_flags) {
  const int lanes = static_cast<int>(hn::Lanes(F()));
  const float* in_rgba[kMostBlended];
  const std::uint8_t* in_flags[kMostBlended];
  const std::uint32_t* in_packed[kMostBlended];
  int x = 0;
  for (; x + lanes <= count; x += lanes) {
    for (int k = 0; k < sensors; ++k) {
      in_rgba[k] = rgba + 4 * (k * count + x);
      in_flags[k] = flags + k * count + x;
      in_packed[k] = packed[k] + x;
    }
    BlendVector(in_rgba, in_flags, in_packed, sensors, out_rgba + 4 * x, out_flags + x);
  }
  if (x >= count) return;
  // The rest in a whole vector of its own: zeros beyond it.
  constexpr std::size_t kMostLanes = HWY_MAX_BYTES / sizeof(float);
  float rest_rgba[kMostBlended][4 * kMostLanes] = {};
  std::uint8_t rest_flags[kMostBlended][kMostLanes] = {};
  std::uint32_t rest_packed[kMostBlended][kMostLanes] = {};
  float to_rgba[4 * kMostLanes];
  std::uint8_t to_flags[kMostLanes];
  const auto rest = static_cast<std::size_t>(count - x);
  for (int k = 0; k < sensors; ++k) {
    std::memcpy(rest_rgba[k], rgba + 4 * (k * count + x), 4 * rest * sizeof(float));
    std::memcpy(rest_flags[k], flags + k * count + x, rest);
    std::memcpy(rest_packed[k], packed[k] + x, rest * sizeof(std::uint32_t));
    in_rgba[k] = rest_rgba[k];
    in_flags[k] = rest_flags[k];
    in_packed[k] = rest_packed[k];
  }
  BlendVector(in_rgba, in_flags, in_packed, sensors, to_rgba, to_flags);
  std::memcpy(out_rgba + 4 * x, to_rgba, 4 * rest * sizeof(float));
  std::memcpy(out_flags + x, to_flags, rest);
}

}  // namespace HWY_NAMESPACE
}  // namespace omnihdr
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace omnihdr {
namespace {

HWY_EXPORT(StitchMosaicRow);
HWY_EXPORT(StitchGuidedRow);
HWY_EXPORT(StitchBytesRow);
HWY_EXPORT(BlendRow);

constexpr std::array<std::uint8_t, 3> kSaturatedBit = {kSaturatedR, kSaturatedG, kSaturatedB};
constexpr std::array<std::uint8_t, 3> kDarkBit = {kDarkR, kDarkG, kDarkB};

void NeutralWhere(std::uint8_t bits, float* rgb) {
  if ((bits & kSaturatedAny) != kSaturatedAny) return;
  std::fill_n(rgb, 3, std::min({rgb[0], rgb[1], rgb[2]}));
}

// Interpolated between a clipped value and others a channel is no bound any more, and its hue that
// of the gains: of what is clipped in part, the least value taken is a bound that holds.
// `value_at(index)`: of a mosaic's place, as the scale takes it.
template <typename ValueAt>
void BoundClipped(const ValueAt& value_at, std::ptrdiff_t stride, const StitchSamples& samples,
                  const StitchScale& scale, float* rgba, const std::uint8_t* flags) {
  constexpr std::array<std::array<unsigned, 2>, 3> kPlaces = {{{0, 0}, {1, 2}, {3, 3}}};
  for (int x = 0; x < samples.count; ++x) {
    if ((flags[x] & kSaturatedAny) == 0) continue;
    const std::uint32_t packed = samples.packed[x];
    const unsigned odd = (packed >> 30U & 1U) | packed >> 31U << 1U;
    const bool on_column = (packed & 255U) == 0;
    const bool on_row = (packed >> 8U & 255U) == 0;
    float* out = rgba + 4 * x;
    for (std::size_t c = 0; c < 3; ++c) {
      if ((flags[x] & kSaturatedBit[c]) == 0) continue;
      float least = std::numeric_limits<float>::infinity();
      for (const unsigned place : kPlaces[c]) {
        const auto row = static_cast<int>((place ^ odd) >> 1U);
        const auto column = static_cast<int>((place ^ odd) & 1U);
        for (const int r : {row, row + 2}) {
          for (const int k : {column, column + 2}) {
            // Places 3 weigh nothing at a point on a column or a row (WeightsOf).
            if ((r == 3 && on_row) || (k == 3 && on_column)) continue;
            least = std::min(
                least, value_at(static_cast<std::ptrdiff_t>(samples.block[x]) + r * stride + k));
          }
        }
      }
      out[c] = std::min(out[c], least * samples.shade[x] * scale.scale[c]);
    }
    NeutralWhere(flags[x], out);
  }
}

}  // namespace

void StitchMosaic(const float* radiance, const std::uint8_t* state, std::ptrdiff_t stride,
                  const StitchSamples& samples, const StitchScale& scale, float* rgba,
                  std::uint8_t* flags) {
  HWY_DYNAMIC_DISPATCH(StitchMosaicRow)(radiance, state, stride, samples, scale, rgba, flags);
  BoundClipped([&](std::ptrdiff_t at) { return radiance[at]; }, stride, samples, scale, rgba,
               flags);
}

void StitchGuided(const float* radiance, const float* guide, const std::uint8_t* state,
                  std::ptrdiff_t stride, const StitchSamples& samples, const StitchScale& scale,
                  float* rgba, std::uint8_t* flags) {
  HWY_DYNAMIC_DISPATCH(StitchGuidedRow)
  (radiance, guide, state, stride, samples, scale, rgba, flags);
  BoundClipped([&](std::ptrdiff_t at) { return radiance[at]; }, stride, samples, scale, rgba,
               flags);
}

void StitchBytes(const std::uint8_t* bytes, std::ptrdiff_t stride, float black, std::uint32_t low,
                 std::uint32_t high, const StitchSamples& samples, const StitchScale& scale,
                 float* rgba, std::uint8_t* flags) {
  HWY_DYNAMIC_DISPATCH(StitchBytesRow)
  (bytes, stride, black, low, high, samples, scale, rgba, flags);
  BoundClipped(
      [&](std::ptrdiff_t at) { return std::max(static_cast<float>(bytes[at]) - black, 0.25F); },
      stride, samples, scale, rgba, flags);
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
      float least = std::numeric_limits<float>::infinity();
      std::uint8_t most = 0;
      for (std::size_t k = 0; k < 4; ++k) {
        const float value = radiance[at[k] + channel];
        sum += weight[k] * value;
        if (weight[k] > 0.0F) least = std::min(least, value);
        most = std::max(most, state[at[k] + channel]);
      }
      if (most == kMosaicSaturated) sum = std::min(sum, least);  // see BoundClipped
      out[c] = sum * samples.shade[x] * scale.scale[c];
      if (most == kMosaicSaturated) bits = static_cast<std::uint8_t>(bits | kSaturatedBit[c]);
      if (most == kMosaicDark) bits = static_cast<std::uint8_t>(bits | kDarkBit[c]);
    }
    NeutralWhere(bits, out);
    out[3] = bits == 0 ? 1.0F : 0.0F;
    flags[x] = bits;
  }
}

void BlendSamples(const float* rgba, const std::uint8_t* flags, const std::uint32_t* const* packed,
                  int sensors, int count, float* out_rgba, std::uint8_t* out_flags) {
  HWY_DYNAMIC_DISPATCH(BlendRow)
  (rgba, flags, packed, sensors, count, out_rgba, out_flags);
}

}  // namespace omnihdr
#endif
