#include "server/input/limited_log.hpp"

#include <gtest/gtest.h>

#include <string>
#include <vector>

namespace incise::input {
namespace {

constexpr std::int64_t kSecond = 1'000'000'000;
constexpr auto kWarn = spdlog::level::warn;

struct LimitedLogTest : ::testing::Test {
  std::vector<std::string> lines;
  LimitedLog log{[this](spdlog::level::level_enum, const std::string& line) { lines.push_back(line); }, {}};

  void flood(const std::string& address, int count, std::int64_t now_ns) {
    for (int i = 0; i < count; ++i) log.write(kWarn, address, address + " refused", now_ns);
  }
};

TEST_F(LimitedLogTest, TenLinesAtOnceThenOneInFiveSeconds) {
  flood("a", 30, 0);
  EXPECT_EQ(lines, std::vector<std::string>(10, "a refused"));
  flood("a", 1, 4 * kSecond);
  EXPECT_EQ(lines.size(), 10u);
  flood("a", 1, 6 * kSecond);
  ASSERT_EQ(lines.size(), 11u);
  EXPECT_EQ(lines.back(), "a refused (21 lines like this left out)");
}

TEST_F(LimitedLogTest, AnotherLimit) {
  lines.clear();
  LimitedLog patient{[this](spdlog::level::level_enum, const std::string& line) { lines.push_back(line); },
                     {100, 1}};
  const auto write = [&](int count, double at_s) {
    for (int i = 0; i < count; ++i)
      patient.write(spdlog::level::info, "a", "line", static_cast<std::int64_t>(1e9 * at_s));
  };
  write(120, 0);
  EXPECT_EQ(lines.size(), 100u);
  patient.flush(1'000'000'000);
  EXPECT_EQ(lines.back(), "line (19 lines like this left out)");
  write(4, 4.5);
  EXPECT_EQ(lines.size(), 104u);
}

TEST_F(LimitedLogTest, WhatWasLeftOutIsWrittenInTimeWithoutAnotherLine) {
  flood("a", 13, 0);
  log.flush(4 * kSecond);
  EXPECT_EQ(lines.size(), 10u);
  log.flush(5 * kSecond);
  ASSERT_EQ(lines.size(), 11u);
  EXPECT_EQ(lines.back(), "a refused (2 lines like this left out)");
  log.flush(100 * kSecond);
  EXPECT_EQ(lines.size(), 11u) << "once";
}

TEST_F(LimitedLogTest, OneMoreThanTheLastIsALine) {
  flood("a", 12, 0);
  log.flush(5 * kSecond);
  EXPECT_EQ(lines.back(), "a refused (1 line like this left out)");
}

TEST_F(LimitedLogTest, ASingleLineLeftOutIsWrittenAsItIs) {
  flood("a", 11, 0);
  log.flush(5 * kSecond);
  EXPECT_EQ(lines, std::vector<std::string>(11, "a refused"));
}

TEST_F(LimitedLogTest, OneAddressDoesNotHideAnother) {
  flood("a", 1000, 0);
  flood("b", 1, 0);
  EXPECT_EQ(lines.back(), "b refused");
}

// More addresses than it remembers: the rest share one limit, and quiet addresses make room.
TEST_F(LimitedLogTest, ManyAddressesAreBounded) {
  const auto address = [](std::size_t i) { return "address " + std::to_string(i); };
  for (std::size_t i = 0; i < 10 * LimitedLog::kMaxAddresses; ++i) flood(address(i), 1, 0);
  EXPECT_EQ(lines.size(), LimitedLog::kMaxAddresses + 10);
  log.flush(5 * kSecond);
  EXPECT_EQ(lines.size(), LimitedLog::kMaxAddresses + 11) << "one line for all that share";
  lines.clear();
  flood("new", 1000, 100 * kSecond);
  flood("newer", 1, 100 * kSecond);
  EXPECT_EQ(lines.size(), 11u);
  EXPECT_EQ(lines.back(), "newer refused");
}

}  // namespace
}  // namespace incise::input
