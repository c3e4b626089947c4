#include "server/haptics/blade_probe.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <memory>

#include "server/core/geometry/quality.hpp"
#include "server/core/session/cut_session.hpp"
#include "tests/haptics/random.hpp"
#include "tests/support/bodies.hpp"

namespace incise::haptics {
namespace {

using core::BladeLine;
using core::Vec3;
using tests::Random;

constexpr double kSize = 0.1;

Engagement probe_line(const Tissue& tissue, const Materials& materials, const BladeLine& line) {
  ProbeWork work;
  const Engagement engagement = probe(tissue, materials, tissue.rest().line(line, work), work);
  EXPECT_FALSE(work.cut_short);
  return engagement;
}

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
  const Tissue tissue(tests::cube(9, kSize));
  const Materials materials;
  const std::uint64_t seed = 11;
  SCOPED_TRACE("seed " + std::to_string(seed));
  Random random(seed);
  int met = 0, buried = 0, stabs = 0;
  for (int i = 0; i < 20'000; ++i) {
    const Vec3 low{-0.05, -0.05, -0.05}, high{0.15, 0.15, 0.15};
    BladeLine line{random.in_box(low, high), random.in_box(low, high)};
    if (i % 4 == 0) line.tip = line.heel + 0.1 * (line.tip - line.heel);
    const Engagement e = probe_line(tissue, materials, line);
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
  const Tissue tissue(data);
  Materials materials;
  materials.tissue = {100, 1, 500, 1e4, 10};
  materials.by_region = {{7, {1000, 3, 2000, 5e4, 40}}};
  const Engagement e = probe_line(tissue, materials, {{-0.02, 0.041, 0.043}, {0.12, 0.041, 0.043}});
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
  Tissue tissue(tests::cube(10, kSize));
  tissue.note_cuts(session.mesh());
  const Materials materials;
  int looked = 0;
  for (const core::Pose& pose : poses) {
    const BladeLine line = core::blade_line(config.blade, pose);
    const double expected = inside_cube(line);
    if (expected < 0.05) continue;
    ++looked;
    const Engagement e = probe_line(tissue, materials, line);
    EXPECT_NEAR(e.length_m, expected, 0.02 * expected) << pose.position.y;
    EXPECT_LT(e.uncut_m, 0.1 * expected) << pose.position.y;
  }
  EXPECT_GT(looked, 100);
  // Across the cut all but a little is fresh.
  const Engagement across = probe_line(tissue, materials, {{-0.02, 0.051, 0.043}, {0.12, 0.053, 0.043}});
  EXPECT_NEAR(across.length_m, 0.1, 1e-4);
  EXPECT_GT(across.uncut_m, 0.095);
}

// Passes right through the cube at random places and angles.
std::unique_ptr<core::CutSession> sliced(int passes, Tissue& tissue) {
  core::CutConfig config;
  config.always_engaged = true;
  config.blade = tests::long_blade(kSize);
  auto session = std::make_unique<core::CutSession>(tests::cube(10, kSize), config);
  Random random(3);
  core::Delta delta;
  std::int64_t t_ns = 0;
  for (int pass = 0; pass < passes; ++pass) {
    const double angle = random.uniform(0, 3.14159), aside = random.uniform(-0.04, 0.04);
    const Vec3 way{std::cos(angle), std::sin(angle), 0}, across{-way.y, way.x, 0};
    t_ns += 1'000'000'000;
    for (int i = 0; i <= 20; ++i) {
      core::Pose pose;
      pose.t_ns = t_ns += 50'000'000;
      pose.position = Vec3{0.05, 0.05, 0.12} + aside * across + (0.01 * i - 0.1) * way;
      session->push(0, pose);
    }
    session->end_stroke(0);
    auto budget = core::WorkBudget::unlimited();
    while (session->advance(budget, delta) == core::CutSession::Progress::kCommitted)
      tissue.note_cuts(session->mesh(), delta.boundary_upserted);
  }
  return session;
}

// However often a body has been cut, a frame looks at the same boxes, triangles and tetrahedra as before.
TEST(BladeProbe, ABodyCutToSlicesCostsWhatAFreshOneDoes) {
  const Tissue fresh(tests::cube(10, kSize));
  Tissue cut(tests::cube(10, kSize));
  const auto session = sliced(20, cut);
  ASSERT_GT(session->mesh().live_tets(), 4 * fresh.body().live_tets() / 3);
  const Materials materials;
  Random random(7);
  double fresh_m = 0, uncut_m = 0;
  ProbeWork most;
  for (int i = 0; i < 5000; ++i) {
    const Vec3 low{-0.05, -0.05, -0.05}, high{0.15, 0.15, 0.15};
    BladeLine line{random.in_box(low, high), random.in_box(low, high)};
    if (i % 3 == 0) line.tip = line.heel + 0.1 * (line.tip - line.heel);
    ProbeWork before, after;
    const Engagement a = probe(fresh, materials, fresh.rest().line(line, before), before);
    fresh.surface().nearest(line.tip, 0.03, before);
    const Engagement b = probe(cut, materials, cut.rest().line(line, after), after);
    cut.surface().nearest(line.tip, 0.03, after);
    ASSERT_EQ(a.length_m, b.length_m);
    ASSERT_EQ(before.boxes, after.boxes);
    ASSERT_EQ(before.triangles, after.triangles);
    ASSERT_EQ(before.tets, after.tets);
    ASSERT_FALSE(after.cut_short);
    most.boxes = std::max(most.boxes, after.boxes);
    most.triangles = std::max(most.triangles, after.triangles);
    most.tets = std::max(most.tets, after.tets);
    fresh_m += a.uncut_m;
    uncut_m += b.uncut_m;
  }
  // 6000 tetrahedra, 1200 triangles, some 600 boxes.
  EXPECT_LT(most.boxes, 400u);
  EXPECT_LT(most.triangles, 200u);
  EXPECT_LT(most.tets, 100u);
  EXPECT_LT(uncut_m, 0.95 * fresh_m) << "some of these lines lie in cuts";
  EXPECT_GT(uncut_m, 0.05 * fresh_m) << "most cross them";
}

// What a restart finds in the mesh is what was noted cut by cut, but for faces that later cuts have moved a little.
TEST(BladeProbe, CutsAreFoundAgainInTheMesh) {
  Tissue noted(tests::cube(10, kSize)), found(tests::cube(10, kSize));
  const auto session = sliced(5, noted);
  found.note_cuts(session->mesh());
  const Materials materials;
  Random random(9);
  double differ_m = 0, all_m = 0;
  for (int i = 0; i < 5000; ++i) {
    const BladeLine line{random.in_box({0, 0, 0.1}, {0.1, 0.1, 0.12}),
                         random.in_box({0, 0, -0.02}, {0.1, 0.1, 0})};
    const double a = probe_line(noted, materials, line).uncut_m,
                 b = probe_line(found, materials, line).uncut_m;
    differ_m += std::abs(a - b);
    all_m += a;
  }
  EXPECT_LT(differ_m, 0.01 * all_m);
  noted.heal();
  EXPECT_TRUE(noted.cuts().empty());
  EXPECT_NEAR(probe_line(noted, materials, {{0.05, 0.05, 0.12}, {0.05, 0.05, -0.02}}).uncut_m, kSize, 1e-9);
}

// A body beyond all bounds: what is looked at stays within them, and it is said that this is not all.
TEST(BladeProbe, BoundsHoldForAHostileBody) {
  const Tissue tissue(tests::comb(3000));
  ProbeWork work;
  const Engagement e =
      probe(tissue, {}, tissue.rest().line({{-0.1, 0.01, 0.01}, {0.4, 0.01, 0.01}}, work), work);
  EXPECT_TRUE(work.cut_short);
  EXPECT_LE(work.boxes, ProbeWork::kMostBoxes);
  EXPECT_LE(work.triangles, ProbeWork::kMostTriangles);
  EXPECT_LE(work.tets, ProbeWork::kMostTets);
  EXPECT_GT(e.length_m, 0);
  EXPECT_LT(e.length_m, 0.15);
}

TEST(CutMap, EveryDirectionHasOneNearIt) {
  Random random(2);
  for (int i = 0; i < 2000; ++i) {
    const Vec3 normal = normalized(random.in_box({-1, -1, -1}, {1, 1, 1}));
    const Vec3 u = normalized(cross(normal, std::abs(normal.x) < 0.5 ? Vec3{1, 0, 0} : Vec3{0, 1, 0})),
               w = cross(normal, u);
    CutMap map({0, 0, 0}, {1, 1, 1}, 0.04);
    EXPECT_TRUE(map.empty());
    const Vec3 p{0.5, 0.5, 0.5};
    map.mark(p - 0.1 * u - 0.1 * w, p + 0.1 * u - 0.1 * w, p + 0.2 * w);
    ASSERT_NE(map.at(p), 0);
    ASSERT_NE(map.at(p + 0.003 * normal), 0);
    ASSERT_EQ(map.at(p + 0.03 * normal), 0) << "0.75 h off";
    const double turn = random.uniform(0, 6.28);
    const Vec3 within = std::cos(turn) * u + std::sin(turn) * w;
    ASSERT_NE(map.at(p) & CutMap::along(within), 0) << "an edge in the cut";
    ASSERT_EQ(map.at(p) & CutMap::along(normal), 0) << "an edge across it";
  }
}

TEST(BladeProbe, TheNearestSurfaceIsTheCubesSide) {
  const Tissue tissue(tests::cube(9, kSize));
  Random random(5);
  int found = 0;
  for (int i = 0; i < 2000; ++i) {
    const Vec3 p = random.in_box({0, 0, 0}, {kSize, kSize, kSize});
    const double depth = std::min({p.x, p.y, p.z, kSize - p.x, kSize - p.y, kSize - p.z});
    ProbeWork work;
    const auto surface = tissue.surface().nearest(p, 0.015, work);
    ASSERT_EQ(surface.has_value(), depth < 0.015) << depth;
    if (!surface) continue;
    ++found;
    ASSERT_NEAR(surface->distance_m, depth, 1e-12);
    ASSERT_NEAR(distance(p + depth * surface->normal, surface->point), 0, 1e-9);
  }
  EXPECT_GT(found, 500);
}

TEST(BladeProbe, AnEmptyMeshIsAir) {
  const Tissue tissue{core::MeshData{}};
  ProbeWork work;
  EXPECT_EQ(probe(tissue, {}, tissue.rest().line({{0, 0, 0}, {1, 0, 0}}, work), work).length_m, 0);
  EXPECT_FALSE(tissue.surface().nearest({0, 0, 0}, 1, work).has_value());
}

// The same for one body that the line does not leave.
TEST(BladeProbe, AWalkThroughTooManyTetrahedraIsCutShort) {
  core::MeshData bar;  // of flat cells, one on the other, each six tetrahedra around its diagonal
  const std::uint32_t cells = ProbeWork::kMostTets;
  for (std::uint32_t i = 0; i <= cells; ++i)
    for (const double y : {-1., 1.})
      for (const double z : {-1., 1.}) bar.positions.push_back({1e-4 * i, y, z});
  for (std::uint32_t a = 0; a < 4 * cells; a += 4) {
    std::array<std::uint32_t, 3> way{1, 2, 4};
    do {
      std::array<core::VertexId, 4> tet{a, a + way[0], a + way[0] + way[1], a + 7};
      const auto& p = bar.positions;
      if (core::signed_volume(p[tet[0]], p[tet[1]], p[tet[2]], p[tet[3]]) < 0) std::swap(tet[2], tet[3]);
      bar.tets.push_back(tet);
    } while (std::next_permutation(way.begin(), way.end()));
  }
  const Tissue tissue(bar);
  ProbeWork work;
  probe(tissue, {}, tissue.rest().line({{-0.01, 0.01, 0.02}, {1e-4 * cells + 0.01, 0.02, 0.04}}, work), work);
  EXPECT_LT(work.boxes, ProbeWork::kMostBoxes);
  EXPECT_TRUE(work.cut_short);
  EXPECT_LE(work.tets, ProbeWork::kMostTets);
}

// Through two bodies one behind the other, the front of the blade is where most of it is inside.
TEST(BladeProbe, TheLongestStretchCounts) {
  core::MeshData two = tests::cube(4, kSize);
  const core::MeshData small = tests::cube(2, 0.3 * kSize);
  const auto first = static_cast<core::VertexId>(two.positions.size());
  for (const Vec3& p : small.positions) two.positions.push_back(p + Vec3{2 * kSize, 0, 0});
  for (const auto& t : small.tets)
    two.tets.push_back({t[0] + first, t[1] + first, t[2] + first, t[3] + first});
  two.regions.clear();
  const Tissue tissue(two);
  const Materials materials;
  BladeLine line{{-kSize, 0.011, 0.012}, {3 * kSize, 0.013, 0.014}};
  for (const bool turned : {false, true}) {
    if (turned) std::swap(line.heel, line.tip);
    const Engagement e = probe_line(tissue, materials, line);
    EXPECT_NEAR(e.length_m, 1.3 * kSize, 1e-4);
    EXPECT_NEAR(e.from, turned ? 0.5 : 0.25, 1e-3);
    EXPECT_NEAR(e.to, turned ? 0.75 : 0.5, 1e-3);
  }
}

}  // namespace
}  // namespace incise::haptics
