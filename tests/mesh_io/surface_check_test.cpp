#include "server/mesh_io/surface_check.hpp"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/mesh_io/test_meshes.hpp"

namespace incise::mesh_io {
namespace {

using namespace testing;

struct Checked {
  ClosedSurface closed;
  std::string warnings;
};

Checked check(Surface surface) {
  std::vector<std::string> warnings;
  Checked checked{check_surface(std::move(surface), "FILE", warnings), ""};
  for (const auto& warning : warnings) checked.warnings += warning + "\n";
  return checked;
}

std::string refusal(const Surface& surface) {
  return error_of([&] { check(surface); });
}

#define EXPECT_SAYS(text, part) EXPECT_NE((text).find(part), std::string::npos) << (text)

TEST(SurfaceCheck, CubeIsFine) {
  const Checked checked = check(cube());
  EXPECT_EQ(checked.closed.surface.triangles, cube().triangles);
  EXPECT_NEAR(checked.closed.volume, 1, 1e-15);
  EXPECT_EQ(checked.warnings, "");
  EXPECT_TRUE(checked.closed.holes.empty());
  EXPECT_TRUE(checked.closed.regions.empty());
}

TEST(SurfaceCheck, InsideOutIsTurned) {
  const Checked checked = check(inside_out(cube()));
  EXPECT_NEAR(signed_volume(checked.closed.surface), 1, 1e-15);
  EXPECT_SAYS(checked.warnings, "inside out");
}

TEST(SurfaceCheck, SingleTurnedTriangleIsTurnedBack) {
  Surface surface = cube();
  std::swap(surface.triangles[5][0], surface.triangles[5][1]);
  const Checked checked = check(surface);
  EXPECT_NEAR(signed_volume(checked.closed.surface), 1, 1e-15);
  EXPECT_SAYS(checked.warnings,
              "1 triangle was turned over to agree with the neighbours (the first: triangle 5");
}

TEST(SurfaceCheck, OpenSurface) {
  Surface surface = cube();
  surface.triangles.erase(surface.triangles.begin() + 3);
  EXPECT_SAYS(refusal(surface),
              "FILE: the surface is open: 3 edges have one triangle only (the first: triangle");
  surface = cube();
  surface.triangles.resize(1);
  EXPECT_SAYS(refusal(surface), "from (0, 0, 0) to ");
}

TEST(SurfaceCheck, NonManifoldEdge) {
  // Two tetrahedra that share an edge by index.
  Surface surface;
  surface.positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0, -1, 0.5}, {0, -1, -1}};
  const auto add = [&surface](core::VertexId a, core::VertexId b, core::VertexId c, core::VertexId d) {
    for (const auto& t :
         {std::array{a, c, b}, std::array{a, b, d}, std::array{b, c, d}, std::array{a, d, c}}) {
      surface.triangles.push_back(t);
    }
  };
  add(0, 1, 2, 3);
  add(0, 1, 4, 5);
  EXPECT_SAYS(refusal(surface),
              "the surface is non-manifold: 1 edge has more than two triangles (the first: triangle");
  EXPECT_SAYS(refusal(surface), "from (0, 0, 0) to (1, 0, 0)");
  surface.triangles.pop_back();
  EXPECT_SAYS(refusal(surface), "the surface is open: ");
  EXPECT_SAYS(refusal(surface), "; and non-manifold: ");
}

TEST(SurfaceCheck, DegenerateTriangles) {
  Surface surface = cube();
  surface.triangles.push_back({0, 0, 1});
  EXPECT_SAYS(
      refusal(surface),
      "1 triangle is degenerate, without area (the first: triangle 12 (0, 0, 0) (0, 0, 0) (1, 0, 0))");
  surface = cube();
  surface.positions.push_back({0.5, 0, 0});
  surface.triangles.push_back({0, 8, 1});
  EXPECT_SAYS(refusal(surface), "degenerate");
}

TEST(SurfaceCheck, DuplicateTriangles) {
  Surface surface = cube();
  surface.triangles.push_back(surface.triangles[4]);
  EXPECT_SAYS(refusal(surface), "have the same vertices");
  surface.triangles.back() = {5, 1, 0};
  EXPECT_SAYS(refusal(surface), "have the same vertices");
}

