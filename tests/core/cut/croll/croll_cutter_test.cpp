#include "server/core/cut/croll/croll_cutter.hpp"

#include <gtest/gtest.h>

#include "server/core/mesh/measure.hpp"
#include "server/core/mesh/validate.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using testing::Random;

CutCounts cut(TetMesh& mesh, const std::vector<BladeLine>& lines) {
  CrollCutter cutter(mesh);
  Batch batch;
  batch.lines = lines;
  cutter.begin(batch);
  WorkBudget budget = WorkBudget::unlimited();
  EXPECT_EQ(cutter.advance(budget), Cutter::Progress::kDone);
  return cutter.counts();
}

// A blade along z that moves in x at height y.
BladeLine upright(double x, double y = 2, double low = -10, double high = 10) {
  return {{x, y, low}, {x, y, high}};
}

void expect_valid(const TetMesh& mesh, bool orientation = false) {
  EXPECT_EQ(validate(mesh, orientation), "");
}

// The paper's Figure 4: a straight cut right through.
TEST(CrollCutter, SeparatesABoxAcrossTheGrid) {
  TetMesh mesh(testing::shaken_box(6, 5, 4, 1));
  const double volume = measure(mesh).volume;
  const CutCounts counts = cut(mesh, {upright(-5, 2.45), upright(15, 2.55)});
  const CutReport report = measure(mesh);
  expect_valid(mesh);
  EXPECT_EQ(report.pieces - report.islands, 2u);
  EXPECT_GT(counts.snaps, 30u);
  EXPECT_GT(counts.cut_faces, 48u);  // two for each of the 24 cells at least
  EXPECT_EQ(mesh.tet_slots(), 6u * 120) << "the paper adds no tetrahedron";
  EXPECT_EQ(report.tets + counts.removed_tets, 6u * 120);
  // Vertices on the box's side walls slide along them, so the body keeps its volume, all but the rims'
  // roundings.
  EXPECT_NEAR(report.volume, volume, 0.02 * volume);
  EXPECT_NEAR(counts.cut_area, 24, 0.8);
  EXPECT_LT(counts.max_deviation_h, 1e-9);
}

// D = 0: vertices that lie on the plane exactly have nowhere to move, but the cut goes between them.
TEST(CrollCutter, SeparatesAlongAPlaneOfTheGrid) {
  TetMesh mesh(testing::box(4, 4, 4));
  const CutCounts counts = cut(mesh, {upright(-5), upright(15)});
  const CutReport report = measure(mesh);
  expect_valid(mesh, true);
  EXPECT_EQ(report.pieces, 2u);
  EXPECT_EQ(counts.snaps, 0u);
  EXPECT_EQ(counts.removed_tets, 0u);
  EXPECT_EQ(counts.cut_faces, 32u);
  EXPECT_DOUBLE_EQ(counts.cut_area, 16);
  EXPECT_NEAR(report.volume, 64, 1e-9);
  EXPECT_EQ(report.inverted, 0u);
  // All 25 vertices of the layer got one copy each.
  EXPECT_EQ(mesh.vertex_slots(), 125u + 25);
}

// The second move: the cut's last vertices lie on the front plane, its first ones on the back plane.
TEST(CrollCutter, EndsAtTheFrontAndTheBackPlane) {
  TetMesh mesh(testing::shaken_box(10, 4, 4, 3));
  const double from = 2.6, to = 7.45;
  const CutCounts counts = cut(mesh, {upright(from, 2.03), upright(to, 2.03)});
  expect_valid(mesh);
  EXPECT_GT(counts.cut_faces, 20u);
  double low = 100, high = -100;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    for (int f = 0; mesh.alive(t) && f < 4; ++f) {
      if ((mesh.cut_mask(t) >> f & 1) == 0) continue;
      for (VertexId v : mesh.face_vertices(half_face(t, f))) {
        low = std::min(low, mesh.position(v).x);
        high = std::max(high, mesh.position(v).x);
      }
    }
  }
  EXPECT_NEAR(low, from, 1e-9);
  EXPECT_NEAR(high, to, 1e-9);
  EXPECT_EQ(measure(mesh).pieces - measure(mesh).islands, 1u) << "a cut inside the body leaves it whole";
}

TEST(CrollCutter, InteriorVerticesMoveAlongTheNormal) {
  const MeshData data = testing::shaken_box(6, 5, 6, 4);
  TetMesh mesh(data);
  cut(mesh, {upright(-5, 2.4), upright(15, 2.4)});
  std::uint32_t moved = 0;
  for (VertexId v = 0; v < data.positions.size(); ++v) {
    if (mesh.position(v) == data.positions[v]) continue;
    const int i = static_cast<int>(v) % 7, k = static_cast<int>(v) / 42;
    if (i == 0 || i == 6 || k == 0 || k == 6) continue;
    ++moved;
    EXPECT_NEAR(mesh.position(v).y, 2.4, 1e-12);
    EXPECT_NEAR(mesh.position(v).x, data.positions[v].x, 1e-12);
    EXPECT_NEAR(mesh.position(v).z, data.positions[v].z, 1e-12);
  }
  EXPECT_GT(moved, 10u);
}

