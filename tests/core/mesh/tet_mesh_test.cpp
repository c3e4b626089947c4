#include "server/core/mesh/tet_mesh.hpp"

#include <gtest/gtest.h>

#include <iterator>
#include <limits>
#include <set>

#include "server/core/mesh/measure.hpp"
#include "server/core/mesh/validate.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using testing::PlainModel;
using testing::Random;

std::string build_error(const MeshData& data) {
  try {
    TetMesh mesh(data);
  } catch (const MeshError& error) {
    return error.what();
  }
  return "no error";
}

std::set<TetId> tets_of(const std::vector<std::uint32_t>& corners) {
  std::set<TetId> tets;
  for (std::uint32_t corner : corners) tets.insert(tet_of(corner));
  return tets;
}

std::set<TetId> tets_with(const TetMesh& mesh, std::initializer_list<VertexId> vertices) {
  std::set<TetId> tets;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    const auto has = [&](VertexId v) { return mesh.local_index(t, v) >= 0; };
    if (std::all_of(vertices.begin(), vertices.end(), has)) tets.insert(t);
  }
  return tets;
}

// The interior face with these three vertices; kNone if there is no such face.
HalfFace find_face(const TetMesh& mesh, VertexId a, VertexId b, VertexId c) {
  for (TetId t : tets_with(mesh, {a, b, c})) {
    for (int f = 0; f < 4; ++f) {
      const auto v = mesh.vertices(t)[f];
      if (v != a && v != b && v != c) return half_face(t, f);
    }
  }
  return kNone;
}

// Interior faces of a box whose three vertices lie in a plane of constant x.
std::vector<HalfFace> faces_in_plane(const TetMesh& mesh, double x) {
  std::vector<HalfFace> faces;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    for (int f = 0; mesh.alive(t) && f < 4; ++f) {
      const HalfFace o = mesh.opposite(half_face(t, f));
      if (o == kNone || o < half_face(t, f)) continue;
      const auto v = mesh.face_vertices(half_face(t, f));
      if (std::all_of(v.begin(), v.end(), [&](VertexId i) { return mesh.position(i).x == x; })) {
        faces.push_back(half_face(t, f));
      }
    }
  }
  return faces;
}

// ---------------------------------------------------------------------------------------------- building

TEST(TetMeshBuild, ErrorsNameTheTetrahedronAndTheVertex) {
  MeshData data = testing::two_tets();
  data.tets[1][2] = 17;
  EXPECT_EQ(build_error(data), "tetrahedron 1 names vertex 17 of 5");
  data = testing::two_tets();
  data.tets[1][0] = 4;
  EXPECT_EQ(build_error(data), "tetrahedron 1 names vertex 4 twice");
  data = testing::two_tets();
  data.positions.push_back({2, 2, 2});
  data.tets.push_back({5, 1, 3, 2});
  EXPECT_EQ(build_error(data), "tetrahedra 0, 1 and 2 share the face (1, 2, 3)");
  data = testing::two_tets();
  data.positions[3].y = std::numeric_limits<double>::quiet_NaN();
  EXPECT_TRUE(build_error(data).starts_with("vertex 3 is at (")) << build_error(data);
  data.positions[3].y = std::numeric_limits<double>::infinity();
  EXPECT_TRUE(build_error(data).ends_with("accepted are finite coordinates")) << build_error(data);
  data = testing::two_tets();
  data.regions = {7};
  EXPECT_EQ(build_error(data), "regions given for 1 of 2 tetrahedra");
  data = testing::two_tets();
  data.opposite.assign(4, kNone);
  EXPECT_EQ(build_error(data), "opposite half-faces given for 1 of 2 tetrahedra");
  data.opposite.assign(8, kNone);
  data.opposite[0] = 8;
  EXPECT_EQ(build_error(data), "half-face 0 is not behind what it names");
  data.opposite[0] = 7;
  EXPECT_EQ(build_error(data), "half-face 0 is not behind what it names") << "that names nothing";
}

TEST(TetMeshBuild, EmptyMesh) {
  TetMesh mesh(MeshData{});
  EXPECT_EQ(mesh.live_tets(), 0u);
  EXPECT_EQ(mesh.mean_edge_length(), 0);
  EXPECT_EQ(mesh.state_hash(), 0u);
  EXPECT_EQ(validate(mesh), "");
}

TEST(TetMeshBuild, UnusedVerticesAreKept) {
  MeshData data = testing::one_tet();
  data.positions.push_back({9, 9, 9});
  TetMesh mesh(data);
  EXPECT_EQ(mesh.vertex_slots(), 5u);
  EXPECT_EQ(mesh.vertex_tet(4), kNone);
  std::vector<std::uint32_t> star{1, 2, 3};
  mesh.star(4, star);
  EXPECT_TRUE(star.empty());
  EXPECT_EQ(mesh.find_edge(4, 0), kNone);
  EXPECT_EQ(mesh.export_data().positions.size(), 4u);
  EXPECT_EQ(validate(mesh), "");
}

TEST(TetMeshBuild, AdjacencyOfTwoTetrahedra) {
  TetMesh mesh(testing::two_tets());
  EXPECT_EQ(mesh.opposite(half_face(0, 0)), half_face(1, 3));
  EXPECT_EQ(mesh.opposite(half_face(1, 3)), half_face(0, 0));
  EXPECT_EQ(mesh.neighbor(0, 0), 1u);
  EXPECT_EQ(mesh.neighbor(0, 1), kNone);
  EXPECT_EQ(mesh.boundary_mask(0), 0b1110);
  EXPECT_EQ(mesh.boundary_mask(1), 0b0111);
  EXPECT_EQ(mesh.face_vertices(half_face(0, 0)), (std::array<VertexId, 3>{1, 2, 3}));
  EXPECT_EQ(mesh.local_index(1, 4), 3);
  EXPECT_EQ(mesh.local_index(1, 0), -1);
  EXPECT_EQ(validate(mesh), "");
}

