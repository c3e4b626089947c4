#include "server/haptics/surface_tree.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "server/core/stroke/swept_triangle.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::haptics {
namespace {

using core::BladeLine;
using core::TetMesh;
using core::Vec3;
using core::testing::Random;

std::vector<core::HalfFace> boundary(const TetMesh& mesh) {
  std::vector<core::HalfFace> faces;
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    for (int f = 0; f < 4; ++f) {
      if (mesh.neighbor(t, f) == core::kNone) faces.push_back(core::half_face(t, f));
    }
  }
  return faces;
}

// Every face of the boundary that the line passes, by itself.
std::vector<Crossing> crossings_one_by_one(const TetMesh& mesh, const BladeLine& line) {
  std::vector<Crossing> found;
  for (const core::HalfFace face : boundary(mesh)) {
    const auto v = mesh.face_vertices(face);
    const Vec3 &a = mesh.position(v[0]), &b = mesh.position(v[1]), &c = mesh.position(v[2]);
    const Vec3 n = cross(b - a, c - a), d = line.tip - line.heel;
    const double speed = dot(n, d), at = dot(n, a - line.heel) / speed;
    if (!(at >= 0 && at <= 1)) continue;
    const Vec3 x = line.heel + at * d;
    if (dot(cross(b - a, x - a), n) < 0 || dot(cross(c - b, x - b), n) < 0 || dot(cross(a - c, x - c), n) < 0)
      continue;
    found.push_back({at, face, speed < 0});
  }
  std::sort(found.begin(), found.end(), [](const Crossing& a, const Crossing& b) { return a.at < b.at; });
  return found;
}

TEST(SurfaceTree, FindsAllCrossingsOfALineInOrder) {
  const std::uint64_t seed = 17;
  SCOPED_TRACE(seed);
  Random random(seed);
  const TetMesh mesh(core::testing::shaken_box(7, 6, 5, seed));
  const SurfaceTree tree(mesh);
  std::size_t most = 0;
  for (int i = 0; i < 500; ++i) {
    const BladeLine line{random.in_box({-2, -2, -2}, {9, 8, 7}), random.in_box({-2, -2, -2}, {9, 8, 7})};
    const auto expected = crossings_one_by_one(mesh, line);
    most = std::max(most, expected.size());
    Crossing found[32];
    ProbeWork work;
    const std::size_t count = tree.crossings(line, found, work);
    ASSERT_EQ(count, expected.size());
    for (std::size_t k = 0; k < count; ++k) {
      EXPECT_NEAR(found[k].at, expected[k].at, 1e-9);
      EXPECT_EQ(found[k].face, expected[k].face);
      EXPECT_EQ(found[k].entering, expected[k].entering);
    }
    const auto first = tree.first_crossing(line, work);
    ASSERT_EQ(first.has_value(), !expected.empty());
    if (first) {
      EXPECT_EQ(first->face, expected[0].face);
    }
    EXPECT_FALSE(work.cut_short);
  }
  EXPECT_GE(most, 2u);
}

TEST(SurfaceTree, SaysWhenNotAllCrossingsFit) {
  const TetMesh mesh(core::testing::box(3, 3, 3));
  const SurfaceTree tree(mesh);
  Crossing found[1];
  ProbeWork work;
  EXPECT_EQ(tree.crossings({{1.3, 1.6, -1}, {1.3, 1.6, 4}}, found, work), 1u);
  EXPECT_TRUE(work.cut_short);
}

TEST(SurfaceTree, FindsTheNearestPoint) {
  const std::uint64_t seed = 23;
  SCOPED_TRACE(seed);
  Random random(seed);
  const TetMesh mesh(core::testing::shaken_box(6, 5, 4, seed));
  const SurfaceTree tree(mesh);
  const auto faces = boundary(mesh);
  for (int i = 0; i < 300; ++i) {
    const Vec3 p = random.in_box({-2, -2, -2}, {8, 7, 6});
    const double radius = random.uniform(0.2, 3);
    double nearest = INFINITY;
    for (const core::HalfFace face : faces) {
      const auto v = mesh.face_vertices(face);
      nearest = std::min(nearest, distance(p, core::closest_point(p, mesh.position(v[0]), mesh.position(v[1]),
                                                                  mesh.position(v[2]))));
    }
    ProbeWork work;
    const auto found = tree.nearest(p, radius, work);
    ASSERT_EQ(found.has_value(), nearest < radius) << nearest << " within " << radius;
    if (!found) continue;
    EXPECT_NEAR(found->distance_m, nearest, 1e-12);
    EXPECT_NEAR(distance(found->point, p), nearest, 1e-12);
    EXPECT_NEAR(length(found->normal), 1, 1e-12);
  }
}

TEST(SurfaceTree, NormalsPointOutAndTheBoxHoldsAll) {
  const TetMesh mesh(core::testing::box(4, 3, 2));
  const SurfaceTree tree(mesh);
  ProbeWork work;
  EXPECT_GT(tree.nearest({2.2, 1.4, 2.5}, 1, work)->normal.z, 0.99);
  EXPECT_GT(tree.nearest({2.2, 1.4, 1.9}, 1, work)->normal.z, 0.99) << "from inside, too";
  EXPECT_LT(tree.nearest({-0.5, 1.4, 1.1}, 1, work)->normal.x, -0.99);
  EXPECT_NEAR(distance(tree.low(), {0, 0, 0}), 0, 1e-9);
  EXPECT_NEAR(distance(tree.high(), {4, 3, 2}), 0, 1e-9);
}

TEST(SurfaceTree, NothingHasNoSurface) {
  const TetMesh mesh(core::MeshData{});
  const SurfaceTree tree(mesh);
  Crossing found[4];
  ProbeWork work;
  EXPECT_EQ(tree.crossings({{0, 0, -1}, {0, 0, 1}}, found, work), 0u);
  EXPECT_FALSE(tree.first_crossing({{0, 0, -1}, {0, 0, 1}}, work));
  EXPECT_FALSE(tree.nearest({0, 0, 0}, 9, work));
  EXPECT_EQ(tree.high(), Vec3{});
}

}  // namespace
}  // namespace incise::haptics
