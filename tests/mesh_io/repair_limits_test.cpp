// How far repairs go, what they name, and what belongs together afterwards; without real meshes.

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <map>
#include <random>

#include "server/mesh_io/mesh_io.hpp"
#include "server/mesh_io/surface_check.hpp"
#include "server/mesh_io/surface_files.hpp"
#include "server/mesh_io/tet_repair.hpp"
#include "tests/mesh_io/test_meshes.hpp"

namespace incise::mesh_io {
namespace {

using namespace testing;
using core::MeshData;

std::string repair(MeshData& mesh) {
  std::vector<std::string> warnings;
  repair_tets(mesh, "FILE", 0, warnings);
  std::string all;
  for (const std::string& warning : warnings) all += warning + "\n";
  return all;
}

// One cube and so many flat tetrahedra beside it, each of a point's own.
MeshData with_flat_ones(std::size_t count) {
  MeshData mesh = cube_mesh(1);
  for (std::size_t i = 0; i < count; ++i) {
    const auto first = static_cast<core::VertexId>(mesh.positions.size());
    const double x = 10 + 2 * static_cast<double>(i);
    mesh.positions.insert(mesh.positions.end(), {{x, 0, 0}, {x + 1, 0, 0}, {x, 1, 0}, {x + 1, 1, 0}});
    mesh.tets.push_back({first, first + 1, first + 2, first + 3});
  }
  return mesh;
}

TEST(RepairLimits, SixteenBadTetrahedraAreASlipMoreAreATangle) {
  MeshData mesh = with_flat_ones(16);
  EXPECT_NE(repair(mesh), "");
  mesh = with_flat_ones(17);
  const std::string error = error_of([&] { repair(mesh); });
  EXPECT_NE(error.find("17 of 23 tetrahedra are flat or folded"), std::string::npos) << error;
}

// Whatever is wrong: a viewer sees no vertex of the boundary move. It is moved by a twentieth of the edges at it at most.
TEST(RepairLimits, ABoundaryVertexHardlyMoves) {
  int moved = 0, removed = 0;
  for (std::uint32_t seed = 1; seed <= 60; ++seed) {
    SCOPED_TRACE("seed " + std::to_string(seed));
    std::mt19937 random(seed);
    MeshData mesh = cube_mesh(3);
    // A vertex of the side z = 0, pushed through the plane of those above it.
    const auto v = static_cast<core::VertexId>(5 + (random() % 2) + 4 * (random() % 2));
    ASSERT_EQ(mesh.positions[v].z, 0);
    mesh.positions[v].z = std::uniform_real_distribution<double>(0.9, 1.25)(random);
    const MeshData damaged = mesh;
    if (repair(mesh).empty()) continue;
    if (mesh.positions.size() != damaged.positions.size()) {
      ++removed;
      continue;
    }
    for (std::size_t i = 0; i < mesh.positions.size(); ++i) {
      const core::Vec3& p = damaged.positions[i];
      const bool inside = std::min({p.x, p.y, p.z}) > 0 && std::max({p.x, p.y, p.z}) < 3 && i != v;
      const double way = core::distance(mesh.positions[i], p);
      EXPECT_LE(way, (inside ? 0.34 : 0.05) * std::sqrt(3.0) * 1.3) << "vertex " << i;
      moved += way > 0;
    }
  }
  EXPECT_GT(moved, 10);
}

TEST(RepairLimits, RegionsStayWithTheirTetrahedraWhereOneGoes) {
  MeshData mesh = cube_mesh(2);
  // Folded deep into the body over the one below its face: no small move mends it.
  mesh.positions.push_back({0.6, 0.3, 1.2});
  mesh.tets.insert(mesh.tets.begin(), {18, 19, 22, 27});
  std::map<std::array<core::VertexId, 4>, std::int32_t> regions;
  for (std::size_t t = 0; t < mesh.tets.size(); ++t) {
    mesh.regions.push_back(static_cast<std::int32_t>(100 + t));
    regions[mesh.tets[t]] = mesh.regions[t];
  }
  const std::string warnings = repair(mesh);
  ASSERT_NE(warnings.find("it is removed"), std::string::npos) << warnings;
  ASSERT_EQ(mesh.tets.size(), 48u);
  ASSERT_EQ(mesh.regions.size(), 48u);
  for (std::size_t t = 0; t < mesh.tets.size(); ++t) EXPECT_EQ(mesh.regions[t], regions.at(mesh.tets[t]));
}

TEST(RepairLimits, TheFirstThatIsLeftHandedIsNamed) {
  for (std::uint32_t seed = 1; seed <= 20; ++seed) {
    std::mt19937 random(seed);
    MeshData mesh = cube_mesh(3);
    std::size_t first = mesh.tets.size();
    for (int i = 0; i < 10; ++i) {
      const std::size_t t = 20 + random() % (mesh.tets.size() - 20);
      first = std::min(first, t);
      std::swap(mesh.tets[t][1], mesh.tets[t][3]);
      if (mesh.tets[t] == cube_mesh(3).tets[t]) first = 0;  // turned twice: another seed
    }
    if (first == 0) continue;
    const std::string warnings = repair(mesh);
    EXPECT_NE(warnings.find("(the first: tetrahedron " + std::to_string(first) + ")"), std::string::npos)
        << warnings;
  }
}

TEST(RepairLimits, ANumberThatIsTooSmallIsZero) {
  MeshData mesh = cube_mesh(1);
  mesh.positions[0] = {1e-70, -1e-300, 1e-59};
  repair(mesh);
  EXPECT_EQ(mesh.positions[0], (core::Vec3{0, 0, 1e-59}));
}

// The few that differ from their neighbours are turned, whichever of them comes first in the file.
TEST(RepairLimits, TheMajorityOfAShellDecides) {
  Surface surface = cube();
  std::swap(surface.triangles[0][0], surface.triangles[0][1]);
  std::vector<std::string> warnings;
  const ClosedSurface closed = check_surface(surface, "FILE", warnings);
  EXPECT_NEAR(signed_volume(closed.surface), 1, 1e-15);
  ASSERT_EQ(warnings.size(), 1u);
  EXPECT_NE(warnings[0].find("1 triangle was turned over"), std::string::npos) << warnings[0];
}

// ---- Files ----

TEST(MeshFiles, RepeatedTetrahedraLeaveTheOthersTheirRegions) {
  const TestDirectory directory;
  const LoadedMesh loaded = load_mesh(directory.write(
      "a.msh",
      "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n5\n1 0 0 0\n2 1 0 0\n3 0 1 0\n4 0 0 1\n5 1 1 "
      "1\n$EndNodes\n"
      "$Elements\n3\n1 4 2 10 1 1 2 3 4\n2 4 2 11 1 1 2 3 4\n3 4 2 12 1 2 4 3 5\n$EndElements\n"));
  ASSERT_EQ(loaded.mesh.tets.size(), 2u);
  EXPECT_EQ(loaded.mesh.regions, (std::vector<std::int32_t>{10, 12}));
}

TEST(MeshFiles, ARegionIsA32BitNumber) {
  const TestDirectory directory;
  const auto file = [&](const std::string& region) {
    return directory.write(
        "a.mesh",
        "MeshVersionFormatted 2\nDimension 3\nVertices\n4\n0 0 0 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n"
        "Tetrahedra\n1\n1 2 3 4 " +
            region + "\nEnd\n");
  };
  for (const char* region : {"2147483647", "-2147483648"})
    EXPECT_EQ(std::to_string(load_mesh(file(region)).mesh.regions.at(0)), region);
  for (const char* region : {"2147483648", "4294967295", "-2147483649"}) {
    const std::string error = error_of([&] { load_mesh(file(region)); });
    EXPECT_NE(error.find("out of range; accepted are -2147483648 to 2147483647"), std::string::npos)
        << region << ": " << error;
  }
}

TEST(MeshFiles, TheHashIsOfPositionsTetrahedraAndRegions) {
  MeshData mesh = cube_mesh(1);
  mesh.regions.assign(6, 1);
  const std::string hash = mesh_hash(mesh);
  MeshData other = mesh;
  other.regions[3] = 2;
  EXPECT_NE(mesh_hash(other), hash);
  other = mesh;
  std::swap(other.tets[0], other.tets[1]);
  EXPECT_NE(mesh_hash(other), hash);
  other = mesh;
  other.positions[0].x = -0.0;
  EXPECT_NE(mesh_hash(other), hash);
  EXPECT_EQ(mesh_hash(mesh), hash);
}

TEST(MeshFiles, AnEndingChoosesGmshsVersion) {
  const TestDirectory directory;
  for (const auto& [name, version] : {std::pair{"a.msh", "4.1"}, std::pair{"a.msh2", "2.2"}}) {
    write_mesh(directory / name, cube_mesh(1));
    std::ifstream in(directory / name);
    std::string line;
    std::getline(in, line);
    std::getline(in, line);
    EXPECT_TRUE(line.starts_with(version)) << name << ": " << line;
  }
}

TEST(MeshFiles, NormalsOfAnStlPointOut) {
  const TestDirectory directory;
  write_stl(directory / "a.stl", cube());
  std::ifstream in(directory / "a.stl", std::ios::binary);
  const std::string bytes((std::istreambuf_iterator<char>(in)), {});
  ASSERT_EQ(bytes.size(), 84u + 12 * 50);
  for (std::size_t t = 0; t < 12; ++t) {
    float n[12];  // the normal, three corners
    std::memcpy(n, &bytes[84 + 50 * t], sizeof n);
    double outward = 0;
    for (std::size_t k = 0; k < 3; ++k) outward += n[k] * ((n[3 + k] + n[6 + k] + n[9 + k]) / 3 - 0.5);
    EXPECT_NEAR(outward, 0.5, 1e-6) << "triangle " << t;
  }
}

TEST(MeshFiles, WhatCannotBeWrittenLeavesNothingBehind) {
  const TestDirectory directory;
  std::filesystem::create_directory(directory / "a.off");  // no file can take its place
  EXPECT_NE(error_of([&] { write_off(directory / "a.off", cube()); }).find("cannot be written"),
            std::string::npos);
  std::size_t entries = 0;
  for ([[maybe_unused]] const auto& entry : std::filesystem::directory_iterator(directory / ".")) ++entries;
  EXPECT_EQ(entries, 1u);
}

}  // namespace
}  // namespace incise::mesh_io