TEST(TetMeshBuild, MeanEdgeLengthAndRegions) {
  MeshData data = testing::box(2, 2, 2, 0.25);
  data.regions.assign(data.tets.size(), 3);
  data.regions[5] = -8;
  TetMesh mesh(data);
  EXPECT_EQ(mesh.region(5), -8);
  EXPECT_EQ(mesh.region(6), 3);
  // A Kuhn tetrahedron has three edges of 1, two of sqrt 2, one of sqrt 3.
  EXPECT_NEAR(mesh.mean_edge_length(), 0.25 * (3 + 2 * std::sqrt(2.0) + std::sqrt(3.0)) / 6, 1e-12);
  EXPECT_NEAR(mesh.local_h(13), mesh.mean_edge_length(), 0.05);
  EXPECT_NEAR(mesh.volume(0), 0.25 * 0.25 * 0.25 / 6, 1e-15);
}

// Two tetrahedra that meet in a vertex, in an edge: stars that are not face-connected are split at once.
TEST(TetMeshBuild, PinchedVerticesAreCopied) {
  MeshData data = testing::one_tet();
  data.positions.insert(data.positions.end(), {{-1, 0, 0}, {0, -1, 0}, {0, 0, -1}});
  data.tets.push_back({0, 5, 4, 6});
  TetMesh touching(data);
  EXPECT_EQ(touching.initial_vertex_copies(), 1u);
  EXPECT_EQ(touching.vertex_slots(), 8u);
  EXPECT_EQ(touching.vertices(1)[0], 7u);
  EXPECT_EQ(touching.position(7), data.positions[0]);
  EXPECT_EQ(validate(touching), "");
  EXPECT_TRUE(touching.touched_tets().empty()) << "loading is no step";
  Delta delta;
  touching.commit(delta);
  EXPECT_TRUE(delta.added_positions.empty() && delta.upserted.empty());
  EXPECT_EQ(touching.state_hash(), touching.compute_state_hash());

  data.tets[1] = {0, 3, 4, 5};
  TetMesh at_an_edge(data);
  EXPECT_EQ(at_an_edge.initial_vertex_copies(), 2u);
  EXPECT_EQ(validate(at_an_edge), "");
}

// A vertex inside four tetrahedra, which another one has as a corner: of the two that it becomes one lies at the boundary.
TEST(TetMeshBuild, OfAPinchedVertexEachPartIsInsideOrAtTheBoundary) {
  MeshData data;
  data.positions = {{0, 0, 0},       {1, 0, 0}, {0, 1, 0}, {0, 0, 1},
                    {0.2, 0.2, 0.2}, {3, 0, 0}, {0, 3, 0}, {0, 0, 3}};
  const std::vector<std::array<VertexId, 4>> around{{4, 1, 2, 3}, {0, 4, 2, 3}, {0, 1, 4, 3}, {0, 1, 2, 4}};
  const std::array<VertexId, 4> beside{4, 5, 6, 7};
  for (const bool inside_first : {true, false}) {
    data.tets = around;
    data.tets.insert(inside_first ? data.tets.end() : data.tets.begin(), beside);
    const TetMesh mesh(data);
    ASSERT_EQ(mesh.vertex_slots(), 9u);
    EXPECT_EQ(mesh.at_boundary(4), !inside_first);
    EXPECT_EQ(mesh.at_boundary(8), inside_first) << "the copy";
    EXPECT_EQ(validate(mesh), "");
  }
}

TEST(TetMeshBuild, AdjacencyAgreesWithBruteForce) {
  TetMesh mesh(testing::box(3, 4, 2));
  ASSERT_EQ(validate(mesh), "");
  std::map<std::set<VertexId>, std::vector<HalfFace>> sides;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    for (int f = 0; f < 4; ++f) {
      const auto v = mesh.face_vertices(half_face(t, f));
      sides[{v.begin(), v.end()}].push_back(half_face(t, f));
    }
  }
  for (const auto& [vertices, h] : sides) {
    ASSERT_LE(h.size(), 2u);
    EXPECT_EQ(mesh.opposite(h[0]), h.size() == 2 ? h[1] : kNone);
    if (h.size() == 2) {
      EXPECT_EQ(mesh.opposite(h[1]), h[0]);
    }
  }
}

// ---------------------------------------------------------------------------------------------- queries

TEST(TetMeshQuery, StarsAgreeWithBruteForce) {
  TetMesh mesh(testing::box(3, 3, 3));
  std::vector<std::uint32_t> star;
  for (VertexId v = 0; v < mesh.vertex_slots(); ++v) {
    mesh.star(v, star);
    EXPECT_EQ(tets_of(star), tets_with(mesh, {v}));
    EXPECT_EQ(star.size(), tets_of(star).size()) << "a tetrahedron came twice";
    for (std::uint32_t corner : star) EXPECT_EQ(mesh.vertices(tet_of(corner))[index_of(corner)], v);
  }
}

TEST(TetMeshQuery, RingsGoRoundTheirEdge) {
  TetMesh mesh(testing::box(3, 3, 3));
  std::vector<TetId> ring;
  std::uint32_t closed = 0, open = 0;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    for (const auto& e : kEdgeVertices) {
      const VertexId a = mesh.vertices(t)[e[0]], b = mesh.vertices(t)[e[1]];
      mesh.ring(t, a, b, ring);
      ASSERT_EQ(std::set<TetId>(ring.begin(), ring.end()), tets_with(mesh, {a, b}));
      ASSERT_EQ(ring.size(), tets_with(mesh, {a, b}).size());
      const auto adjacent = [&](TetId x, TetId y) {
        for (int f = 0; f < 4; ++f) {
          const VertexId v = mesh.vertices(x)[f];
          if (mesh.neighbor(x, f) == y && v != a && v != b) return true;
        }
        return false;
      };
      const auto boundary_faces_at_edge = [&](TetId x) {
        int n = 0;
        for (int f = 0; f < 4; ++f) {
          const VertexId v = mesh.vertices(x)[f];
          n += mesh.neighbor(x, f) == kNone && v != a && v != b ? 1 : 0;
        }
        return n;
      };
      int at_boundary = 0;
      for (TetId x : ring) at_boundary += boundary_faces_at_edge(x);
      for (std::size_t i = 1; i < ring.size(); ++i) ASSERT_TRUE(adjacent(ring[i - 1], ring[i]));
      if (at_boundary == 0) {
        ++closed;
        ASSERT_TRUE(adjacent(ring.back(), ring.front()));
      } else {
        ++open;
        ASSERT_EQ(at_boundary, 2);
        ASSERT_GE(boundary_faces_at_edge(ring.front()), 1);
        ASSERT_GE(boundary_faces_at_edge(ring.back()), 1);
      }
      const TetId found = mesh.find_edge(a, b);
      ASSERT_NE(found, kNone);
      ASSERT_GE(mesh.local_index(found, a), 0);
      ASSERT_GE(mesh.local_index(found, b), 0);
    }
  }
  EXPECT_GT(closed, 100u);
  EXPECT_GT(open, 100u);
  EXPECT_EQ(mesh.find_edge(0, 63), kNone);
}

