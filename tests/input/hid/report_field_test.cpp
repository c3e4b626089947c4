#include "server/input/hid/report_field.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <random>

namespace incise::input {
namespace {

using Kind = ReportField::Kind;

TEST(ReportField, ReadsEveryKindOfNumber) {
  const std::array<std::uint8_t, 12> bytes{1,    0xfe, 0xff, 0x12, 0x34, 0x00,
                                           0x00, 0x80, 0xbf, 0xa5, 0x3c, 0xff};
  const auto raw = [&](std::uint32_t bit, unsigned bits, Kind kind, bool big_endian = false) {
    return ReportField{0, bit, static_cast<std::uint8_t>(bits), kind, big_endian, 1, 0}.raw(bytes);
  };
  EXPECT_EQ(raw(8, 16, Kind::kSigned), -2);
  EXPECT_EQ(raw(8, 16, Kind::kUnsigned), 65534);
  EXPECT_EQ(raw(24, 16, Kind::kUnsigned, true), 0x1234);
  EXPECT_EQ(raw(24, 24, Kind::kUnsigned), 0x003412);
  EXPECT_EQ(raw(40, 32, Kind::kFloat), -1);
  EXPECT_EQ(raw(72, 12, Kind::kUnsigned), 0xca5);
  EXPECT_EQ(raw(76, 12, Kind::kSigned), 0x3ca);
  EXPECT_EQ(raw(75, 1, Kind::kUnsigned), 0);
  EXPECT_EQ(raw(77, 1, Kind::kUnsigned), 1);
  EXPECT_EQ(raw(88, 8, Kind::kSigned), -1);
  EXPECT_EQ((ReportField{0, 8, 16, Kind::kSigned, false, 0.5, 10}.value(bytes)), -6);
  EXPECT_EQ((ReportField{0, 76, 12, Kind::kSigned, false, 1, 0}.end()), 11u);
}

// What was written is read again, at any place, and the bits around it stay.
TEST(ReportField, WritesWhatItReads) {
  std::mt19937_64 random(3);
  for (int round = 0; round < 20'000; ++round) {
    ReportField field;
    field.kind = static_cast<Kind>(random() % 3);
    field.bits =
        static_cast<std::uint8_t>(field.kind == Kind::kFloat ? (random() % 2 ? 32 : 64) : 2 + random() % 31);
    field.bit = static_cast<std::uint32_t>(random() % 40);
    if (field.kind == Kind::kFloat) field.bit &= ~7u;
    field.big_endian = field.bits % 8 == 0 && random() % 2;
    if (field.big_endian) field.bit &= ~7u;
    std::array<std::uint8_t, 16> bytes, before;
    for (auto& byte : bytes) byte = static_cast<std::uint8_t>(random());
    before = bytes;
    const double wanted = field.kind == Kind::kUnsigned
                              ? static_cast<double>(random() % (1ull << field.bits))
                              : static_cast<double>(static_cast<std::int64_t>(random() % 3) - 1);
    field.write(bytes, wanted);
    ASSERT_EQ(field.value(bytes), wanted) << "round " << round;
    field.write(bytes, 0);
    for (std::uint32_t b = 0; b < 128; ++b) {
      if (b >= field.bit && b < field.bit + field.bits) continue;
      ASSERT_EQ(bytes[b / 8] >> b % 8 & 1, before[b / 8] >> b % 8 & 1) << "round " << round << ", bit " << b;
    }
  }
}

TEST(ReportField, WritesTheNearestThatFits) {
  std::array<std::uint8_t, 4> bytes{};
  const ReportField field{0, 8, 8, Kind::kSigned, false, 0.1, 0};
  for (const auto& [value, raw] : {std::pair(1.26, 13.0), std::pair(1e9, 127.0), std::pair(-1e9, -128.0),
                                   std::pair(std::nan(""), 0.0), std::pair(double{INFINITY}, 0.0)}) {
    field.write(bytes, value);
    EXPECT_EQ(field.raw(bytes), raw) << value;
  }
  const ReportField positive{0, 8, 8, Kind::kUnsigned, false, 0.1, 0};
  for (const auto& [value, raw] : {std::pair(1.26, 13.0), std::pair(1e9, 255.0), std::pair(-0.1, 0.0)}) {
    positive.write(bytes, value);
    EXPECT_EQ(positive.raw(bytes), raw) << value;
  }
}

}  // namespace
}  // namespace incise::input
