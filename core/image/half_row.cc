#include "core/image/half_row.h"

#include <bit>

#include "core/base/simd.h"

namespace omnihdr {

OMNIHDR_SIMD_CLONES
void HalfRow(const float* __restrict values, int stride, int count, std::uint16_t* __restrict out) {
  constexpr std::uint32_t kSign = 0x80000000U;
  constexpr std::uint32_t kNotANumber = 0x7F800001U;
  constexpr std::uint32_t kLeastNormal = 113U << 23U;  // 2^-14
  // Added to less than that, it leaves the bits of a half's denormal number at the low end.
  constexpr std::uint32_t kAligning = (127U - 15U + 23U - 10U + 1U) << 23U;
  const float aligning = std::bit_cast<float>(kAligning);
  for (int i = 0; i < count; ++i) {
    const auto bits = std::bit_cast<std::uint32_t>(values[i * stride]);
    const std::uint32_t sign = (bits & kSign) >> 16U;
    const std::uint32_t magnitude = bits & ~kSign;
    const float value = std::bit_cast<float>(magnitude);
    const float limited = value < kLargestHalf ? value : kLargestHalf;
    const auto normal = std::bit_cast<std::uint32_t>(limited);
    const std::uint32_t rounded = (normal - (112U << 23U) + 0xFFFU + ((normal >> 13U) & 1U)) >> 13U;
    const std::uint32_t denormal = std::bit_cast<std::uint32_t>(limited + aligning) - kAligning;
    std::uint32_t half_bits = normal < kLeastNormal ? denormal : rounded;
    half_bits = magnitude >= kNotANumber ? 0x7E00U : half_bits;
    out[i] = static_cast<std::uint16_t>(half_bits | sign);
  }
}

}  // namespace omnihdr
