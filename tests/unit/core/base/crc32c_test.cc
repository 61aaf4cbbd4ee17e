#include "core/base/crc32c.h"

#include <gtest/gtest.h>
#include <rapidcheck/gtest.h>

#include <algorithm>
#include <cstring>
#include <string_view>
#include <vector>

namespace omnihdr::crc32c_test {
namespace {

std::uint32_t CrcOf(std::string_view text) {
  return Crc32c(std::as_bytes(std::span(text.data(), text.size())));
}

TEST(Crc32c, MatchesThePublishedVectors) {
  // RFC 3720, appendix B.4.
  EXPECT_EQ(CrcOf("123456789"), 0xE3069283U);
  EXPECT_EQ(CrcOf(std::string(32, '\0')), 0x8A9136AAU);
  EXPECT_EQ(CrcOf(std::string(32, '\xff')), 0x62A8AB43U);
  std::string ascending(32, '\0');
  for (std::size_t i = 0; i < 32; ++i) ascending[i] = static_cast<char>(i);
  EXPECT_EQ(CrcOf(ascending), 0x46DD794EU);
  EXPECT_EQ(CrcOf(""), 0U);
}

RC_GTEST_PROP(Crc32c, APartitionOfTheBytesGivesTheSameSum,
              (const std::vector<std::uint8_t>& bytes)) {
  const auto all = std::as_bytes(std::span(bytes));
  const auto cut =
      static_cast<std::size_t>(*rc::gen::inRange<int>(0, static_cast<int>(bytes.size()) + 1));
  RC_ASSERT(Crc32c(all.subspan(cut), Crc32c(all.first(cut))) == Crc32c(all));
}

RC_GTEST_PROP(Crc32c, AFlippedBitChangesTheSum, ()) {
  auto bytes = *rc::gen::nonEmpty<std::vector<std::uint8_t>>();
  const std::uint32_t before = Crc32c(std::as_bytes(std::span(bytes)));
  const auto at =
      static_cast<std::size_t>(*rc::gen::inRange<int>(0, static_cast<int>(bytes.size())));
  bytes[at] = static_cast<std::uint8_t>(bytes[at] ^ (1U << *rc::gen::inRange(0, 8)));
  RC_ASSERT(Crc32c(std::as_bytes(std::span(bytes))) != before);
}

}  // namespace
}  // namespace omnihdr::crc32c_test