// ---------------------------------------------------------------------------------------------- split_edge

TEST(TetMeshSplitEdge, InteriorEdge) {
  for (int n : {3, 4, 7}) {
    TetMesh mesh(testing::ring_of_tets(n));
    ASSERT_EQ(validate(mesh), "");
    const double volume = measure(mesh).volume;
    const VertexId m = mesh.split_edge(0, 0, 1, 0.25);
    EXPECT_EQ(m, static_cast<VertexId>(n + 2));
    EXPECT_EQ(mesh.position(m), (Vec3{0, 0, -0.5}));
    EXPECT_EQ(mesh.live_tets(), static_cast<std::uint32_t>(2 * n));
    EXPECT_EQ(validate(mesh), "");
    EXPECT_NEAR(measure(mesh).volume, volume, 1e-12);
    EXPECT_EQ(tets_with(mesh, {0, 1}).size(), 0u);
    for (TetId t : tets_with(mesh, {0})) EXPECT_LT(t, static_cast<TetId>(n)) << "the half at a keeps its id";
    EXPECT_EQ(tets_with(mesh, {0, m}).size(), static_cast<std::size_t>(n));
    EXPECT_EQ(tets_with(mesh, {1, m}).size(), static_cast<std::size_t>(n));
    Delta delta;
    mesh.commit(delta);
    ASSERT_EQ(delta.provenance.size(), 1u);
    EXPECT_EQ(delta.provenance[0], (Provenance{0, 1, 0.25}));
    EXPECT_EQ(delta.upserted.size(), static_cast<std::size_t>(2 * n));
    EXPECT_EQ(validate(mesh), "");
  }
}

TEST(TetMeshSplitEdge, EveryEdgeOfABoxBoundaryOrNot) {
  const MeshData data = testing::box(2, 2, 2);
  const TetMesh whole(data);
  for (TetId t = 0; t < whole.tet_slots(); ++t) {
    for (const auto& e : kEdgeVertices) {
      for (bool swap : {false, true}) {
        TetMesh mesh(data);
        PlainModel model(mesh);
        const VertexId a = mesh.vertices(t)[e[swap ? 1 : 0]], b = mesh.vertices(t)[e[swap ? 0 : 1]];
        const std::size_t around = tets_with(mesh, {a, b}).size();
        mesh.split_edge(t, a, b, 0.375);
        ASSERT_EQ(validate(mesh), "") << a << ' ' << b;
        ASSERT_EQ(mesh.live_tets(), whole.live_tets() + around);
        ASSERT_NEAR(measure(mesh).volume, 8, 1e-12);
        ASSERT_EQ(measure(mesh).pieces, 1u);
        Delta delta;
        mesh.commit(delta);
        model.apply(delta);
        model.expect_equals(mesh);
        if (HasFatalFailure()) return;
      }
    }
  }
}

// Cut faces at the edge are halved and stay cut; those at one end stay with that end; new faces are not cut.
TEST(TetMeshSplitEdge, KeepsCutFacesAndRegions) {
  MeshData data = testing::box(2, 2, 2);
  data.regions.resize(data.tets.size());
  for (std::size_t t = 0; t < data.tets.size(); ++t) data.regions[t] = static_cast<std::int32_t>(t % 5);
  TetMesh mesh(data);
  PlainModel model(mesh);
  mesh.open_faces(faces_in_plane(mesh, 1));
  const double area = measure(mesh).cut_area;
  EXPECT_DOUBLE_EQ(area, 4);
  Random random(11);
  for (int i = 0; i < 60; ++i) {
    TetId t = random.below(mesh.tet_slots());
    const auto& e = kEdgeVertices[random.below(6)];
    mesh.split_edge(t, mesh.vertices(t)[e[0]], mesh.vertices(t)[e[1]], random.uniform(0.3, 0.7));
    ASSERT_EQ(validate(mesh), "");
    ASSERT_NEAR(measure(mesh).cut_area, area, 1e-12);
    ASSERT_EQ(measure(mesh).pieces, 2u);
  }
  std::map<std::int32_t, double> before, after;
  const TetMesh whole(data);
  for (TetId t = 0; t < whole.tet_slots(); ++t) before[whole.region(t)] += whole.volume(t);
  for (TetId t = 0; t < mesh.tet_slots(); ++t) after[mesh.region(t)] += mesh.volume(t);
  for (const auto& [region, volume] : before) EXPECT_NEAR(after[region], volume, 1e-12);
  Delta delta;
  mesh.commit(delta);
  model.apply(delta);
  model.expect_equals(mesh);
}

// ---------------------------------------------------------------------------------------------- open_faces

TEST(TetMeshOpenFaces, EitherHalfBothTwiceAndBoundary) {
  for (const std::vector<HalfFace>& faces :
       {std::vector<HalfFace>{0}, {7}, {0, 7}, {7, 7, 0, 0}, {0, half_face(0, 1), half_face(1, 2)}}) {
    TetMesh mesh(testing::two_tets());
    EXPECT_EQ(mesh.open_faces(faces), 1u);
    EXPECT_EQ(mesh.vertex_slots(), 8u);
    EXPECT_EQ(mesh.cut_mask(0), 0b0001);
    EXPECT_EQ(mesh.cut_mask(1), 0b1000);
    EXPECT_EQ(mesh.boundary_mask(0), 0b1111);
    EXPECT_EQ(validate(mesh), "");
    EXPECT_EQ(mesh.open_faces(faces), 0u);
    EXPECT_EQ(mesh.vertex_slots(), 8u);
  }
}

