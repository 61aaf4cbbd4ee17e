#pragma once

#include <cstddef>
#include <cstdint>
#include <span>

namespace omnihdr {

// CRC-32C (Castagnoli, RFC 3720 appendix B.4) of `bytes`, continuing from `seed` (0 to start).
std::uint32_t Crc32c(std::span<const std::byte> bytes, std::uint32_t seed = 0);

}  // namespace omnihdr
