#include "server/haptics/blade_probe.hpp"

#include <gtest/gtest.h>

#include "server/core/cut_session.hpp"
#include "tests/haptics/random.hpp"
#include "tests/support/bodies.hpp"

namespace incise::haptics {
namespace {

using core::BladeLine;
using core::BoundaryGrid;
using core::TetMesh;
using core::Vec3;
using tests::Random;

constexpr double kSize = 0.1;

// The length of the line inside the cube [0, kSize]^3, by its slabs.
double inside_cube(const BladeLine& line) {
  const Vec3 d = line.tip - line.heel;
  const double p[3] = {line.heel.x, line.heel.y, line.heel.z}, v[3] = {d.x, d.y, d.z};
  double from = 0, to = 1;
  for (int i = 0; i < 3; ++i) {
    const double a = (0 - p[i]) / v[i], b = (kSize - p[i]) / v[i];
    from = std::max(from, std::min(a, b));
    to = std::min(to, std::max(a, b));
  }
  return to > from ? (to - from) * length(d) : 0;
}

TEST(BladeProbe, MeasuresAnyLineThroughACube) {
  const TetMesh mesh(tests::cube(9, kSize));
  const BoundaryGrid grid(mesh);
  const Materials materials;
  const std::uint64_t seed = 11;
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  int met = 0, buried = 0, stabs = 0;
  for (int i = 0; i < 20'000; ++i) {
    const Vec3 low{-0.05, -0.05, -0.05}, high{0.15, 0.15, 0.15};
    BladeLine line{random.in_box(low, high), random.in_box(low, high)};
    if (i % 4 == 0) line.tip = line.heel + 0.1 * (line.tip - line.heel);
    const Engagement e = probe(mesh, grid, materials, line);
    const double expected = inside_cube(line);
    ASSERT_NEAR(e.length_m, expected, 1e-9)
        << i << ": " << line.heel.x << ' ' << line.heel.y << ' ' << line.heel.z << " to " << line.tip.x << ' '
        << line.tip.y << ' ' << line.tip.z;
    ASSERT_NEAR(e.uncut_m, expected, 1e-9);
    ASSERT_NEAR(e.fracture_n, expected * materials.tissue.toughness_j_m2, 1e-6);
    met += expected > 0;
    buried += expected > 0.999 * distance(line.heel, line.tip);
    stabs += e.length_m > 0 && ((e.from == 0) != (e.to == 1));
    if (expected > 1e-6) {
      ASSERT_NEAR(e.middle, 0.5 * (e.from + e.to), 1e-6);
      ASSERT_NEAR((e.to - e.from) * distance(line.heel, line.tip), expected, 1e-9);
    }
  }
  EXPECT_GT(met, 5000);
  EXPECT_GT(buried, 500);
  EXPECT_GT(stabs, 1000);
}

TEST(BladeProbe, SumsTheMaterialsAlongTheEdge) {
  core::MeshData data = tests::cube(10, kSize);
  for (std::size_t t = 0; t < data.tets.size(); ++t) {
    double x = 0;
    for (const auto v : data.tets[t]) x += data.positions[v].x / 4;
    data.regions[t] = x < 0.3 * kSize ? 7 : 0;
  }
  const TetMesh mesh(data);
  const BoundaryGrid grid(mesh);
  Materials materials;
  materials.tissue = {100, 1, 500, 1e4, 10};
  materials.by_region = {{7, {1000, 3, 2000, 5e4, 40}}};
  const Engagement e = probe(mesh, grid, materials, {{-0.02, 0.041, 0.043}, {0.12, 0.041, 0.043}});
  EXPECT_NEAR(e.length_m, 0.1, 1e-9);
  EXPECT_NEAR(e.fracture_n, 0.03 * 1000 + 0.07 * 100, 1e-6);
  EXPECT_NEAR(e.friction_n_s_m, 0.03 * 40 + 0.07 * 10, 1e-9);
  EXPECT_NEAR(e.stiffness_n_m, 0.3 * 2000 + 0.7 * 500 + 0.03 * 5e4 + 0.07 * 1e4, 1e-6);
  EXPECT_EQ(e.puncture_n, 3);
}

TEST(BladeProbe, FindsNoFreshTissueInACut) {
  core::CutConfig config;
  config.blade = tests::long_blade(kSize);
  core::CutSession session(tests::cube(10, kSize), config);
  const auto poses = tests::sweep_through(300, 1000, 0.37, kSize);
  for (const core::Pose& pose : poses) session.push(0, pose);
  session.end_stroke(0);
  core::Delta delta;
  auto budget = core::WorkBudget::unlimited();
  while (session.advance(budget, delta) == core::CutSession::Progress::kCommitted) {
  }
  const Materials materials;
  int looked = 0;
  for (const core::Pose& pose : poses) {
    const BladeLine line = core::blade_line(config.blade, pose);
    const double expected = inside_cube(line);
    if (expected < 0.05) continue;
    ++looked;
    const Engagement e = probe(session.mesh(), session.boundary(), materials, line);
    EXPECT_NEAR(e.length_m, expected, 0.02 * expected) << pose.position.y;
    EXPECT_LT(e.uncut_m, 0.1 * expected) << pose.position.y;
  }
  EXPECT_GT(looked, 100);
  // Across the cut all but a little is fresh.
  const Engagement across =
      probe(session.mesh(), session.boundary(), materials, {{-0.02, 0.051, 0.043}, {0.12, 0.053, 0.043}});
  EXPECT_NEAR(across.length_m, 0.1, 1e-4);
  EXPECT_GT(across.uncut_m, 0.095);
}

TEST(BladeProbe, TheNearestSurfaceIsTheCubesSide) {
  const TetMesh mesh(tests::cube(9, kSize));
  const BoundaryGrid grid(mesh);
  Random random(5);
  int found = 0;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 p = random.in_box({0, 0, 0}, {kSize, kSize, kSize});
    const double depth = std::min({p.x, p.y, p.z, kSize - p.x, kSize - p.y, kSize - p.z});
    const auto surface = nearest_surface(mesh, grid, p, 0.015);
    ASSERT_EQ(surface.has_value(), depth < 0.015) << depth;
    if (!surface) continue;
    ++found;
    ASSERT_NEAR(surface->distance_m, depth, 1e-12);
    ASSERT_NEAR(distance(p + depth * surface->normal, surface->point), 0, 1e-9);
  }
  EXPECT_GT(found, 500);
}

TEST(BladeProbe, AnEmptyMeshIsAir) {
  const TetMesh mesh{core::MeshData{}};
  const BoundaryGrid grid(mesh);
  EXPECT_EQ(probe(mesh, grid, {}, {{0, 0, 0}, {1, 0, 0}}).length_m, 0);
  EXPECT_FALSE(nearest_surface(mesh, grid, {0, 0, 0}, 1).has_value());
}

}  // namespace
}  // namespace incise::haptics
