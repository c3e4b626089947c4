#include <gtest/gtest.h>

#include <cmath>

#include "tests/oracle/judge.hpp"
#include "tests/oracle/meetings.hpp"
#include "tests/support/bodies.hpp"

// The judge on cases with known answers: the meshes are taken apart along planes by hand, no cutter is involved.
namespace incise::oracle {
namespace {

using core::Vec3;

// 10 cm, edges of 1 to 1.7 cm.
const core::MeshData& cube() {
  static const core::MeshData mesh = tests::cube(10);
  return mesh;
}
const Body& body() {
  static const Body body(cube());
  return body;
}

// A blade of 20 cm that moves from one heel to another, along its way in steps of 1 mm.
Stroke straight(const Vec3& from, const Vec3& to, const Vec3& blade = {0, 0, 0.2}) {
  Stroke stroke;
  for (int i = 0; i <= 100; ++i) {
    const Vec3 heel = core::lerp(from, to, i / 100.0);
    stroke.lines.push_back({heel, heel + blade});
  }
  return stroke;
}
Stroke plane_at(double x) {
  return straight({x, -0.05, -0.05}, {x, 0.15, -0.05});
}

// The cube with all faces open that lie between tetrahedra for which `side` differs.
template <class Side>
core::TetMesh taken_apart(Side side) {
  core::TetMesh mesh(cube());
  std::vector<core::HalfFace> faces;
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    for (int f = 0; f < 4; ++f) {
      const core::TetId n = mesh.neighbor(t, f);
      if (n != core::kNone && t < n && side(mesh.barycentre(t)) != side(mesh.barycentre(n)))
        faces.push_back(core::half_face(t, f));
    }
  }
  mesh.open_faces(faces);
  core::Delta delta;
  mesh.commit(delta);
  return mesh;
}

TEST(Oracle, GridFindsThePointsOfATetrahedron) {
  const SampleGrid grid({0, 0, 0}, {1, 1, 1}, 0.02);
  const Vec3 corners[4] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  std::size_t points = 0;
  grid.in_tet(corners, [&](std::size_t at) {
    const Vec3 p = grid.point(at);
    EXPECT_GE(std::min({p.x, p.y, p.z}), -1e-12);
    EXPECT_LE(p.x + p.y + p.z, 1 + 1e-12);
    ++points;
  });
  EXPECT_NEAR(static_cast<double>(points) * 0.02 * 0.02 * 0.02, 1.0 / 6, 0.005);
}

TEST(Oracle, ATriangleCrossesEveryWayThroughIt) {
  const SampleGrid grid({0, 0, 0}, {1, 1, 1}, 0.05);
  // A square of two triangles that slopes in all directions: each way along x crosses it once.
  const Vec3 a{0.2, -0.1, -0.1}, b{0.4, 1.1, -0.1}, c{0.8, 1.1, 1.1}, d{0.6, -0.1, 1.1};
  std::vector<int> crossings(grid.size(), 0);
  for (const Triangle& t : {Triangle{{a, b, c}}, Triangle{{a, c, d}}}) {
    grid.crossed_by(t, [&](std::size_t index, int axis, const Vec3& where) {
      EXPECT_LE(core::distance(where, grid.point(index)), 0.05 + 1e-12);
      if (axis == 0) ++crossings[index / grid.step(1)];
    });
  }
  const std::size_t columns = grid.step(2) / grid.step(1);
  for (std::size_t row = 0; row < grid.size() / grid.step(1); ++row) {
    const Vec3 p = grid.point(row * grid.step(1));
    if (p.y > 0 && p.y < 1 && p.z > 0 && p.z < 1) {
      EXPECT_EQ(crossings[row], 1) << row % columns << " " << row / columns;
    }
  }
}

TEST(Oracle, ABodyTakenApartAtThePlaneIsRight) {
  const core::TetMesh mesh = taken_apart([](const Vec3& p) { return p.x > 0.05; });
  const Stroke strokes[] = {plane_at(0.05)};
  const Verdict v = judge(body(), strokes, mesh);
  EXPECT_TRUE(v.right()) << to_string(v);
  EXPECT_EQ(v.pieces, 2u);
  EXPECT_EQ(v.parts, 2u);
  EXPECT_LT(v.alone_max_h, 1e-9);
  EXPECT_LT(std::abs(v.volume_change), 1e-9);
}

TEST(Oracle, OneFaceThatHoldsIsFound) {
  const Stroke strokes[] = {plane_at(0.05)};
  core::TetMesh bridged(cube());
  std::vector<core::HalfFace> faces;
  Vec3 spared{};
  for (core::TetId t = 0; t < bridged.tet_slots(); ++t) {
    for (int f = 0; f < 4; ++f) {
      const core::TetId n = bridged.neighbor(t, f);
      if (n == core::kNone || n < t) continue;
      if ((bridged.barycentre(t).x > 0.05) == (bridged.barycentre(n).x > 0.05)) continue;
      if (spared == Vec3{}) {
        spared = bridged.face_middle(core::half_face(t, f));
        continue;
      }
      faces.push_back(core::half_face(t, f));
    }
  }
  bridged.open_faces(faces);
  const Verdict v = judge(body(), strokes, bridged);
  EXPECT_EQ(v.pieces, 1u);
  EXPECT_EQ(v.joined, 1u) << to_string(v);
  EXPECT_GT(v.joined_h3, 100);
  EXPECT_EQ(v.held_by, 1u);
  EXPECT_LT(core::distance(v.joined_at, spared), 1e-12);
}

TEST(Oracle, WhatNoBladeSeparatesMustHangTogether) {
  const core::TetMesh mesh = taken_apart([](const Vec3& p) { return p.x > 0.05; });
  // The blade goes half of the way.
  const Stroke strokes[] = {straight({0.05, -0.05, -0.05}, {0.05, 0.05, -0.05})};
  const Verdict v = judge(body(), strokes, mesh);
  EXPECT_EQ(v.parts, 1u);
  EXPECT_EQ(v.torn, 1u) << to_string(v);
}

// Two strokes end at gap_h of each other, or of the boundary, on the way through the cube.
struct Gap {
  double gap_h;
  std::uint32_t parts;
};
class OracleGap : public testing::TestWithParam<Gap> {};
INSTANTIATE_TEST_SUITE_P(Gaps, OracleGap,
                         testing::Values(Gap{-0.5, 2}, Gap{0, 2}, Gap{0.2, 2}, Gap{0.5, 1}, Gap{1.5, 1}));

TEST_P(OracleGap, BetweenTwoStrokes) {
  const core::TetMesh mesh(cube());
  const double half = 0.5 * GetParam().gap_h * body().h;
  const Stroke strokes[] = {straight({0.043, -0.05, -0.05}, {0.043, 0.05 - half, -0.05}),
                            straight({0.043, 0.15, -0.05}, {0.043, 0.05 + half, -0.05})};
  const Verdict v = judge(body(), strokes, mesh);
  EXPECT_EQ(v.parts, GetParam().parts) << to_string(v);
  EXPECT_EQ(v.joined, GetParam().parts - 1);
}

TEST_P(OracleGap, BelowTheBoundary) {
  const core::TetMesh mesh(cube());
  const double gap = GetParam().gap_h * body().h;
  const Stroke strokes[] = {straight({0.043, -0.05, -0.05}, {0.043, 0.1 - gap, -0.05})};
  EXPECT_EQ(judge(body(), strokes, mesh).parts, GetParam().parts);
}

TEST_P(OracleGap, BesideAnotherStroke) {
  const core::TetMesh mesh(cube());
  const double gap = GetParam().gap_h * body().h;
  // The second one ends near the first one's rim.
  const Stroke strokes[] = {
      straight({0.043, -0.05, -0.05}, {0.043, 0.055, -0.05}),
      straight({0.043 + std::abs(gap), 0.15, -0.05}, {0.043 + std::abs(gap), 0.045, -0.05})};
  EXPECT_EQ(judge(body(), strokes, mesh).parts, GetParam().gap_h == -0.5 ? 1u : GetParam().parts);
}

TEST(Oracle, ACylinderIsAPartWhereverItsCircleBegins) {
  const core::TetMesh mesh(cube());
  for (const double turns : {0.9, 1.0, 1.1}) {
    Stroke stroke;
    for (int i = 0; i <= 200; ++i) {
      const double angle = 2 * M_PI * turns * i / 200;
      const Vec3 heel{0.05 + 0.03 * std::cos(angle), 0.05 + 0.03 * std::sin(angle), -0.05};
      stroke.lines.push_back({heel, heel + Vec3{0, 0, 0.2}});
    }
    const Stroke strokes[] = {stroke};
    const Verdict v = judge(body(), strokes, mesh);
    EXPECT_EQ(v.parts, turns < 1 ? 1u : 2u) << turns;
    const double h = body().h;
    if (turns >= 1) {
      EXPECT_NEAR(v.joined_h3, M_PI * 0.03 * 0.03 * 0.1 / (h * h * h), 0.03 * v.joined_h3);
    }
  }
}

TEST(Oracle, ATetrahedronCutOffIsACrumb) {
  const Vec3 alone = core::TetMesh(cube()).barycentre(2000);
  const core::TetMesh mesh = taken_apart([&](const Vec3& p) {
    return core::distance(p, alone) < 1e-9 ? 2 : p.x > 0.05 ? 1 : 0;
  });
  const Stroke strokes[] = {plane_at(0.05)};
  const Verdict v = judge(body(), strokes, mesh);
  EXPECT_EQ(v.crumbs + v.torn, 2u) << to_string(v);
  EXPECT_EQ(v.small_crumbs, 1u);
}

// The first stroke takes off a plate of 0.4 h, and a second one runs through the middle of it: what is on either side of that is no
// part, but what the first one took off was.
TEST(Oracle, WhatALaterStrokeShavesIsNoCrumb) {
  core::MeshData plate = cube();
  const double at = 0.1 - 0.4 * body().h;
  for (Vec3& p : plate.positions) {
    if (std::abs(p.x - 0.09) < 1e-9) p.x = at;
  }
  const Body thin(plate);
  core::TetMesh mesh(plate);
  std::vector<core::HalfFace> faces;
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    for (int f = 0; f < 4; ++f) {
      const core::TetId n = mesh.neighbor(t, f);
      if (n != core::kNone && t < n && (mesh.barycentre(t).x > at) != (mesh.barycentre(n).x > at))
        faces.push_back(core::half_face(t, f));
    }
  }
  mesh.open_faces(faces);
  const Stroke strokes[] = {plane_at(at), plane_at(0.5 * (at + 0.1))};
  EXPECT_TRUE(judge(thin, std::span(strokes).first(1), mesh).right());
  EXPECT_TRUE(judge(thin, strokes, mesh).right());
  // The second stroke alone does not take it off there.
  EXPECT_FALSE(judge(thin, std::span(strokes).last(1), mesh).right());
}