// Eq. 11-14: with a slanted plane, a vertex on a wall stays in the wall.
TEST(CrollCutter, SurfaceVerticesSlideWithinTheSurface) {
  const MeshData data = testing::box(6, 6, 6);
  TetMesh mesh(data);
  const Vec3 normal = normalized({0.3, 1, 0.2});
  const Vec3 along = normalized(cross(normal, {1, 0, 0})), ahead = normalized(cross(normal, along));
  const Vec3 middle{3.1, 3.2, 2.9};
  const auto line = [&](double s) {
    return BladeLine{middle + s * ahead - 20.0 * along, middle + s * ahead + 20.0 * along};
  };
  cut(mesh, {line(-20), line(20)});
  std::uint32_t moved = 0;
  for (VertexId v = 0; v < data.positions.size(); ++v) {
    const Vec3 &p = data.positions[v], &q = mesh.position(v);
    if (p == q) continue;
    EXPECT_NEAR(dot(q - middle, normal), 0, 1e-12);
    const auto wall = [](double x) { return x == 0 || x == 6; };
    if (wall(p.x) + wall(p.y) + wall(p.z) != 1) continue;  // an edge of the box has no one surface plane
    ++moved;
    if (wall(p.x)) {
      EXPECT_NEAR(q.x, p.x, 1e-12);
    }
    if (wall(p.y)) {
      EXPECT_NEAR(q.y, p.y, 1e-12);
    }
    if (wall(p.z)) {
      EXPECT_NEAR(q.z, p.z, 1e-12);
    }
  }
  EXPECT_GT(moved, 20u);
}

// Section 5 of the paper: two planes where the blade turned out of the plane.
TEST(CrollCutter, TwistedSweepSeparatesWithTwoPlanes) {
  TetMesh mesh(testing::shaken_box(8, 6, 6, 5));
  const BladeLine back{{-1, 2.6, -1}, {-1, 3.4, 7}}, front{{9, 3.3, -1}, {9, 2.5, 7}};
  const CutCounts counts = cut(mesh, {back, front});
  expect_valid(mesh);
  EXPECT_GT(counts.cut_faces, 90u);
  EXPECT_NEAR(counts.cut_area, 48, 2);
}

TEST(CrollCutter, ABladeThatMissesTheBodyChangesNothing) {
  TetMesh mesh(testing::box(3, 3, 3));
  const std::uint64_t hash = mesh.state_hash();
  const CutCounts counts = cut(mesh, {upright(-9, 7), upright(9, 7)});
  Delta delta;
  mesh.commit(delta);
  EXPECT_EQ(counts.cut_faces + counts.snaps + counts.removed_tets + counts.events, 0u);
  EXPECT_EQ(mesh.state_hash(), hash);
  EXPECT_TRUE(delta.upserted.empty() && delta.moved.empty() && delta.removed.empty());
}

TEST(CrollCutter, DegenerateSweepsCutNothing) {
  const BladeLine here = upright(1.5);
  const BladeLine slid{here.heel + Vec3{0, 0, 3}, here.tip + Vec3{0, 0, 3}};       // along itself
  const BladeLine point{{1, 1, 1}, {1, 1, 1}}, other_point{{2, 2, 2}, {2, 2, 2}};  // a blade without length
  const std::vector<std::vector<BladeLine>> cases{{here}, {here, here}, {here, slid}, {point, other_point}};
  for (const auto& lines : cases) {
    TetMesh mesh(testing::box(3, 3, 3));
    const CutCounts counts = cut(mesh, lines);
    EXPECT_EQ(counts.cut_faces + counts.snaps + counts.removed_tets, 0u);
    expect_valid(mesh, true);
  }
}

// The plane of the box's own top: no line where surface plane and cut plane meet.
TEST(CrollCutter, CutInThePlaneOfTheSurface) {
  for (double y : {0.0, 1e-9, 0.3, 3.0, 2.9999}) {
    TetMesh mesh(testing::box(4, 3, 4));
    cut(mesh, {upright(-5, y), upright(15, y)});
    expect_valid(mesh);
    for (VertexId v = 0; v < mesh.vertex_slots(); ++v) {
      ASSERT_LT(length(mesh.position(v)), 50) << "y = " << y << ": vertex " << v << " flew off";
    }
  }
}