TEST(TetMeshOpenFaces, OneFaceInsideIsACrackFrontWithoutCopies) {
  TetMesh mesh(testing::box(4, 4, 4));
  const HalfFace inside = find_face(mesh, 62, 63, 68);  // of the middle vertex
  ASSERT_NE(inside, kNone);
  ASSERT_NE(mesh.opposite(inside), kNone);
  EXPECT_EQ(mesh.open_faces(std::array{inside}), 1u);
  EXPECT_EQ(mesh.vertex_slots(), 125u);
  EXPECT_EQ(measure(mesh).cut_sides, 2u);
  EXPECT_EQ(validate(mesh), "");
}

// A whole disc of faces around an interior vertex: that vertex is split, the disc's rim is the crack front.
TEST(TetMeshOpenFaces, ADiscSplitsItsInnerVerticesOnly) {
  TetMesh mesh(testing::box(4, 4, 4));
  std::vector<HalfFace> disc;
  for (HalfFace h : faces_in_plane(mesh, 2)) {
    const auto v = mesh.face_vertices(h);
    if (std::find(v.begin(), v.end(), 62u) != v.end()) disc.push_back(h);
  }
  EXPECT_EQ(disc.size(), 6u);
  EXPECT_EQ(mesh.open_faces(disc), 6u);
  EXPECT_EQ(mesh.vertex_slots(), 126u);
  EXPECT_EQ(mesh.position(125), mesh.position(62));
  EXPECT_EQ(measure(mesh).pieces, 1u);
  EXPECT_EQ(validate(mesh), "");
  Delta delta;
  mesh.commit(delta);
  EXPECT_EQ(delta.provenance.at(0), (Provenance{62, 62, 0}));
}

TEST(TetMeshOpenFaces, AThroughCutInOneOrFaceByFace) {
  const MeshData data = testing::box(3, 3, 3);
  TetMesh at_once(data), one_by_one(data);
  const auto faces = faces_in_plane(at_once, 1);
  EXPECT_EQ(at_once.open_faces(faces), 18u);
  for (HalfFace h : faces) {
    EXPECT_EQ(one_by_one.open_faces(std::array{h}), 1u);
    ASSERT_EQ(validate(one_by_one), "");
  }
  for (const TetMesh* mesh : {&at_once, &one_by_one}) {
    EXPECT_EQ(mesh->vertex_slots(), 64u + 16);
    EXPECT_EQ(measure(*mesh).pieces, 2u);
    EXPECT_EQ(measure(*mesh).cut_faces, 18u);
    EXPECT_EQ(validate(*mesh), "");
  }
}

// Crossing cuts: the vertices on the line where they cross get three copies.
TEST(TetMeshOpenFaces, CrossingCuts) {
  TetMesh mesh(testing::box(4, 4, 4));
  mesh.open_faces(faces_in_plane(mesh, 2));
  std::vector<HalfFace> second;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    for (int f = 0; f < 4; ++f) {
      const auto v = mesh.face_vertices(half_face(t, f));
      if (std::all_of(v.begin(), v.end(), [&](VertexId i) { return mesh.position(i).y == 2; })) {
        second.push_back(half_face(t, f));
      }
    }
  }
  mesh.open_faces(second);
  EXPECT_EQ(validate(mesh), "");
  EXPECT_EQ(measure(mesh).pieces, 4u);
  EXPECT_EQ(mesh.vertex_slots(), 125u + 25 + 30);
}

// Opening every face around one tetrahedron leaves it alone, with vertices of its own.
TEST(TetMeshOpenFaces, AnIsland) {
  TetMesh mesh(testing::box(4, 4, 4));
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (mesh.boundary_mask(t) != 0) continue;
    mesh.open_faces(std::array{half_face(t, 0), half_face(t, 1), half_face(t, 2), half_face(t, 3)});
    EXPECT_EQ(measure(mesh).pieces, 2u);
    EXPECT_EQ(measure(mesh).islands, 1u);
    EXPECT_EQ(mesh.vertex_slots(), 129u);
    EXPECT_EQ(validate(mesh), "");
    return;
  }
  FAIL() << "no interior tetrahedron";
}

// ---------------------------------------------------------------------------------------------- remove_tet

TEST(TetMeshRemove, TheOnlyOne) {
  TetMesh mesh(testing::one_tet());
  mesh.remove_tet(0);
  EXPECT_FALSE(mesh.alive(0));
  EXPECT_EQ(mesh.live_tets(), 0u);
  EXPECT_EQ(mesh.vertex_tet(2), kNone);
  EXPECT_EQ(validate(mesh), "");
  Delta delta;
  mesh.commit(delta);
  EXPECT_EQ(delta.removed, std::vector<TetId>{0});
  EXPECT_EQ(delta.boundary_removed.size(), 4u);
  EXPECT_EQ(validate(mesh), "");
}

TEST(TetMeshRemove, EachOneOfABoxInTurn) {
  TetMesh mesh(testing::box(2, 2, 2));
  PlainModel model(mesh);
  Random random(5);
  while (mesh.live_tets() > 0) {
    const TetId t = random.below(mesh.tet_slots());
    if (!mesh.alive(t)) continue;
    std::vector<HalfFace> freed;
    for (int f = 0; f < 4; ++f) {
      if (mesh.opposite(half_face(t, f)) != kNone) freed.push_back(mesh.opposite(half_face(t, f)));
    }
    mesh.remove_tet(t);
    ASSERT_EQ(validate(mesh), "");
    for (HalfFace h : freed) EXPECT_TRUE(mesh.cut_mask(tet_of(h)) >> face_of(h) & 1);
    Delta delta;
    mesh.commit(delta);
    model.apply(delta);
    model.expect_equals(mesh);
    if (HasFatalFailure()) return;
  }
}

