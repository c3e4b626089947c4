#include "server/core/mesh/vertex_star.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <set>
#include <vector>

#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using namespace incise::core::testing;

constexpr auto kNoneOnSurface = [](VertexId) { return false; };

// The middle vertex of a box of 2 x 2 x 2 cubes.
constexpr VertexId kMiddle = 13;

double worst_of_star(const TetMesh& mesh, VertexId v, const Vec3& p, const std::set<TetId>& without = {}) {
  std::vector<Corner> star;
  mesh.star(v, star);
  double worst = -1;
  for (const Corner corner : star) {
    const TetId t = tet_of(corner);
    if (without.count(t) > 0) continue;
    Vec3 at[4];
    for (int i = 0; i < 4; ++i) at[i] = i == index_of(corner) ? p : mesh.position(mesh.vertices(t)[i]);
    worst = std::max(worst, worst_dihedral(at[0], at[1], at[2], at[3]));
  }
  return worst;
}

// The lanes give what one tetrahedron after the other gives, but for which of its vertices comes first.
TEST(VertexStar, WorstAtIsThatOfTheWorstTetrahedron) {
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    SCOPED_TRACE(seed);
    Random random(seed);
    const TetMesh mesh(shaken_box(2, 2, 2, seed));
    VertexStar star;
    const auto v = static_cast<VertexId>(random.below(mesh.vertex_slots()));
    star.gather(mesh, v, kNoneOnSurface);
    EXPECT_NEAR(star.worst_now(), worst_of_star(mesh, v, mesh.position(v)), 1e-9);
    std::vector<TetId> flat;
    for (int i = 0; i < 20; ++i) {
      const Vec3 p = mesh.position(v) + random.in_box({-0.7, -0.7, -0.7}, {0.7, 0.7, 0.7});
      EXPECT_NEAR(star.worst_at(p, kInverted, 0.01, flat), worst_of_star(mesh, v, p), 1e-9);
      EXPECT_TRUE(flat.empty());
      // Beyond the limit it only says that it is beyond.
      EXPECT_EQ(star.worst_at(p, 0.5, 0.01, flat) > 0.5, worst_of_star(mesh, v, p) > 0.5);
    }
  }
}

// Tetrahedra whose other vertices lie on the surface may become flat: they are listed and do not count.
TEST(VertexStar, FlatTetrahedraOnTheSurfaceDoNotCount) {
  const TetMesh mesh(shaken_box(2, 2, 2, 9));
  std::vector<Corner> corners;
  mesh.star(kMiddle, corners);
  const TetId t = tet_of(corners[3]);
  std::set<VertexId> on(mesh.vertices(t).begin(), mesh.vertices(t).end());
  VertexStar star;
  star.gather(mesh, kMiddle, [&](VertexId v) { return on.count(v) > 0; });
  const auto face = mesh.face_vertices(corners[3]);
  const Vec3 p = (1.0 / 3.0) * (mesh.position(face[0]) + mesh.position(face[1]) + mesh.position(face[2]));
  std::vector<TetId> flat;
  const double worst = star.worst_at(p, kInverted, 0.01, flat);
  EXPECT_EQ(flat, std::vector<TetId>{t});
  EXPECT_NEAR(worst, worst_of_star(mesh, kMiddle, p, {t}), 1e-9);
  EXPECT_LT(worst, kInverted);
  star.worst_at(mesh.position(kMiddle), kInverted, 0.01, flat);
  EXPECT_TRUE(flat.empty()) << "it is not flat where it is";
}

TEST(VertexStar, KeepsTheBoundaryWhereItIs) {
  const TetMesh mesh(box(2, 2, 2));
  VertexStar star;
  star.gather(mesh, kMiddle, kNoneOnSurface);
  EXPECT_FALSE(star.on_boundary());
  EXPECT_TRUE(star.keeps_boundary({1.4, 0.6, 1.2}));

  const VertexId on_top = 22;  // (1, 1, 2)
  star.gather(mesh, on_top, kNoneOnSurface);
  EXPECT_TRUE(star.on_boundary());
  EXPECT_EQ(star.walls().size(), 6u);
  EXPECT_NEAR(star.wall_area().z, 3.0, 1e-12);
  const Vec3& p = star.position();
  EXPECT_TRUE(star.keeps_boundary(p + Vec3{0.3, -0.2, 0}));
  EXPECT_FALSE(star.keeps_boundary(p + Vec3{0, 0, 0.06 * star.local_h()}));
  EXPECT_FALSE(star.keeps_boundary(p - Vec3{0, 0, 0.01 * star.local_h()})) << "the volume counts, too";

  const VertexId on_edge = 19;  // (1, 0, 2)
  star.gather(mesh, on_edge, kNoneOnSurface);
  EXPECT_TRUE(star.keeps_boundary(star.position() + Vec3{0.3, 0, 0}));
  EXPECT_FALSE(star.keeps_boundary(star.position() + Vec3{0, 0.3, 0}));
}

// A face between two regions is as fixed as the boundary; one that a cut has opened says so.
// Going on along its axis, a needle's tip stays near the planes of its faces and wins next to no volume: it could go on for ever.
TEST(VertexStar, ATipIsNotDrawnOutOfTheBody) {
  MeshData needle;
  needle.positions = {{0, 0, 0}, {0.05, 0, 0}, {0, 0.05, 0}, {0, 0, 1}};
  needle.tets = {{0, 1, 2, 3}};
  const TetMesh mesh(needle);
  VertexStar star;
  star.gather(mesh, 3, kNoneOnSurface);
  EXPECT_FALSE(star.keeps_boundary({0, 0, 1.3}));
  EXPECT_FALSE(star.keeps_boundary({0, 0, 0.9}));
  EXPECT_TRUE(star.keeps_boundary({0, 0, 1.005}));
  // Sideways it wins nothing.
  EXPECT_TRUE(star.keeps_boundary({0.01, 0.01, 1}));
}

TEST(VertexStar, RegionsAndCutsMakeWalls) {
  MeshData data = box(2, 2, 2);
  for (const auto& tet : data.tets) {
    double x = 0;
    for (const VertexId v : tet) x += 0.25 * data.positions[v].x;
    data.regions.push_back(x < 1 ? 1 : 2);
  }
  TetMesh mesh(data);
  VertexStar star;
  star.gather(mesh, kMiddle, kNoneOnSurface);
  EXPECT_TRUE(star.on_boundary());
  EXPECT_TRUE(star.keeps_boundary(star.position() + Vec3{0, 0.3, 0.1}));
  EXPECT_FALSE(star.keeps_boundary(star.position() + Vec3{0.3, 0, 0}));
  EXPECT_TRUE(std::ranges::none_of(star.walls(), [](const VertexStar::Wall& wall) { return wall.cut; }));

  std::vector<Corner> corners;
  mesh.star(kMiddle, corners);
  int face = 0;
  while (face == index_of(corners[0]) || mesh.opposite(half_face(tet_of(corners[0]), face)) == kNone) ++face;
  const HalfFace opened[] = {half_face(tet_of(corners[0]), face)};
  mesh.open_faces(opened);
  star.gather(mesh, kMiddle, kNoneOnSurface);
  EXPECT_TRUE(std::ranges::any_of(star.walls(), [](const VertexStar::Wall& wall) { return wall.cut; }));
}

}  // namespace
}  // namespace incise::core
