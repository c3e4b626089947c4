#include "server/core/mesh/measure.hpp"

#include <gtest/gtest.h>

#include <numeric>

#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using testing::Random;

TEST(Measure, AnUncutBox) {
  TetMesh mesh(testing::box(3, 2, 4, 0.5));
  const CutReport report = measure(mesh);
  EXPECT_EQ(report.vertices, 4u * 3 * 5);
  EXPECT_EQ(report.tets, 6u * 24);
  EXPECT_EQ(report.pieces, 1u);
  EXPECT_EQ(report.islands, 0u);
  EXPECT_EQ(report.largest_piece, 144u);
  EXPECT_EQ(report.boundary_faces, 2u * 2 * (3 * 2 + 2 * 4 + 3 * 4));
  EXPECT_EQ(report.cut_sides, 0u);
  EXPECT_EQ(report.cut_area, 0);
  EXPECT_NEAR(report.volume, 24 * 0.125, 1e-12);
  EXPECT_EQ(report.inverted, 0u);
  EXPECT_NEAR(report.min_dihedral_deg, 45, 1e-5);  // of every Kuhn tetrahedron
  EXPECT_EQ(std::accumulate(report.dihedral_histogram.begin(), report.dihedral_histogram.end(), 0u), 144u);
  EXPECT_EQ(report.dihedral_histogram[8] + report.dihedral_histogram[9], 144u);
}

TEST(Measure, NothingAtAll) {
  const CutReport report = measure(TetMesh(MeshData{}));
  EXPECT_EQ(report.tets + report.vertices + report.pieces + report.inverted, 0u);
  EXPECT_EQ(report.min_dihedral_deg, 0);
}

TEST(Measure, OpenedFacesCountOnceAndPiecesByFaces) {
  TetMesh mesh(testing::box(2, 1, 1));
  std::vector<HalfFace> faces;
  for (TetId t = 0; t < 6; ++t) {
    for (int f = 0; f < 4; ++f) {
      if (mesh.neighbor(t, f) != kNone && mesh.neighbor(t, f) >= 6) faces.push_back(half_face(t, f));
    }
  }
  ASSERT_EQ(mesh.open_faces(faces), 2u);
  const CutReport report = measure(mesh);
  EXPECT_EQ(report.cut_sides, 4u);
  EXPECT_EQ(report.cut_faces, 2u);
  EXPECT_DOUBLE_EQ(report.cut_area, 1);
  EXPECT_EQ(report.pieces, 2u);
  EXPECT_EQ(report.islands, 2u);
  EXPECT_EQ(report.largest_piece, 6u);
  EXPECT_EQ(report.vertices, 16u);
  const auto piece = label_pieces(mesh);
  for (TetId t = 0; t < 12; ++t) EXPECT_EQ(piece[t], t / 6);
  mesh.remove_tet(0);
  EXPECT_EQ(label_pieces(mesh)[0], kNone);
  EXPECT_EQ(measure(mesh).tets, 11u);
}

TEST(Measure, InvertedAndFlatTetrahedra) {
  TetMesh mesh(testing::two_tets());
  mesh.move_vertex(4, {0, 0, 0});
  EXPECT_EQ(measure(mesh).inverted, 1u);
  EXPECT_GT(measure(mesh).min_dihedral_deg, 10) << "an angle is an angle, whichever way round";
  mesh.move_vertex(4, {0.25, 0.25, 0.5});
  const CutReport flat = measure(mesh);
  EXPECT_EQ(flat.inverted, 1u);
  EXPECT_EQ(flat.min_dihedral_deg, 0);
  EXPECT_EQ(flat.dihedral_histogram[0], 1u);
}

// A hyperbolic paraboloid: the facets of add_sweep stay within the tolerance of it, everywhere.
TEST(Measure, SweepFollowsTheRuledQuad) {
  const BladeLine a{{0, 0, 0}, {0, 1, 0}}, b{{2, 0, 0}, {2, 0.9, 0.8}};
  for (double tolerance : {1.0, 0.05, 0.005, 0.0005}) {
    SweptSurface surface;
    add_sweep(surface, std::vector{a, b}, tolerance);
    surface.build();
    Random random(3);
    double worst = 0;
    for (int i = 0; i < 2000; ++i) {
      const double s = random.uniform(0, 1), c = random.uniform(0, 1);
      const Vec3 p = lerp(lerp(a.heel, b.heel, s), lerp(a.tip, b.tip, s), c);
      Vec3 closest;
      std::uint32_t triangle = 0;
      ASSERT_TRUE(surface.closest(p, 100, closest, triangle));
      worst = std::max(worst, distance(p, closest));
    }
    EXPECT_LE(worst, tolerance);
    if (tolerance <= 0.05) {
      EXPECT_GT(worst, 0.02 * tolerance) << "far more triangles than the tolerance asks for";
    }
  }
}

TEST(Measure, DeviationOfFacesThatLieOffTheSweep) {
  TetMesh mesh(testing::box(2, 1, 1));
  std::vector<HalfFace> faces;
  for (TetId t = 0; t < 6; ++t) {
    for (int f = 0; f < 4; ++f) {
      if (mesh.neighbor(t, f) != kNone && mesh.neighbor(t, f) >= 6) faces.push_back(half_face(t, f));
    }
  }
  SweptSurface nothing;
  mesh.open_faces(faces);
  EXPECT_EQ(deviation(mesh, nothing).samples, 0u);
  // The cut faces lie in x = 1, the blade went through x = 1.25.
  SweptSurface surface;
  add_sweep(surface, std::vector<BladeLine>{{{1.25, -5, -5}, {1.25, -5, 5}}, {{1.25, 5, -5}, {1.25, 5, 5}}},
            0.01);
  surface.build();
  const Deviation result = deviation(mesh, surface);
  EXPECT_EQ(result.samples, 4u * 28);
  EXPECT_NEAR(result.max_m, 0.25, 1e-12);
  EXPECT_DOUBLE_EQ(result.max_h, 0.25 / mesh.mean_edge_length());
  EXPECT_GT(result.mean_h, 0.1);
  EXPECT_LE(result.mean_h, result.max_h);
}

}  // namespace
}  // namespace incise::core
