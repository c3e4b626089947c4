#include "server/mesh_io/tet_repair.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <numeric>
#include <random>

#include "server/core/geometry/predicates.hpp"
#include "server/core/geometry/quality.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/mesh/validate.hpp"
#include "server/mesh_io/mesh_error.hpp"
#include "tests/mesh_io/test_meshes.hpp"

namespace incise::mesh_io {
namespace {

using namespace testing;
using core::MeshData;

struct Repaired {
  MeshData mesh;
  std::vector<std::string> warnings;

  bool warns(std::string_view text) const {
    return std::any_of(warnings.begin(), warnings.end(),
                       [text](const std::string& w) { return w.find(text) != std::string::npos; });
  }
};

// Repairs, and checks that the core takes the result.
Repaired repair(MeshData mesh, int base = 0) {
  Repaired repaired{std::move(mesh), {}};
  repair_tets(repaired.mesh, "FILE", base, repaired.warnings);
  EXPECT_EQ(core::validate(core::TetMesh(repaired.mesh)), "");
  return repaired;
}

double volume_of(const MeshData& mesh) {
  double volume = 0;
  for (const auto& t : mesh.tets) {
    volume += core::signed_volume(mesh.positions[t[0]], mesh.positions[t[1]], mesh.positions[t[2]],
                                  mesh.positions[t[3]]);
  }
  return volume;
}

TEST(TetRepair, GoodMeshStaysAsItIs) {
  const MeshData mesh = cube_mesh(3);
  const Repaired repaired = repair(mesh);
  EXPECT_EQ(repaired.mesh.positions, mesh.positions);
  EXPECT_EQ(repaired.mesh.tets, mesh.tets);
  EXPECT_TRUE(repaired.warnings.empty());
}

TEST(TetRepair, LeftHandedMeshIsTurned) {
  MeshData mesh = cube_mesh(2);
  for (auto& t : mesh.tets) std::swap(t[0], t[1]);
  const Repaired repaired = repair(mesh);
  EXPECT_NEAR(volume_of(repaired.mesh), 8, 1e-12);
  EXPECT_TRUE(repaired.warns("FILE: all 48 tetrahedra are left-handed"));
}

TEST(TetRepair, MixedHandednessIsMadeConsistent) {
  MeshData mesh = cube_mesh(3);
  std::mt19937 random(7);
  std::size_t turned = 0;
  for (std::size_t i = 1; i < mesh.tets.size(); ++i) {
    if (random() % 3 != 0) continue;
    std::swap(mesh.tets[i][1], mesh.tets[i][3]);
    ++turned;
  }
  const Repaired repaired = repair(mesh);
  EXPECT_NEAR(volume_of(repaired.mesh), 27, 1e-12);
  EXPECT_TRUE(repaired.warns(std::to_string(turned) + " of 162 tetrahedra are left-handed"));
}

TEST(TetRepair, RegionsStayWithTheirTetrahedra) {
  MeshData mesh = cube_mesh(1);
  mesh.regions = {5, 6, 7, 8, 9, 10};
  std::swap(mesh.tets[2][0], mesh.tets[2][1]);
  EXPECT_EQ(repair(mesh).mesh.regions, mesh.regions);
}

// Vertex 13, the middle of 2 x 2 x 2 cubes, is pushed a little through the plane of a face opposite to it.
TEST(TetRepair, InvertedSliversInsideAreMendedByASmallMove) {
  MeshData mesh = cube_mesh(2);
  mesh.positions[13] = {1, 1, 2.01};
  const Repaired repaired = repair(mesh);
  EXPECT_EQ(repaired.mesh.tets.size(), 48u);
  EXPECT_NEAR(volume_of(repaired.mesh), 8, 0.2);
  EXPECT_TRUE(repaired.warns("is inverted"));
  EXPECT_TRUE(repaired.warns("is moved by"));
}

TEST(TetRepair, FlatTetrahedronOnTheBoundaryIsMendedOrRemoved) {
  MeshData mesh = cube_mesh(2);
  // A tetrahedron of four points of the face z = 2.
  mesh.positions.push_back({0.5, 0.5, 2});
  mesh.tets.push_back({18, 19, 22, 27});
  const Repaired repaired = repair(mesh);
  EXPECT_TRUE(repaired.warns("tetrahedron 48 (vertices 18, 19, 22, 27"));
  EXPECT_NEAR(volume_of(repaired.mesh), 8, 0.1);
}

TEST(TetRepair, InvertedTetrahedronOnTheBoundaryIsRemoved) {
  MeshData mesh = cube_mesh(2);
  // Folded deep into the body over the tetrahedron below its face (18, 19, 22) of z = 2: no small move fixes
  // it.
  mesh.positions.push_back({0.6, 0.3, 1.2});
  const auto on_top = [&](std::uint32_t a, std::uint32_t b, std::uint32_t c) {
    return std::any_of(mesh.tets.begin(), mesh.tets.end(), [=](const auto& t) {
      return std::count(t.begin(), t.end(), a) + std::count(t.begin(), t.end(), b) +
                 std::count(t.begin(), t.end(), c) ==
             3;
    });
  };
  ASSERT_TRUE(on_top(18, 19, 22));
  mesh.tets.push_back({18, 19, 22, 27});
  const Repaired repaired = repair(mesh);
  EXPECT_TRUE(repaired.warns("tetrahedron 48 ("));
  EXPECT_TRUE(repaired.warns("on the boundary: it is removed"));
  EXPECT_EQ(repaired.mesh.tets.size(), 48u);
  EXPECT_EQ(repaired.mesh.positions.size(), 27u);
}

TEST(TetRepair, TangledMeshIsRefused) {
  MeshData mesh = cube_mesh(4);
  std::mt19937 random(3);
  std::shuffle(mesh.positions.begin(), mesh.positions.end(), random);
  const std::string error = error_of([&] { repair(mesh); });
  EXPECT_NE(error.find("flat or folded over their neighbours"), std::string::npos) << error;
}

TEST(TetRepair, InvertedTetrahedraDeepInsideAreRefused) {
  MeshData mesh = cube_mesh(12);
  // Two neighbours deep inside have changed places: no small move fixes that.
  const std::size_t v = 6 + 13 * (6 + 13 * 6);
  std::swap(mesh.positions[v], mesh.positions[v + 1]);
  const std::string error = error_of([&] { repair(mesh, 1); });
  EXPECT_NE(error.find("is inverted, volume -0.1666"), std::string::npos) << error;
  EXPECT_NE(error.find("inside the body, and no small move of a vertex fixes it"), std::string::npos)
      << error;
}

TEST(TetRepair, UnusedVerticesAreDropped) {
  MeshData mesh = cube_mesh(1);
  mesh.positions.insert(mesh.positions.begin(), {9, 9, 9});
  for (auto& t : mesh.tets) {
    for (auto& v : t) ++v;
  }
  const Repaired repaired = repair(mesh, 1);
  EXPECT_EQ(repaired.mesh.positions, cube_mesh(1).positions);
  EXPECT_EQ(repaired.mesh.tets, cube_mesh(1).tets);
  EXPECT_TRUE(repaired.warns("1 vertex has no tetrahedron (the first: vertex 1 at (9, 9, 9)): dropped"));
}

TEST(TetRepair, LeavesWhatLiesBehindEachFace) {
  MeshData mesh = cube_mesh(3);
  const core::TetMesh found(mesh);
  mesh.positions.insert(mesh.positions.begin(), {9, 9, 9});  // is dropped, and the others are renumbered
  for (auto& tet : mesh.tets) {
    for (core::VertexId& v : tet) ++v;
  }
  mesh.opposite = {7};  // of another mesh
  const Repaired repaired = repair(mesh);
  ASSERT_EQ(repaired.mesh.opposite.size(), 4 * mesh.tets.size());
  for (core::HalfFace h = 0; h < repaired.mesh.opposite.size(); ++h)
    EXPECT_EQ(repaired.mesh.opposite[h], found.opposite(h)) << h;
  const core::TetMesh taken(repaired.mesh);
  EXPECT_EQ(core::validate(taken), "");
  EXPECT_EQ(taken.state_hash(), found.state_hash());
  EXPECT_EQ(taken.vertex_slots(), found.vertex_slots());
}

TEST(TetRepair, NonManifoldVertexIsToleratedAndNamed) {
  MeshData mesh;
  mesh.positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {-1, 0, 0}, {0, -1, 0}, {0, 0, -1}};
  mesh.tets = {{0, 1, 2, 3}, {0, 5, 4, 6}};
  const Repaired repaired = repair(mesh);
  EXPECT_TRUE(repaired.warns("1 vertex is non-manifold")) << repaired.warnings.size();
  EXPECT_TRUE(repaired.mesh.opposite.empty()) << "the core parts it";
  EXPECT_TRUE(repaired.warns("vertex 0 at (0, 0, 0)"));
}

TEST(TetRepair, CoincidentVerticesAreNoted) {
  MeshData mesh;
  mesh.positions = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {0, 0, 0}, {0, 1, 0}, {1, 0, 0}, {0, 0, -1}};
  mesh.tets = {{0, 1, 2, 3}, {4, 5, 6, 7}};
  EXPECT_TRUE(repair(mesh).warns("3 vertices lie exactly on another one"));
}