// Each of these opens three sides. Two sides are a face, and a half counts as one until the next makes it whole: deltas
// add up to what the mesh has.
TEST(TetMeshRemove, OddSidesAddUp) {
  TetMesh mesh(testing::box(4, 4, 4));
  std::set<TetId> used;
  std::uint32_t removed = 0, faces = 0;
  for (TetId t = 0; t < mesh.tet_slots() && removed < 6; ++t) {
    std::set<TetId> around{t};
    for (int f = 0; f < 4; ++f) {
      if (mesh.neighbor(t, f) != kNone) around.insert(mesh.neighbor(t, f));
    }
    const bool apart = std::none_of(around.begin(), around.end(), [&](TetId n) { return used.count(n) > 0; });
    if (around.size() != 4 || !apart) continue;
    used.insert(around.begin(), around.end());
    mesh.remove_tet(t);
    ++removed;
    Delta delta;
    mesh.commit(delta);
    EXPECT_EQ(delta.cut_faces, removed % 2 == 1 ? 2u : 1u) << removed;
    faces += delta.cut_faces;
    const CutReport report = measure(mesh);
    EXPECT_EQ(report.cut_sides, 3 * removed);
    EXPECT_EQ(report.cut_faces, faces);
  }
  EXPECT_EQ(removed, 6u);
  EXPECT_EQ(faces, 9u);
}

TEST(TetMeshRemove, OneMadeInTheSameStepNeverWasThere) {
  TetMesh mesh(testing::ring_of_tets(4));
  mesh.split_edge(0, 0, 1, 0.5);
  mesh.remove_tet(6);
  Delta delta;
  mesh.commit(delta);
  EXPECT_TRUE(delta.removed.empty());
  EXPECT_EQ(delta.upserted.size(), 7u);
  EXPECT_EQ(validate(mesh), "");
}

// ---------------------------------------------------------------------------------------------- replace

// Two tetrahedra over and under a triangle become three around the line between their apexes, and back.
TEST(TetMeshReplace, Flip23And32) {
  const MeshData data{{{1, 0, 0}, {-0.5, 0.9, 0}, {-0.5, -0.9, 0}, {0, 0, 1}, {0, 0, -1}},
                      {{0, 1, 2, 3}, {0, 2, 1, 4}},
                      {4, 9}};
  TetMesh mesh(data);
  PlainModel model(mesh);
  ASSERT_EQ(validate(mesh), "");
  std::vector<TetId> ids;
  const std::vector<std::array<VertexId, 4>> three{{4, 0, 1, 3}, {4, 1, 2, 3}, {4, 2, 0, 3}};
  ASSERT_TRUE(mesh.replace(std::array<TetId, 2>{0, 1}, three, ids));
  EXPECT_EQ(ids, (std::vector<TetId>{2, 3, 4}));
  EXPECT_EQ(validate(mesh), "");
  EXPECT_EQ(mesh.live_tets(), 3u);
  EXPECT_EQ(mesh.region(3), 4) << "of the first removed";
  std::vector<TetId> ring;
  mesh.ring(2, 3, 4, ring);
  EXPECT_EQ(ring.size(), 3u);
  Delta delta;
  mesh.commit(delta);
  model.apply(delta);
  model.expect_equals(mesh);
  EXPECT_EQ(delta.removed, (std::vector<TetId>{0, 1}));

  const std::vector<std::array<VertexId, 4>> two{{0, 1, 2, 3}, {0, 2, 1, 4}};
  ASSERT_TRUE(mesh.replace(std::array<TetId, 3>{4, 2, 3}, two, ids));
  EXPECT_EQ(ids, (std::vector<TetId>{5, 6}));
  EXPECT_EQ(validate(mesh), "");
  mesh.commit(delta);
  model.apply(delta);
  model.expect_equals(mesh);
}

TEST(TetMeshReplace, Flip44InsideABody) {
  // An octahedron of four tetrahedra around the edge (0, 5), the vertices 1 ... 4 around it, in a shell of
  // others.
  MeshData data{{{0, 0, -1}, {1, 0, 0}, {0, 1, 0}, {-1, 0, 0}, {0, -1, 0}, {0, 0, 1}, {3, 3, 3}},
                {{0, 1, 2, 5}, {0, 2, 3, 5}, {0, 3, 4, 5}, {0, 4, 1, 5}, {1, 2, 5, 6}},
                {}};
  TetMesh mesh(data);
  ASSERT_EQ(validate(mesh), "");
  const double volume = measure(mesh).volume;
  std::vector<TetId> ids;
  const std::vector<std::array<VertexId, 4>> around_13{
      {1, 2, 3, 5}, {1, 3, 4, 5}, {1, 3, 2, 0}, {1, 4, 3, 0}};
  ASSERT_TRUE(mesh.replace(std::array<TetId, 4>{0, 1, 2, 3}, around_13, ids));
  EXPECT_EQ(validate(mesh), "");
  EXPECT_NEAR(measure(mesh).volume, volume, 1e-12);
  EXPECT_EQ(mesh.neighbor(4, 3), ids[0]);
}

TEST(TetMeshReplace, MismatchesChangeNothing) {
  TetMesh mesh(testing::ring_of_tets(4));
  const std::uint64_t hash = mesh.state_hash();
  std::vector<TetId> ids;
  using Quads = std::vector<std::array<VertexId, 4>>;
  // Faces left over; one face too many; another vertex; nothing removed; nothing added; one removed twice.
  EXPECT_FALSE(mesh.replace(std::array<TetId, 2>{0, 1}, Quads{{0, 2, 3, 1}}, ids));
  EXPECT_FALSE(mesh.replace(std::array<TetId, 1>{0}, Quads{{0, 2, 3, 1}, {0, 3, 4, 1}}, ids));
  EXPECT_FALSE(mesh.replace(std::array<TetId, 1>{0}, Quads{{0, 2, 4, 1}}, ids));
  EXPECT_FALSE(mesh.replace(std::span<const TetId>{}, Quads{{0, 2, 3, 1}}, ids));
  EXPECT_FALSE(mesh.replace(std::array<TetId, 1>{0}, Quads{}, ids));
  EXPECT_FALSE(mesh.replace(std::array<TetId, 2>{0, 0}, Quads{{0, 2, 3, 1}}, ids));
  Delta delta;
  mesh.commit(delta);
  EXPECT_EQ(mesh.state_hash(), hash);
  EXPECT_EQ(mesh.tet_slots(), 4u);
  EXPECT_TRUE(delta.upserted.empty() && delta.removed.empty());
  EXPECT_EQ(validate(mesh), "");
}

