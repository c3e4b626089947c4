#include "server/mesh_io/triangle_intersection.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <random>

#include "tests/mesh_io/test_meshes.hpp"

namespace incise::mesh_io {
namespace {

using core::Vec3;

// Two triangles over a list of points, and whether they meet beyond what they share.
struct Case {
  const char* name;
  std::vector<Vec3> points;
  std::array<core::VertexId, 3> s, t;
  bool meet;
};

const Case kCases[] = {
    {"apart",
     {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {1, 0, 1}, {0, 1, 1}},
     {0, 1, 2},
     {3, 4, 5},
     false},
    {"an edge pierces",
     {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {1, 1, -1}, {1, 1, 1}, {9, 9, 0.5}},
     {0, 1, 2},
     {3, 4, 5},
     true},
    {"an edge passes by",
     {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {3, 3, -1}, {3, 3, 1}, {9, 9, 0.5}},
     {0, 1, 2},
     {3, 4, 5},
     false},
    {"a vertex touches",
     {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {1, 1, 0}, {1, 1, 1}, {2, 1, 1}},
     {0, 1, 2},
     {3, 4, 5},
     true},
    {"a vertex touches an edge",
     {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {1, 0, 0}, {1, 0, 1}, {1, -1, 1}},
     {0, 1, 2},
     {3, 4, 5},
     true},
    {"edges cross",
     {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {1, 0, -1}, {1, 0, 1}, {1, -3, 0}},
     {0, 1, 2},
     {3, 4, 5},
     true},
    {"one plane, apart",
     {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {2, 2, 0}, {3, 2, 0}, {2, 3, 0}},
     {0, 1, 2},
     {3, 4, 5},
     false},
    {"one plane, overlapping",
     {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {1, 1, 0}, {5, 1, 0}, {1, 5, 0}},
     {0, 1, 2},
     {3, 4, 5},
     true},
    {"one plane, one inside",
     {{0, 0, 0}, {9, 0, 0}, {0, 9, 0}, {1, 1, 0}, {2, 1, 0}, {1, 2, 0}},
     {0, 1, 2},
     {3, 4, 5},
     true},
    {"one plane, a star",
     {{0, 0, 0}, {6, 0, 0}, {3, 6, 0}, {0, 4, 0}, {6, 4, 0}, {3, -2, 0}},
     {0, 1, 2},
     {3, 4, 5},
     true},
    {"one plane, edges on one line",
     {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {1, 0, 0}, {3, 0, 0}, {2, -1, 0}},
     {0, 1, 2},
     {3, 4, 5},
     true},
    {"one plane, edges on one line, apart",
     {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {5, 0, 0}, {7, 0, 0}, {6, -1, 0}},
     {0, 1, 2},
     {3, 4, 5},
     false},
    {"a shared vertex",
     {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {-1, 0, 1}, {0, -1, 1}},
     {0, 1, 2},
     {0, 3, 4},
     false},
    {"a shared vertex, and crossing",
     {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {1, 1, 1}, {1, 1, -1}},
     {0, 1, 2},
     {0, 3, 4},
     true},
    {"a shared vertex, an edge in the other",
     {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {1, 1, 0}, {1, 1, 1}},
     {0, 1, 2},
     {0, 3, 4},
     true},
    {"a shared vertex, edges on one line",
     {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {2, 0, 0}, {2, -1, 1}},
     {0, 1, 2},
     {0, 3, 4},
     true},
    {"a shared vertex in one plane, side by side",
     {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {-1, 0, 0}, {0, -1, 0}},
     {0, 1, 2},
     {0, 3, 4},
     false},
    {"a shared vertex in one plane, overlapping",
     {{0, 0, 0}, {4, 0, 0}, {0, 4, 0}, {5, 1, 0}, {1, 5, 0}},
     {0, 1, 2},
     {0, 3, 4},
     true},
    {"a shared edge", {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, -1, 0}}, {0, 1, 2}, {1, 0, 3}, false},
    {"a shared edge at an angle",
     {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 1, 1e-9}},
     {0, 1, 2},
     {1, 0, 3},
     false},
    {"a shared edge, folded flat",
     {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0.25, 0.5, 0}},
     {0, 1, 2},
     {1, 0, 3},
     true},
    {"the same triangle", {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, {0, 1, 2}, {1, 2, 0}, true},
};

std::vector<Vec3> moved(std::vector<Vec3> points, int variant) {
  for (Vec3& p : points) {
    if (variant & 1) p = {p.z, p.x, p.y};
    if (variant & 2) p = {-p.x, p.y, p.z};
    if (variant & 4) p = {p.x + p.y, p.y - p.x, p.z + 0.5 * p.x};  // exact: a general plane
  }
  return points;
}

TEST(TriangleIntersection, NamedCasesInEveryOrderAndPlane) {
  for (const Case& c : kCases) {
    for (int variant = 0; variant < 8; ++variant) {
      const auto points = moved(c.points, variant);
      auto s = c.s, t = c.t;
      for (int turn = 0; turn < 6; ++turn) {
        std::rotate(s.begin(), s.begin() + 1, s.end());
        if (turn == 3) std::swap(t[0], t[1]);
        std::rotate(t.begin(), t.begin() + (turn & 1), t.end());
        EXPECT_EQ(triangles_meet(points, s, t), c.meet) << c.name << ", variant " << variant;
        EXPECT_EQ(triangles_meet(points, t, s), c.meet) << c.name << ", variant " << variant << ", exchanged";
      }
    }
  }
}

TEST(TriangleIntersection, CollinearExactly) {
  EXPECT_TRUE(is_collinear({0, 0, 0}, {1, 2, 3}, {3, 6, 9}));
  EXPECT_TRUE(is_collinear({1, 1, 1}, {1, 1, 1}, {2, 5, 4}));
  EXPECT_FALSE(is_collinear({0, 0, 0}, {1, 2, 3}, {3, 6, 9 + 1e-15}));
}

// The tree finds the same pairs as looking at all of them.
TEST(TriangleIntersection, SearchAgreesWithAllPairs) {
  for (unsigned seed = 0; seed < 20; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937 random(seed);
    Surface surface;
    const auto coordinate = [&random] { return static_cast<double>(random() % 1000) / 100.0; };
    for (core::VertexId i = 0; i < 120; ++i) {
      const Vec3 at{coordinate(), coordinate(), coordinate()};
      for (int k = 0; k < 3; ++k)
        surface.positions.push_back(at + 0.2 * Vec3{coordinate(), coordinate(), coordinate()});
      surface.triangles.push_back({3 * i, 3 * i + 1, 3 * i + 2});
    }
    std::vector<std::pair<std::size_t, std::size_t>> all;
    for (std::size_t i = 0; i < surface.triangles.size(); ++i) {
      for (std::size_t j = i + 1; j < surface.triangles.size(); ++j) {
        if (triangles_meet(surface.positions, surface.triangles[i], surface.triangles[j]))
          all.emplace_back(i, j);
      }
    }
    EXPECT_FALSE(all.empty());
    EXPECT_EQ(self_intersections(surface, 1'000'000), all);
    EXPECT_EQ(self_intersections(surface, 1).size(), 1u);
  }
}

}  // namespace
}  // namespace incise::mesh_io
