#include "server/core/mesh/boundary_grid.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <vector>

#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using namespace incise::core::testing;

void bounds_of(const TetMesh& mesh, TetId t, Vec3& low, Vec3& high) {
  low = {INFINITY, INFINITY, INFINITY};
  high = {-INFINITY, -INFINITY, -INFINITY};
  for (const VertexId v : mesh.vertices(t)) extend(mesh.position(v), low, high);
}

bool contains(const TetMesh& mesh, TetId t, const Vec3& p, double tolerance = 1e-9) {
  for (int f = 0; f < 4; ++f) {
    const HalfFace h = half_face(t, f);
    if (dot(mesh.twice_area(h), p - mesh.position(mesh.face_vertices(h)[0])) > tolerance) return false;
  }
  return true;
}

// Whether the triangle has a point in t: a fine sample of it.
bool meets(const TetMesh& mesh, TetId t, const SweptTriangle& triangle) {
  constexpr int kSteps = 40;
  for (int i = 0; i <= kSteps; ++i) {
    for (int j = 0; i + j <= kSteps; ++j) {
      const double a = double(i) / kSteps, b = double(j) / kSteps;
      if (contains(mesh, t,
                   a * triangle.corners[0] + b * triangle.corners[1] + (1 - a - b) * triangle.corners[2], 0))
        return true;
    }
  }
  return false;
}

TEST(BoundaryGrid, FindsWhatATriangleMeetsOfTheBoundary) {
  for (std::uint64_t seed = 1; seed <= 25; ++seed) {
    SCOPED_TRACE(seed);
    Random random(seed);
    const TetMesh mesh(shaken_box(5, 4, 3, seed));
    BoundaryGrid grid(mesh);
    SweptTriangle triangle;
    const Vec3 low{-2, -2, -2}, high{7, 6, 5};
    ASSERT_TRUE(make_swept_triangle(random.in_box(low, high), random.in_box(low, high),
                                    random.in_box(low, high), triangle));
    std::vector<TetId> found;
    grid.near(mesh, triangle, 1, found);
    const std::set<TetId> near(found.begin(), found.end());
    for (TetId t = 0; t < mesh.tet_slots(); ++t) {
      if (mesh.boundary_mask(t) == 0) {
        EXPECT_EQ(near.count(t), 0u) << t << " is not at the boundary";
      } else if (meets(mesh, t, triangle)) {
        EXPECT_EQ(near.count(t), 1u) << t;
      }
    }
    // The same search takes no cell twice; another one does.
    found.clear();
    grid.near(mesh, triangle, 1, found);
    EXPECT_TRUE(found.empty());
    grid.near(mesh, triangle, 2, found);
    EXPECT_EQ(std::set<TetId>(found.begin(), found.end()), near);
  }
}

TEST(BoundaryGrid, VisitsWhatABoxMeetsOfTheBoundary) {
  const TetMesh mesh(shaken_box(5, 4, 3, 4));
  const BoundaryGrid grid(mesh);
  Random random(8);
  for (int i = 0; i < 30; ++i) {
    const Vec3 low = random.in_box({-1, -1, -1}, {5, 4, 3}), high = low + random.in_box({0, 0, 0}, {2, 2, 2});
    std::set<TetId> visited;
    grid.visit_box(low, high, [&](TetId t) { visited.insert(t); });
    for (TetId t = 0; t < mesh.tet_slots(); ++t) {
      Vec3 from, to;
      bounds_of(mesh, t, from, to);
      const bool overlaps = from.x <= high.x && to.x >= low.x && from.y <= high.y && to.y >= low.y &&
                            from.z <= high.z && to.z >= low.z;
      if (mesh.boundary_mask(t) == 0 || !overlaps) continue;
      EXPECT_EQ(visited.count(t), 1u) << t;
    }
  }
}

TEST(BoundaryGrid, LocatesPointsInsideAndNothingOutside) {
  const TetMesh mesh(box(6, 5, 4));
  const BoundaryGrid grid(mesh);
  Random random(3);
  for (int i = 0; i < 200; ++i) {
    const Vec3 p = random.in_box({-1, -1, -1}, {7, 6, 5});
    const bool inside = p.x > 0 && p.x < 6 && p.y > 0 && p.y < 5 && p.z > 0 && p.z < 4;
    const TetId t = grid.locate(mesh, p);
    ASSERT_EQ(t != kNone, inside) << p.x << " " << p.y << " " << p.z;
    if (!inside) continue;
    EXPECT_TRUE(contains(mesh, t, p));
  }
}

// What a cut lays open is found, what it takes out is not.
TEST(BoundaryGrid, FollowsCuts) {
  TetMesh mesh(box(4, 4, 4));
  BoundaryGrid grid(mesh);
  const Vec3 p{2.1, 2.3, 3.999};
  const TetId outer = grid.locate(mesh, p);
  ASSERT_NE(outer, kNone);
  ASSERT_NE(mesh.boundary_mask(outer), 0);
  std::vector<TetId> around;
  for (int f = 0; f < 4; ++f) {
    if (mesh.neighbor(outer, f) != kNone) around.push_back(mesh.neighbor(outer, f));
  }
  SweptTriangle triangle;
  ASSERT_TRUE(make_swept_triangle({2.1, 2.3, -9}, {2.1, 9, 9}, {2.1, -9, 9}, triangle));
  std::vector<TetId> found;
  grid.near(mesh, triangle, 1, found);
  EXPECT_GE(std::count(found.begin(), found.end(), outer), 1);

  mesh.remove_tet(outer);
  for (const TetId t : around) grid.add(mesh, t);
  found.clear();
  grid.near(mesh, triangle, 2, found);
  EXPECT_EQ(std::count(found.begin(), found.end(), outer), 0);
  for (const TetId t : around) {
    Vec3 low, high;
    bounds_of(mesh, t, low, high);
    std::set<TetId> visited;
    grid.visit_box(low, high, [&](TetId other) { visited.insert(other); });
    EXPECT_EQ(visited.count(t), 1u) << t;
  }
  EXPECT_EQ(grid.locate(mesh, p), kNone) << "there is a hole now";
}

// In a body that deforms: a vertex may move a tenth of a cell before its tetrahedra are entered again.
TEST(BoundaryGrid, KnowsWhoLeavesItsAnchor) {
  const TetMesh mesh(box(4, 4, 4));
  BoundaryGrid grid({-1, -1, -1}, {5, 5, 5}, 2);
  EXPECT_FALSE(grid.anchored());
  const Vec3 p = mesh.position(7);
  EXPECT_FALSE(grid.leaves_anchor(mesh, 7, p + Vec3{0.15, 0, 0}));
  EXPECT_TRUE(grid.leaves_anchor(mesh, 7, p + Vec3{0.25, 0, 0})) << "its anchor will be where it is";
  grid.give_anchors(mesh);
  EXPECT_TRUE(grid.anchored());
  EXPECT_FALSE(grid.leaves_anchor(mesh, 7, p + Vec3{0.15, 0, 0}));
  EXPECT_TRUE(grid.leaves_anchor(mesh, 7, p + Vec3{0.25, 0, 0}));
  grid.move_anchor(7, p + Vec3{0.25, 0, 0});
  EXPECT_FALSE(grid.leaves_anchor(mesh, 7, p + Vec3{0.4, 0, 0})) << "its anchor is where it went";
  EXPECT_TRUE(grid.leaves_anchor(mesh, 7, p));
  EXPECT_TRUE(grid.contains({4.9, 0, 0}));
  EXPECT_FALSE(grid.contains({0, 9, 0}));
}

}  // namespace
}  // namespace incise::core