TEST(TetMeshReplace, KeepsCutMarksOfTheShell) {
  TetMesh mesh(testing::ring_of_tets(5));
  mesh.open_faces(std::array{half_face(0, 1)});  // within the ring: between tetrahedra 0 and 1 (or 4)
  const double area = measure(mesh).cut_area;
  ASSERT_GT(area, 0);
  // Replace a tetrahedron at the cut by itself.
  std::vector<TetId> ids;
  const auto vertices = mesh.vertices(0);
  ASSERT_TRUE(mesh.replace(std::array<TetId, 1>{0}, std::vector{vertices}, ids));
  EXPECT_NE(mesh.cut_mask(ids[0]), 0);
  EXPECT_DOUBLE_EQ(measure(mesh).cut_area, area);
  EXPECT_EQ(validate(mesh), "");
}

// A collapse: the star of a vertex is filled from one of its neighbours; the vertex is left without a
// tetrahedron.
TEST(TetMeshReplace, Collapse) {
  TetMesh mesh(testing::ring_of_tets(5));
  const VertexId m = mesh.split_edge(0, 0, 1, 0.5);
  std::vector<std::uint32_t> star;
  mesh.star(m, star);
  std::vector<TetId> removed;
  std::vector<std::array<VertexId, 4>> added;
  for (std::uint32_t corner : star) {
    removed.push_back(tet_of(corner));
    auto v = mesh.vertices(tet_of(corner));
    if (std::find(v.begin(), v.end(), 0u) != v.end()) continue;
    v[index_of(corner)] = 0;
    added.push_back(v);
  }
  std::vector<TetId> ids;
  ASSERT_TRUE(mesh.replace(removed, added, ids));
  EXPECT_EQ(mesh.live_tets(), 5u);
  EXPECT_EQ(mesh.vertex_tet(m), kNone);
  EXPECT_EQ(validate(mesh), "");
}

// ---------------------------------------------------------------------------------------------- collapse

// Every collapse that may_collapse() allows keeps a valid manifold, at an inner vertex one of the same volume, unless it turns
// a tetrahedron over; what it forbids would not, or takes a vertex off the boundary (brute force over the links, with a cone
// over the boundary).
TEST(TetMeshCollapse, OfEveryEdge) {
  constexpr VertexId kCone = kNone;
  using Simplex = std::set<VertexId>;
  const MeshData data = testing::shaken_box(4, 3, 3, 21);
  int collapsed = 0, folded = 0, forbidden = 0, collapsed_at_boundary = 0;
  const TetMesh whole(data);
  const CutReport before = measure(whole);
  std::vector<Simplex> closed;  // all tetrahedra, and one from each boundary face to the cone's apex
  for (TetId t = 0; t < whole.tet_slots(); ++t) {
    closed.emplace_back(whole.vertices(t).begin(), whole.vertices(t).end());
    for (int f = 0; f < 4; ++f) {
      if (whole.opposite(half_face(t, f)) != kNone) continue;
      const auto face = whole.face_vertices(half_face(t, f));
      closed.emplace_back(face.begin(), face.end());
      closed.back().insert(kCone);
    }
  }
  const auto link = [&closed](const Simplex& of) {
    std::set<Simplex> simplices;
    for (const Simplex& tet : closed) {
      if (!std::includes(tet.begin(), tet.end(), of.begin(), of.end())) continue;
      std::vector<VertexId> rest;
      std::set_difference(tet.begin(), tet.end(), of.begin(), of.end(), std::back_inserter(rest));
      for (unsigned subset = 1; subset < 1u << rest.size(); ++subset) {
        Simplex simplex;
        for (std::size_t i = 0; i < rest.size(); ++i) {
          if (subset >> i & 1) simplex.insert(rest[i]);
        }
        simplices.insert(simplex);
      }
    }
    return simplices;
  };
  for (TetId t = 0; t < whole.tet_slots(); ++t) {
    for (const auto& e : kEdgeVertices) {
      for (bool swap : {false, true}) {
        TetMesh mesh(data);
        const VertexId v = mesh.vertices(t)[e[swap ? 1 : 0]], w = mesh.vertices(t)[e[swap ? 0 : 1]];
        const auto at_v = link({v}), at_w = link({w}), of_edge = link({v, w});
        const bool at_boundary = at_v.count({kCone}) > 0;
        std::set<Simplex> common;
        std::set_intersection(at_v.begin(), at_v.end(), at_w.begin(), at_w.end(),
                              std::inserter(common, common.end()));
        const bool may = common == of_edge && (!at_boundary || at_w.count({kCone}) > 0);
        ASSERT_EQ(mesh.may_collapse(t, v, w), may) << v << " into " << w;
        if (!may) {
          ++forbidden;
          continue;
        }
        PlainModel model(mesh);
        const std::size_t ring = tets_with(mesh, {v, w}).size();
        mesh.collapse(t, v, w);
        ++collapsed;
        collapsed_at_boundary += at_boundary ? 1 : 0;
        ASSERT_EQ(mesh.vertex_tet(v), kNone);
        ASSERT_FALSE(mesh.at_boundary(v)) << "no face is at it";
        ASSERT_EQ(mesh.live_tets(), whole.live_tets() - ring);
        ASSERT_EQ(validate(mesh, false), "") << v << " into " << w;
        const CutReport after = measure(mesh);
        ASSERT_EQ(after.pieces, 1u);
        ASSERT_EQ(after.boundary_faces, before.boundary_faces - (at_boundary ? 2 : 0));
        if (!at_boundary) {
          ASSERT_NEAR(after.volume, before.volume, 1e-12);
        }
        folded += after.inverted > 0 ? 1 : 0;
        Delta delta;
        mesh.commit(delta);
        model.apply(delta);
        model.expect_equals(mesh);
        if (HasFatalFailure()) return;
      }
    }
  }
  EXPECT_GT(collapsed - collapsed_at_boundary, 500);
  EXPECT_GT(collapsed_at_boundary, 500);
  EXPECT_GT(forbidden, 0);
  EXPECT_GT(folded, 0);
  EXPECT_LT(folded, collapsed);
}

