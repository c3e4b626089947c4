#include "server/core/cut/sweep_ends.hpp"

#include <gtest/gtest.h>

#include <array>

namespace incise::core {
namespace {

const Vec3 kLow{-1, -1, -1}, kHigh{1, 1, 1};

// A blade along z, 10 long, that has come along x to `x`.
BladeLine line_at(double x) {
  return {{x, 0, -5}, {x, 0, 5}};
}

void add(SweepEnds& ends, std::uint32_t stroke, double x) {
  const std::array<BladeLine, 3> lines{line_at(x), line_at(x - 0.1), line_at(x - 0.2)};
  ends.add(stroke, 1.5, lines.data(), lines.size(), 0.5, kLow, kHigh);
}

TEST(SweepEnds, KeepWhatOfTheBladeIsNearTheTissue) {
  SweepEnds ends;
  add(ends, 7, 0.5);
  ASSERT_EQ(ends.size(), 1u);
  const SweepEnd& end = ends[0];
  EXPECT_EQ(end.stroke, 7u);
  EXPECT_EQ(end.line_count, 3u);
  EXPECT_EQ(end.part_count, 4u);
  EXPECT_EQ(end.taken, 0u);
  EXPECT_EQ(end.at(0, 0), (Vec3{0.5, 0, -1}));
  EXPECT_EQ(end.at(0, 4), (Vec3{0.5, 0, 1}));
  EXPECT_EQ(end.at(2, 2).z, 0);
  EXPECT_DOUBLE_EQ(end.at(2, 2).x, 0.3);
  EXPECT_EQ(end.low.z, -1);
  EXPECT_EQ(end.high.z, 1);
}

TEST(SweepEnds, LeaveOutWhatEndsOutsideOfTheTissue) {
  SweepEnds ends;
  add(ends, 1, 1.1);
  EXPECT_EQ(ends.size(), 0u);
}

TEST(SweepEnds, ForgetTheOldest) {
  SweepEnds ends;
  for (std::uint32_t stroke = 1; stroke <= 100; ++stroke) add(ends, stroke, 0);
  ASSERT_EQ(ends.size(), 64u);
  EXPECT_EQ(ends[0].stroke, 37u);
  EXPECT_EQ(ends[63].stroke, 100u);
}

TEST(SweepEnds, ComeBackAsTheyWereSaved) {
  SweepEnds ends;
  add(ends, 3, 0.25);
  ends[0].taken = 5;
  Archive out;
  ends.archive(out);
  const auto bytes = out.take();
  SweepEnds back;
  Archive in(bytes);
  back.archive(in);
  ASSERT_FALSE(in.failed()) << in.error();
  ASSERT_EQ(back.size(), 1u);
  EXPECT_EQ(back[0].stroke, 3u);
  EXPECT_EQ(back[0].travel_m, 1.5);
  EXPECT_EQ(back[0].taken, 5u);
  EXPECT_EQ(back[0].at(2, 3), ends[0].at(2, 3));
  EXPECT_EQ(back[0].high, ends[0].high);

  // A count of lines that no end has.
  auto damaged = bytes;
  damaged[8 + 4 + 8] = std::byte{SweepEnd::kMaxLines + 1};
  SweepEnds refused;
  Archive bad(damaged);
  refused.archive(bad);
  EXPECT_EQ(bad.error(), "the end of a sweep has too few or too many lines");
}

}  // namespace
}  // namespace incise::core
