#include "server/core/mesh/fresh_marks.hpp"

#include <gtest/gtest.h>

namespace incise::core {
namespace {

TEST(FreshMarks, NoElementBearsAFreshNumber) {
  FreshMarks marks;
  marks.grow_to(3);
  const std::uint32_t first = marks.fresh();
  for (std::size_t i = 0; i < 3; ++i) EXPECT_NE(marks[i], first);
  marks[1] = first;
  const std::uint32_t three = marks.fresh(3);
  for (std::uint32_t number = three; number < three + 3; ++number) {
    for (std::size_t i = 0; i < 3; ++i) EXPECT_NE(marks[i], number);
  }
  marks.push_back();
  EXPECT_NE(marks[3], marks.fresh());
}

// Numbers run out after hours: then marks are wiped, or an old one would pass for a new one.
TEST(FreshMarks, WipesMarksWhereNumbersRunOut) {
  FreshMarks marks;
  marks.grow_to(2);
  const std::uint32_t early = marks.fresh();
  marks[0] = early;
  marks.fresh(UINT32_MAX - early - 1);
  const std::uint32_t last = marks.fresh();
  EXPECT_EQ(last, UINT32_MAX);
  marks[1] = last;
  const std::uint32_t again = marks.fresh(2);
  EXPECT_EQ(again, early) << "it begins again";
  EXPECT_NE(marks[0], again);
  EXPECT_EQ(marks[1], 0u);
}

}  // namespace
}  // namespace incise::core