// Cut faces around the vertex that goes stay cut, with the vertex that it goes into.
TEST(TetMeshCollapse, KeepsCutFaces) {
  TetMesh mesh(testing::box(4, 4, 4));
  mesh.open_faces(faces_in_plane(mesh, 3));
  const double area = measure(mesh).cut_area;
  // Vertex 62 is the middle one; its neighbour in the cut plane has become one on either side.
  VertexId beside = kNone;
  for (TetId t : tets_with(mesh, {62})) {
    for (VertexId v : mesh.vertices(t)) {
      if (mesh.position(v) == Vec3{3, 2, 2}) beside = v;
    }
  }
  ASSERT_NE(beside, kNone);
  const TetId at = mesh.find_edge(62, beside);
  ASSERT_TRUE(mesh.may_collapse(at, 62, beside));
  mesh.collapse(at, 62, beside);
  EXPECT_EQ(validate(mesh, false), "");
  EXPECT_DOUBLE_EQ(measure(mesh).cut_area, area);
  EXPECT_EQ(measure(mesh).pieces, 2u);
}

// A single face that has been opened, amid the tissue, is closed again, and its vertices lie inside again.
TEST(TetMeshCollapse, ClosesASingleOpenFace) {
  const TetMesh box(testing::box(4, 4, 4));
  int closed = 0;
  for (TetId t = 0; t < box.tet_slots(); ++t) {
    for (int f = 0; f < 4; ++f) {
      const HalfFace h = half_face(t, f);
      const auto v = box.face_vertices(h);
      if (std::ranges::any_of(v, [&](VertexId x) { return box.at_boundary(x); })) continue;
      TetMesh mesh = box;
      mesh.open_faces(std::array{h});
      ASSERT_TRUE(mesh.at_boundary(v[0]) && mesh.at_boundary(v[1]) && mesh.at_boundary(v[2]));
      if (!mesh.may_collapse(t, v[0], v[1])) continue;
      mesh.collapse(t, v[0], v[1]);
      EXPECT_EQ(validate(mesh, false), "");
      ++closed;
    }
  }
  EXPECT_GT(closed, 50);
}

// None is lost but those that have both vertices.
TEST(TetMeshCollapse, KeepsEveryOtherCutFace) {
  TetMesh uncollapsed(testing::box(4, 4, 4));
  uncollapsed.open_faces(faces_in_plane(uncollapsed, 3));
  Delta delta;
  uncollapsed.commit(delta);
  int collapsed = 0;
  for (TetId t = 0; t < uncollapsed.tet_slots(); ++t) {
    for (const auto& edge : kEdgeVertices) {
      for (const bool swap : {false, true}) {
        TetMesh mesh = uncollapsed;
        const VertexId v = mesh.vertices(t)[edge[swap ? 1 : 0]], w = mesh.vertices(t)[edge[swap ? 0 : 1]];
        if (!mesh.may_collapse(t, v, w)) continue;
        std::uint32_t with_both = 0;
        for (const TetId around : tets_with(mesh, {v, w})) {
          for (int f = 0; f < 4; ++f) {
            const VertexId apex = mesh.vertices(around)[f];
            with_both += apex != v && apex != w && (mesh.cut_mask(around) >> f & 1) ? 1 : 0;
          }
        }
        mesh.collapse(t, v, w);
        ++collapsed;
        EXPECT_EQ(measure(mesh).cut_sides, measure(uncollapsed).cut_sides - with_both) << v << " into " << w;
      }
    }
  }
  EXPECT_GT(collapsed, 500);
}

// ---------------------------------------------------------------------------------------------- commit

TEST(TetMeshCommit, AMoveIsInTheDeltaOnce) {
  TetMesh mesh(testing::two_tets());
  mesh.move_vertex(3, {0, 0, 2});
  mesh.move_vertex(1, {2, 0, 0});
  mesh.move_vertex(3, {0, 0, 3});
  Delta delta;
  mesh.commit(delta);
  EXPECT_EQ(delta.moved, (std::vector<VertexId>{1, 3}));
  EXPECT_EQ(delta.moved_positions[1], (Vec3{0, 0, 3}));
  EXPECT_TRUE(delta.upserted.empty());
  EXPECT_EQ(delta.state_hash, mesh.compute_state_hash());
  mesh.commit(delta);
  EXPECT_TRUE(delta.moved.empty());
}

TEST(TetMeshCommit, TheHashSeesEverything) {
  const TetMesh mesh(testing::two_tets());
  MeshData moved = testing::two_tets(), region = testing::two_tets(), turned = testing::two_tets();
  moved.positions[2].x = 1e-300;
  region.regions = {0, 1};
  turned.tets[0] = {1, 2, 0, 3};
  std::set<std::uint64_t> hashes{mesh.state_hash()};
  for (const MeshData* data : {&moved, &region, &turned}) hashes.insert(TetMesh(*data).state_hash());
  EXPECT_EQ(hashes.size(), 4u);
}

// Any sequence of changes, validated after each one; what a client holds equals the mesh after each commit.
class RandomMutations : public ::testing::TestWithParam<int> {};