TEST(Oracle, PosesBecomeStrokes) {
  core::CutConfig config;
  std::vector<core::Pose> poses;
  for (int i = 0; i < 40; ++i) {
    core::Pose pose;
    pose.t_ns = 10'000'000ll * (i + 1) + (i >= 20 ? 1'000'000'000 : 0);
    pose.position = {0.001 * i, 0, 0};
    pose.buttons = i >= 5 && i < 30 ? 1 : 0;
    poses.push_back(pose);
  }
  const auto strokes = strokes_of(poses, {{0, 0, 0}, {0, 0, 0.1}}, config);
  ASSERT_EQ(strokes.size(), 2u);
  EXPECT_EQ(strokes[0].lines.size(), 15u);
  EXPECT_EQ(strokes[1].lines.size(), 11u);  // up to the pose of the release
}

TEST(Oracle, MeetingsDependOnTheirSeedAlone) {
  for (const std::string_view kind : kMeetingKinds) {
    const Meeting a = random_meeting(cube(), body().h, kind, 3),
                  b = random_meeting(cube(), body().h, kind, 3);
    ASSERT_EQ(a.strokes.size(), b.strokes.size());
    for (std::size_t i = 0; i < a.strokes.size(); ++i) EXPECT_EQ(a.strokes[i], b.strokes[i]);
    EXPECT_NE(a.strokes[0], random_meeting(cube(), body().h, kind, 4).strokes[0]) << kind;
    // The blade is where it was to be.
    for (const auto& stroke : a.strokes) {
      for (const core::Pose& pose : stroke) {
        const core::BladeLine line = core::blade_line(a.blade, pose);
        EXPECT_NEAR(core::distance(line.heel, line.tip), a.blade.tip.z, 1e-9);
      }
    }
  }
}

}  // namespace
}  // namespace incise::oracle