TEST(TetRepair, TinyAndFarMeshesAreNotFlat) {
  for (const double scale : {1e-9, 1e-3, 1e6}) {
    MeshData mesh = cube_mesh(2);
    for (auto& p : mesh.positions) p = scale * p + core::Vec3{100 * scale, 0, 0};
    EXPECT_TRUE(repair(mesh).warnings.empty()) << scale;
  }
}

// Any mesh that was made bad at random either loads valid or is refused by MeshError.
TEST(TetRepair, RandomDamageNeverLeavesABadMesh) {
  for (unsigned seed = 0; seed < 200; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937 random(seed);
    MeshData mesh = cube_mesh(3);
    const int damages = 1 + static_cast<int>(random() % 4);
    for (int i = 0; i < damages; ++i) {
      auto& tet = mesh.tets[random() % mesh.tets.size()];
      auto& p = mesh.positions[random() % mesh.positions.size()];
      const auto offset = [&random] { return static_cast<double>(random() % 2001) / 1000.0 - 1.0; };
      switch (random() % 5) {
        case 0:
          std::swap(tet[0], tet[1]);
          break;
        case 1:
          p += core::Vec3{offset(), offset(), offset()};
          break;
        case 2:
          p += 0.3 * core::Vec3{offset(), offset(), offset()};
          break;
        case 3:
          mesh.tets.erase(mesh.tets.begin() + static_cast<long>(random() % mesh.tets.size()));
          break;
        case 4:
          tet[random() % 4] = static_cast<core::VertexId>(random() % mesh.positions.size());
          break;
      }
    }
    try {
      std::vector<std::string> warnings;
      repair_tets(mesh, "FILE", 0, warnings);
      EXPECT_EQ(core::validate(core::TetMesh(mesh)), "");
    } catch (const MeshError& error) {
      EXPECT_TRUE(std::string_view(error.what()).starts_with("FILE: ")) << error.what();
    }
  }
}

}  // namespace
}  // namespace incise::mesh_io
