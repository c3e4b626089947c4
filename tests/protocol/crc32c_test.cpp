#include "protocol/crc32c.hpp"

#include <gtest/gtest.h>

#include <numeric>
#include <string_view>
#include <vector>

namespace incise::protocol {
namespace {

std::span<const std::byte> bytes(std::string_view text) {
  return std::as_bytes(std::span(text));
}

TEST(Crc32c, KnownValues) {
  EXPECT_EQ(crc32c({}), 0u);
  EXPECT_EQ(crc32c(bytes("123456789")), 0xe3069283u);
  // RFC 3720, B.4.
  std::vector<std::byte> block(32);
  EXPECT_EQ(crc32c(block), 0x8a9136aau);
  block.assign(32, std::byte{0xff});
  EXPECT_EQ(crc32c(block), 0x62a8ab43u);
  for (std::size_t i = 0; i < 32; ++i) block[i] = static_cast<std::byte>(i);
  EXPECT_EQ(crc32c(block), 0x46dd794eu);
  for (std::size_t i = 0; i < 32; ++i) block[i] = static_cast<std::byte>(31 - i);
  EXPECT_EQ(crc32c(block), 0x113fdb5cu);
}

TEST(Crc32c, TwoPartsAreOneAfterTheOther) {
  for (std::size_t cut = 0; cut <= 9; ++cut) {
    EXPECT_EQ(crc32c(bytes("123456789").first(cut), bytes("123456789").subspan(cut)), 0xe3069283u);
  }
}

// The definition, a bit at a time, at every length about the step of eight bytes.
TEST(Crc32c, AgreesWithTheDefinitionAtEveryLength) {
  std::vector<std::byte> block;
  for (std::uint32_t n = 0; n < 40; ++n) {
    std::uint32_t remainder = 0xFFFFFFFF;
    for (const std::byte byte : block) {
      remainder ^= std::to_integer<std::uint32_t>(byte);
      for (int bit = 0; bit < 8; ++bit) remainder = (remainder >> 1) ^ ((remainder & 1) * 0x82F63B78u);
    }
    EXPECT_EQ(crc32c(block), ~remainder) << n << " bytes";
    block.push_back(static_cast<std::byte>(n * 151 + 7));
  }
}

}  // namespace
}  // namespace incise::protocol