TEST(SurfaceCheck, CrossingShells) {
  const std::string error = refusal(both(cube(), cube({0.5, 0.4, 0.3})));
  EXPECT_SAYS(error, "the surface intersects itself: ");
  EXPECT_SAYS(error, "triangles 2 and ");
  EXPECT_SAYS(error, " near (");
}

TEST(SurfaceCheck, TouchingShells) {
  EXPECT_SAYS(refusal(both(cube(), cube({0.25, 0.25, 1}, 0.5))), "cross or touch");
}

TEST(SurfaceCheck, MoebiusStripAndKleinBottleHaveOneSide) {
  // A Klein bottle by index, a torus grid with one seam mirrored; where it lies does not matter, for
  // orientation is looked at before intersections are.
  Surface surface;
  constexpr int kSides = 6;
  for (int i = 0; i < kSides; ++i) {
    for (int j = 0; j < kSides; ++j) {
      surface.positions.push_back(
          {std::cos(i) * (3 + std::cos(j)), std::sin(i) * (3 + std::cos(j)), std::sin(j)});
    }
  }
  const auto at = [](int i, int j) {
    if (i == kSides) j = 2 * kSides - j;
    return static_cast<core::VertexId>((i % kSides) * kSides + j % kSides);
  };
  for (int i = 0; i < kSides; ++i) {
    for (int j = 0; j < kSides; ++j) {
      surface.triangles.push_back({at(i, j), at(i + 1, j), at(i + 1, j + 1)});
      surface.triangles.push_back({at(i, j), at(i + 1, j + 1), at(i, j + 1)});
    }
  }
  EXPECT_SAYS(refusal(surface), "one side only");
}

TEST(SurfaceCheck, SeparateBodies) {
  const Checked checked = check(both(cube(), inside_out(cube({3, 0, 0}))));
  EXPECT_NEAR(checked.closed.volume, 2, 1e-12);
  EXPECT_SAYS(checked.warnings, "1 of 2 shells are inside out");
  EXPECT_TRUE(checked.closed.regions.empty());
}

TEST(SurfaceCheck, ShellAgainstTheOuterOneIsACavity) {
  const Checked checked = check(both(cube({0, 0, 0}, 3), inside_out(cube({1, 1, 1}))));
  EXPECT_NEAR(checked.closed.volume, 26, 1e-12);
  ASSERT_EQ(checked.closed.holes.size(), 1u);
  const core::Vec3 hole = checked.closed.holes[0];
  for (const double x : {hole.x, hole.y, hole.z}) {
    EXPECT_GT(x, 1);
    EXPECT_LT(x, 2);
  }
  EXPECT_EQ(checked.warnings, "");
}

TEST(SurfaceCheck, ShellLikeTheOuterOneIsAnInclusion) {
  const Checked checked = check(both(cube({1, 1, 1}), cube({0, 0, 0}, 3)));
  EXPECT_NEAR(checked.closed.volume, 27, 1e-12);
  ASSERT_EQ(checked.closed.regions.size(), 2u);
  EXPECT_EQ(checked.closed.regions[0].id, 1);
  EXPECT_GT(checked.closed.regions[0].seed.x, 1);
  EXPECT_LT(checked.closed.regions[0].seed.x, 2);
  EXPECT_EQ(checked.closed.regions[1].id, 0);
}

TEST(SurfaceCheck, BodyInACavity) {
  const Checked checked =
      check(both(both(cube({0, 0, 0}, 5), inside_out(cube({1, 1, 1}, 3))), cube({2, 2, 2})));
  EXPECT_NEAR(checked.closed.volume, 125 - 27 + 1, 1e-12);
  EXPECT_EQ(checked.closed.holes.size(), 1u);
  // The seed of the hole is in the cavity, not in the body inside.
  const core::Vec3 hole = checked.closed.holes[0];
  EXPECT_FALSE(hole.x > 2 && hole.x < 3 && hole.y > 2 && hole.y < 3 && hole.z > 2 && hole.z < 3);
}

}  // namespace
}  // namespace incise::mesh_io