TEST_P(RandomMutations, KeepTheInvariantsAndTheDeltasSayAll) {
  int flips = 0;
  for (int round = 0; round < 12; ++round) {
    const std::uint64_t seed =
        static_cast<std::uint64_t>(GetParam()) * 1000 + static_cast<std::uint64_t>(round);
    SCOPED_TRACE("seed " + std::to_string(seed));
    Random random(seed);
    MeshData data = testing::shaken_box(2, 2, 3, seed);
    TetMesh mesh(data);
    PlainModel model(mesh);
    double volume = measure(mesh).volume;
    std::vector<std::uint32_t> star;
    std::vector<TetId> ids, ring;
    const auto any_tet = [&] {
      for (;;) {
        const TetId t = random.below(mesh.tet_slots());
        if (mesh.alive(t)) return t;
      }
    };
    // By so much that rounding at a later split cannot turn it.
    const auto positive = [&](const std::array<VertexId, 4>& v) {
      return signed_volume(mesh.position(v[0]), mesh.position(v[1]), mesh.position(v[2]),
                           mesh.position(v[3])) > 1e-6;
    };
    for (int i = 0; i < 60; ++i) {
      const TetId t = any_tet();
      const auto v = mesh.vertices(t);
      const int corner = static_cast<int>(random.below(4));
      switch (random.below(6)) {
        case 0: {  // move, if the star stays positive
          const Vec3 from = mesh.position(v[corner]);
          mesh.move_vertex(v[corner], from + random.in_box({-0.05, -0.05, -0.05}, {0.05, 0.05, 0.05}));
          mesh.star(v[corner], star);
          for (std::uint32_t c : star) {
            if (!positive(mesh.vertices(tet_of(c)))) mesh.move_vertex(v[corner], from);
          }
          volume = measure(mesh).volume;
          break;
        }
        case 1: {
          const auto& e = kEdgeVertices[random.below(6)];
          mesh.split_edge(t, v[e[0]], v[e[1]], random.uniform(0.25, 0.75));
          break;
        }
        case 2: {  // open some faces around a vertex
          mesh.star(v[corner], star);
          std::vector<HalfFace> faces;
          for (std::uint32_t c : star) {
            if (random.below(4) == 0)
              faces.push_back(half_face(tet_of(c), static_cast<int>(random.below(4))));
          }
          const std::uint32_t before = measure(mesh).cut_sides;
          const std::uint32_t opened = mesh.open_faces(faces);
          ASSERT_EQ(measure(mesh).cut_sides, before + 2 * opened);
          break;
        }
        case 3:
          if (random.below(4) == 0 && mesh.live_tets() > 10) {
            volume -= mesh.volume(t);
            mesh.remove_tet(t);
          }
          break;
        case 4: {  // 2-3 flip of face `corner`
          const HalfFace o = mesh.opposite(half_face(t, corner));
          if (o == kNone) break;
          const auto f = mesh.face_vertices(half_face(t, corner));
          const VertexId apex = v[corner], other = mesh.vertices(tet_of(o))[face_of(o)];
          // f is counter-clockwise from outside t, where `other` lies.
          const std::vector<std::array<VertexId, 4>> three{
              {apex, f[0], f[1], other}, {apex, f[1], f[2], other}, {apex, f[2], f[0], other}};
          if (apex == other || !std::all_of(three.begin(), three.end(), positive)) break;
          ASSERT_TRUE(mesh.replace(std::array{t, tet_of(o)}, three, ids));
          ++flips;
          break;
        }
        case 5: {  // 3-2 flip of an edge
          const auto& e = kEdgeVertices[random.below(6)];
          const VertexId a = v[e[0]], b = v[e[1]];
          mesh.ring(t, a, b, ring);
          std::set<VertexId> around;
          for (TetId r : ring) {
            for (VertexId w : mesh.vertices(r)) {
              if (w != a && w != b) around.insert(w);
            }
          }
          if (ring.size() != 3 || around.size() != 3) break;
          std::vector<VertexId> w(around.begin(), around.end());
          if (!positive({w[0], w[1], w[2], b})) std::swap(w[0], w[1]);
          const std::vector<std::array<VertexId, 4>> two{{w[0], w[1], w[2], b}, {w[0], w[2], w[1], a}};
          if (!positive(two[0]) || !positive(two[1])) break;
          ASSERT_TRUE(mesh.replace(ring, two, ids));
          ++flips;
          break;
        }
      }
      ASSERT_EQ(validate(mesh), "") << "after change " << i;
      ASSERT_NEAR(measure(mesh).volume, volume, 1e-10) << "after change " << i;
      if (random.below(5) == 0) {
        Delta delta;
        mesh.commit(delta);
        ASSERT_TRUE(std::is_sorted(delta.boundary_upserted.begin(), delta.boundary_upserted.end()));
        ASSERT_TRUE(std::is_sorted(delta.removed.begin(), delta.removed.end()));
        ASSERT_EQ(delta.state_hash, mesh.compute_state_hash());
        model.apply(delta);
        model.expect_equals(mesh);
        ASSERT_EQ(validate(mesh), "");
        if (HasFatalFailure()) return;
      }
    }
  }
  EXPECT_GT(flips, 5);
}

INSTANTIATE_TEST_SUITE_P(Seeds, RandomMutations, ::testing::Range(1, 11));

// ---------------------------------------------------------------------------------------------- export

TEST(TetMeshExport, RoundTrip) {
  MeshData data = testing::box(3, 2, 2);
  data.regions.assign(data.tets.size(), 2);
  TetMesh mesh(data);
  EXPECT_EQ(mesh.export_data().tets, data.tets);
  EXPECT_EQ(mesh.export_data().positions, data.positions);
  EXPECT_EQ(mesh.export_data().regions, data.regions);
  mesh.open_faces(faces_in_plane(mesh, 1));
  for (TetId t = 0; t < 12; ++t) mesh.remove_tet(t);  // leaves vertices unused
  const MeshData out = mesh.export_data();
  EXPECT_EQ(out.tets.size(), mesh.live_tets());
  EXPECT_EQ(out.positions.size(), measure(mesh).vertices);
  EXPECT_LT(out.positions.size(), mesh.vertex_slots());
  const TetMesh again(out);
  EXPECT_EQ(validate(again), "");
  EXPECT_NEAR(measure(again).volume, measure(mesh).volume, 1e-12);
  EXPECT_EQ(measure(again).pieces, measure(mesh).pieces);
  EXPECT_EQ(again.initial_vertex_copies(), 0u) << "a cut mesh has no pinched vertex";
  // The faces of cuts stay such.
  EXPECT_FALSE(mesh.came_cut());
  EXPECT_TRUE(again.came_cut());
  EXPECT_EQ(measure(again).cut_sides, measure(mesh).cut_sides);
  EXPECT_EQ(measure(TetMesh(again)).cut_sides, measure(mesh).cut_sides);
}

// A real organ: adjacency, stars, and no vertex that only one of them knows.
TEST(TetMeshRealData, OrgansBuildAndValidate) {
  if (testing::data_folder().empty()) GTEST_SKIP() << "INCISE_DATA names no folder with meshes";
  for (const char* name : {"seed_3234", "liver_6564", "armadillo_3717"}) {
    TetMesh mesh(testing::real_mesh(std::string(name) + ".node"));
    EXPECT_EQ(validate(mesh), "") << name;
    EXPECT_EQ(measure(mesh).pieces, 1u) << name;
  }
}

}  // namespace
}  // namespace incise::core
