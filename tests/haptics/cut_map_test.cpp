#include "server/haptics/cut_map.hpp"

#include <gtest/gtest.h>

#include <cmath>
#include <utility>

namespace incise::haptics {
namespace {

using core::Vec3;

constexpr Vec3 kLow{0, 0, 0}, kHigh{1, 1, 1};
constexpr double kH = 0.1;  // cells of 0.025, marked 0.01 to both sides

TEST(CutMap, KnowsWhatACutFaceCovers) {
  CutMap map(kLow, kHigh, kH);
  EXPECT_TRUE(map.empty());
  EXPECT_DOUBLE_EQ(map.cell(), 0.025);
  const Vec3 a{0.31, 0.31, 0.51}, b{0.61, 0.31, 0.51}, c{0.31, 0.61, 0.51};
  map.mark(a, b, c);
  EXPECT_FALSE(map.empty());
  // Every place on it, none well off it.
  for (int i = 0; i <= 30; ++i) {
    for (int j = 0; i + j <= 30; ++j)
      ASSERT_NE(map.at(a + (i / 30.0) * (b - a) + (j / 30.0) * (c - a)), 0) << i << ", " << j;
  }
  EXPECT_EQ(map.at({0.4, 0.4, 0.56}), 0);
  EXPECT_EQ(map.at({0.4, 0.4, 0.46}), 0);
  EXPECT_EQ(map.at({0.6, 0.6, 0.51}), 0);
  EXPECT_EQ(map.at({0.25, 0.4, 0.51}), 0);
}

TEST(CutMap, CountsBothSidesOfACut) {
  CutMap map(kLow, kHigh, kH);
  // Just above a cell's floor: 0.01 below is the next cell.
  map.mark({0.3, 0.3, 0.505}, {0.6, 0.3, 0.505}, {0.3, 0.6, 0.505});
  EXPECT_NE(map.at({0.4, 0.4, 0.51}), 0);
  EXPECT_NE(map.at({0.4, 0.4, 0.49}), 0);
  EXPECT_EQ(map.at({0.4, 0.4, 0.54}), 0);
}

// Cuts across each other in one cell: an edge within the one crosses the other.
TEST(CutMap, KeepsDirectionsApart) {
  CutMap map(kLow, kHigh, kH);
  map.mark({0.3, 0.3, 0.51}, {0.6, 0.3, 0.51}, {0.3, 0.6, 0.51});
  const Vec3 p{0.4, 0.4, 0.51}, along_x{1, 0, 0}, along_z{0, 0, 1};
  EXPECT_NE(map.at(p) & CutMap::along(along_x), 0);
  EXPECT_EQ(map.at(p) & CutMap::along(along_z), 0);
  map.mark({0.41, 0.3, 0.4}, {0.41, 0.6, 0.4}, {0.41, 0.3, 0.9});
  EXPECT_NE(map.at(p) & CutMap::along(along_z), 0);
}

// An edge is within a cut that it meets at 35 degrees, and crosses one that it meets at 58: two directions that the map keeps exactly.
TEST(CutMap, FortyDegreesAreBetweenWithinAndAcross) {
  const double g = 0.5 * (1 + std::sqrt(5.0));
  const Vec3 p{0.5, 0.5, 0.5}, edge{0, 0, 1};
  for (const auto& [normal, within] : {std::pair(Vec3{1, 1, 1}, true), std::pair(Vec3{0, 1, g}, false)}) {
    const Vec3 u = 0.2 * normalized(cross(normal, Vec3{1, 0, 0})), v = 0.2 * normalized(cross(normal, u));
    CutMap map(kLow, kHigh, kH);
    map.mark(p - 0.3 * u - 0.3 * v, p + 0.7 * u - 0.3 * v, p - 0.3 * u + 0.7 * v);
    ASSERT_NE(map.at(p), 0);
    EXPECT_EQ((map.at(p) & CutMap::along(edge)) != 0, within) << normal.z;
  }
}

TEST(CutMap, ClearsAndTakesNothingFromOutside) {
  CutMap map(kLow, kHigh, kH);
  map.mark({0.3, 0.3, 0.51}, {0.3, 0.3, 0.51}, {0.6, 0.3, 0.51});
  EXPECT_TRUE(map.empty()) << "a line covers nothing";
  map.mark({2, 2, 2}, {3, 2, 2}, {2, 3, 2});
  EXPECT_EQ(map.at({2, 2, 2}), 0);
  EXPECT_EQ(map.at({-1, 0.5, 0.5}), 0);
  map.mark({0.3, 0.3, 0.51}, {0.6, 0.3, 0.51}, {0.3, 0.6, 0.51});
  map.clear();
  EXPECT_TRUE(map.empty());
  EXPECT_EQ(map.at({0.4, 0.4, 0.51}), 0);
}

// 16 million cells at most: wider ones in a large body.
TEST(CutMap, HasWiderCellsInALargeBody) {
  const CutMap map({0, 0, 0}, {10, 10, 10}, 0.02);
  EXPECT_GE(map.cell(), 10.0 / 252);
  EXPECT_EQ(map.at({9.99, 9.99, 9.99}), 0);
  const CutMap none({0, 0, 0}, {1, 1, 1}, 0);
  EXPECT_EQ(none.at({0.5, 0.5, 0.5}), 0) << "a body without an edge";
}

}  // namespace
}  // namespace incise::haptics
