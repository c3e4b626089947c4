#include "server/base/wording.hpp"

#include <gtest/gtest.h>

namespace incise {
namespace {

TEST(Wording, NumbersAreShortAndDurationsHaveTheirUnit) {
  EXPECT_EQ(short_number(12.3), "12.3");
  EXPECT_EQ(short_number(0.00042), "0.00042");
  EXPECT_EQ(short_duration(0.5), "0.5 us");
  EXPECT_EQ(short_duration(840), "840 us");
  EXPECT_EQ(short_duration(999.9), "1 ms");
  EXPECT_EQ(short_duration(13770), "13.8 ms");
  EXPECT_EQ(short_duration(2.1e6), "2.1 s");
  EXPECT_EQ(counted(0, "fault", "faults"), "0 faults");
  EXPECT_EQ(counted(1, "vertex", "vertices"), "1 vertex");
  EXPECT_EQ(counted(2, "vertex", "vertices"), "2 vertices");
}

}  // namespace
}  // namespace incise