// The blade turns about its heel, and about a point between heel and tip.
TEST(CrollCutter, PivotingBlade) {
  for (const Vec3 pivot : {Vec3{-1, 2.05, 3}, Vec3{3, 2.05, 3}}) {
    TetMesh mesh(testing::shaken_box(6, 4, 6, 6));
    std::vector<BladeLine> lines;
    for (double angle = -1; angle <= 1; angle += 0.5) {
      const Vec3 u{std::cos(angle), 0, std::sin(angle)};
      lines.push_back({pivot - (pivot.x > 0 ? 4.0 : 0.0) * u, pivot + 9.0 * u});
    }
    const CutCounts counts = cut(mesh, lines);
    EXPECT_GT(counts.cut_faces, 10u);
    expect_valid(mesh);
  }
}

TEST(CrollCutter, TheBudgetDecidesWhenNotWhat) {
  const MeshData data = testing::shaken_box(8, 5, 5, 7);
  Batch batch;
  for (double x = -1; x <= 9; x += 1.25) batch.lines.push_back(upright(x, 2.4 + 0.05 * x));
  TetMesh whole(data), stepped(data);
  CrollCutter in_one(whole), in_steps(stepped);
  in_one.begin(batch);
  in_steps.begin(batch);
  WorkBudget unlimited = WorkBudget::unlimited();
  ASSERT_EQ(in_one.advance(unlimited), Cutter::Progress::kDone);
  EXPECT_LE(INT64_MAX - unlimited.left, 8 * 2 * (stepped.vertex_slots() + 200 + stepped.tet_slots()));
  EXPECT_GE(INT64_MAX - unlimited.left, 8 * (stepped.vertex_slots() + stepped.tet_slots()));
  int calls = 1;
  for (WorkBudget one{1}; in_steps.advance(one) != Cutter::Progress::kDone; one = {1}) {
    ++calls;
    expect_valid(stepped);
  }
  EXPECT_GE(calls, 8);
  Delta a, b;
  whole.commit(a);
  stepped.commit(b);
  EXPECT_EQ(a.state_hash, b.state_hash);
  EXPECT_EQ(a.upserted, b.upserted);
}

// Whatever it is given, the baseline ends, keeps the topology right and the coordinates finite; its deltas
// say all.
TEST(CrollCutter, RandomStrokesKeepTheTopology) {
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random(seed);
    TetMesh mesh(testing::shaken_box(4, 4, 4, seed));
    testing::PlainModel model(mesh);
    for (int stroke = 0; stroke < 6; ++stroke) {
      std::vector<BladeLine> lines;
      Vec3 heel = random.in_box({-2, -2, -2}, {6, 6, 6}), tip = heel + 6.0 * random.direction();
      const double step = std::pow(10.0, random.uniform(-3, 0.7));
      const std::uint32_t count = 2 + random.below(8);
      for (std::uint32_t i = 0; i < count; ++i) {
        lines.push_back({heel, tip});
        heel += step * random.direction();
        tip += step * random.direction();
      }
      cut(mesh, lines);
      ASSERT_EQ(validate(mesh, false), "");
      Delta delta;
      mesh.commit(delta);
      model.apply(delta);
      model.expect_equals(mesh);
      if (HasFatalFailure()) return;
    }
  }
}

// The paper's setting: both cylinders are cut in two by one segment.
TEST(CrollCutter, CutsTheSeedCylindersInTwo) {
  if (testing::data_folder().empty()) GTEST_SKIP() << "INCISE_DATA names no folder with meshes/seed_*";
  for (const char* name : {"seed_1720", "seed_3234"}) {
    const MeshData data = testing::real_mesh(std::string(name) + ".node");
    TetMesh mesh(data);
    ASSERT_EQ(validate(mesh), "");
    const CutReport before = measure(mesh);
    Vec3 low = data.positions[0], high = low;
    for (const Vec3& p : data.positions) {
      extend(p, low, high);
    }
    const Vec3 middle = 0.5 * (low + high), normal = normalized({0.31, 0.17, 1});
    const Vec3 along = normalized(cross(normal, {1, 0, 0})), ahead = cross(normal, along);
    const BladeLine back{middle - 0.2 * ahead - 0.2 * along, middle - 0.2 * ahead + 0.2 * along};
    const BladeLine front{middle + 0.2 * ahead - 0.2 * along, middle + 0.2 * ahead + 0.2 * along};
    const CutCounts counts = cut(mesh, {back, front});
    const CutReport after = measure(mesh);
    expect_valid(mesh);
    EXPECT_EQ(after.pieces - after.islands, 2u) << name;
    EXPECT_EQ(after.tets + counts.removed_tets, before.tets) << name;
    EXPECT_NEAR(after.volume, before.volume, 0.01 * before.volume) << name;
    EXPECT_GT(after.vertices, before.vertices) << name;
    // A plane through the cylinder of radius 25 mm: an ellipse.
    EXPECT_NEAR(counts.cut_area, 3.14159 * 0.025 * 0.025 / std::abs(normal.z), 1e-4) << name;
  }
}

}  // namespace
}  // namespace incise::core
