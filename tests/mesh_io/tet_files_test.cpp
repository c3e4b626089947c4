// Gmsh, VTK, Medit and VegaFEM files: what other programs wrote is read as it is, and they read what we write.

#include "server/mesh_io/tet_files.hpp"
#include "server/core/mesh/tet_mesh.hpp"
#include "server/core/session/cut_session.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cstdlib>
#include <map>
#include <random>
#include <set>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "server/mesh_io/text_file.hpp"
#include "tests/mesh_io/test_meshes.hpp"

namespace incise::mesh_io {
namespace {

using namespace testing;

// Tetrahedra as places and region, in an order of their own: what a file must keep, whatever it does to the order.
std::multiset<std::pair<std::array<double, 12>, int>> contents(const core::MeshData& mesh) {
  std::multiset<std::pair<std::array<double, 12>, int>> all;
  for (std::size_t t = 0; t < mesh.tets.size(); ++t) {
    std::array<double, 12> places{};
    for (std::size_t k = 0; k < 4; ++k) {
      const core::Vec3& p = mesh.positions[mesh.tets[t][k]];
      places[3 * k] = p.x, places[3 * k + 1] = p.y, places[3 * k + 2] = p.z;
    }
    all.emplace(places, mesh.regions.empty() ? 0 : mesh.regions[t]);
  }
  return all;
}

// Coordinates that need all 17 digits, and three regions, one of them 0.
core::MeshData three_regions() {
  core::MeshData mesh = cube_mesh(3);
  for (core::Vec3& p : mesh.positions) p = (1.0 / 3) * p + core::Vec3{0.1, -1e-7, 1e5};
  for (std::size_t t = 0; t < mesh.tets.size(); ++t) mesh.regions.push_back(static_cast<int>(t % 3) * 21);
  return mesh;
}

TEST(TetFiles, WhatIsWrittenIsReadBackToTheLastBit) {
  const TestDirectory directory;
  for (const char* name : {"a.vtu", "a.vtk", "a.msh", "a.msh2", "a.mesh", "a.node"}) {
    SCOPED_TRACE(name);
    const core::MeshData mesh = three_regions();
    write_mesh(directory / name, mesh);
    const LoadedMesh loaded = load_mesh(directory / name);
    EXPECT_EQ(loaded.mesh.positions, mesh.positions);
    EXPECT_EQ(contents(loaded.mesh), contents(mesh));
    EXPECT_TRUE(loaded.warnings.empty()) << loaded.warnings[0];

    const core::MeshData plain = cube_mesh(2);
    write_mesh(directory / name, plain);
    EXPECT_EQ(load_mesh(directory / name).mesh.tets, plain.tets);
    EXPECT_TRUE(load_mesh(directory / name).mesh.regions.empty());
  }
}

TEST(TetFiles, ScaleTurnsFileUnitsIntoMetres) {
  const TestDirectory directory;
  write_mesh(directory / "a.msh", cube_mesh(1));
  const LoadedMesh loaded = load_mesh(directory / "a.msh", {.scale_to_metres = 0.001, .fill = {}});
  EXPECT_EQ(loaded.mesh.positions[7], (core::Vec3{0.001, 0.001, 0.001}));
}

// tests/fuzz/corpus/mesh/cube_*: a cube of 8 vertices and 6 tetrahedra, the first three of region 5, the others of 6,
// written by Gmsh 4.8 and VTK 9.1 in all their ways (.veg and the big-endian .msh by hand). A first line, which is not
// the file's, says the ending.
TEST(TetFiles, FilesOfOtherProgramsHoldTheSameCube) {
  const TestDirectory directory;
  std::size_t files = 0;
  for (const auto& entry :
       std::filesystem::directory_iterator(std::string(INCISE_SOURCE_DIR) + "/tests/fuzz/corpus/mesh")) {
    const std::string name = entry.path().filename().string();
    if (!name.starts_with("cube_")) continue;
    SCOPED_TRACE(name);
    const std::string bytes = read_whole_file(entry.path());
    const std::size_t line = bytes.find('\n');
    const LoadedMesh loaded =
        load_mesh(directory.write("a." + bytes.substr(0, line), bytes.substr(line + 1)));
    EXPECT_EQ(loaded.mesh.positions.size(), 8u);
    EXPECT_EQ(loaded.mesh.tets.size(), 6u);
    ASSERT_EQ(loaded.mesh.regions.size(), 6u);
    for (std::size_t t = 0; t < 6; ++t) {
      const auto& tet = loaded.mesh.tets[t];
      // The diagonal from (0, 0, 0) to (1, 1, 1) belongs to all six.
      int ends = 0;
      for (const auto v : tet) {
        const core::Vec3& p = loaded.mesh.positions[v];
        ends += p == core::Vec3{0, 0, 0} || p == core::Vec3{1, 1, 1};
      }
      EXPECT_EQ(ends, 2);
      const int first = name == "cube_veg" ? 0 : 5;  // VegaFEM's materials have names, no numbers
      EXPECT_EQ(loaded.mesh.regions[t], t < 3 ? first : first + 1);
    }
    EXPECT_TRUE(loaded.warnings.empty()) << loaded.warnings[0];
    ++files;
  }
  EXPECT_EQ(files, 20u);
}

// Elements and vertices are numbered from 0 or from 1.
TEST(TetFiles, VegaNumbersFromZeroOrOne) {
  for (const int first : {0, 1}) {
    std::string text = "*VERTICES\n5 3\n";
    const char* const places[] = {"0 0 0", "1 0 0", "0 1 0", "0 0 1", "1 1 1"};
    for (int i = 0; i < 5; ++i) text += std::to_string(first + i) + ' ' + places[i] + '\n';
    const auto tet = [&](int number, std::array<int, 4> v) {
      text += std::to_string(first + number);
      for (const int corner : v) text += ' ' + std::to_string(first + corner);
      text += '\n';
    };
    text += "*ELEMENTS\nTET\n2 4\n";
    tet(0, {0, 1, 2, 3});
    tet(1, {1, 2, 3, 4});
    text += "*MATERIAL soft\nENU, 1000, 1e6, 0.4\n*MATERIAL hard\nENU, 1000, 1e9, 0.4\n*SET far\n" +
            std::to_string(first + 1) + "\n*REGION\nallElements, soft\n*REGION\nfar, hard\n";
    std::vector<std::string> warnings;
    const core::MeshData mesh = parse_vega(text, "body.veg", warnings);
    ASSERT_EQ(mesh.tets.size(), 2u) << first;
    EXPECT_EQ(mesh.tets[1], (std::array<core::VertexId, 4>{1, 2, 3, 4}));
    EXPECT_EQ(mesh.regions, (std::vector<std::int32_t>{0, 1}));
  }
}

TEST(TetFiles, MeditSectionsComeInAnyOrder) {
  std::vector<std::string> warnings;
  const core::MeshData mesh = parse_medit(
      "MeshVersionFormatted 2\nDimension 3\nTetrahedra 2\n1 2 3 4 7\n2 3 4 5 8\nVertices 5\n"
      "0 0 0 0\n1 0 0 0\n0 1 0 0\n0 0 1 0\n1 1 1 0\nEnd\n",
      "a.mesh", warnings, nullptr);
  EXPECT_EQ(mesh.positions.size(), 5u);
  EXPECT_EQ(mesh.tets, (std::vector<std::array<core::VertexId, 4>>{{0, 1, 2, 3}, {1, 2, 3, 4}}));
  EXPECT_EQ(mesh.regions, (std::vector<std::int32_t>{7, 8}));
}

TEST(TetFiles, GmshNodesHaveGapsAndVolumesStandInForGroups) {
  const TestDirectory directory;
  const std::string nodes = "$NOD\n5\n9 0 0 0\n4 1 0 0\n70 0 1 0\n2 0 0 1\n5 1 1 1\n$ENDNOD\n";
  const core::MeshData mesh =
      load_mesh(
          directory.write("a.msh",
                          nodes + "$ELM\n3\n1 15 0 1 1 9\n2 4 0 3 4 9 4 70 2\n7 4 0 8 4 4 70 2 5\n$ENDELM\n"))
          .mesh;
  EXPECT_EQ(mesh.tets, (std::vector<std::array<core::VertexId, 4>>{{0, 1, 2, 3}, {1, 2, 3, 4}}));
  EXPECT_EQ(mesh.regions, (std::vector<std::int32_t>{3, 8}));
}

TEST(TetFiles, GmshTetrahedraOfSeveralGroupsAreTakenOnce) {
  const TestDirectory directory;
  const LoadedMesh loaded =
      load_mesh(directory.write("a.msh",
                                "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n4\n1 0 0 0\n2 1 0 0\n3 0 1 "
                                "0\n4 0 0 1\n$EndNodes\n$Elements\n2\n"
                                "1 4 2 10 1 1 2 3 4\n2 4 2 11 1 1 2 3 4\n$EndElements\n"));
  EXPECT_EQ(loaded.mesh.tets.size(), 1u);
  EXPECT_EQ(loaded.mesh.regions, (std::vector<std::int32_t>{10}));
  ASSERT_EQ(loaded.warnings.size(), 1u);
  EXPECT_NE(loaded.warnings[0].find("1 tetrahedra are there again"), std::string::npos) << loaded.warnings[0];
}

TEST(TetFiles, CurvedTetrahedraKeepTheirCornersAndFacesAreSkipped) {
  const TestDirectory directory;
  const LoadedMesh loaded = load_mesh(directory.write(
      "a.vtk",
      "# vtk DataFile Version 2.0\nx\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 10 float\n0 0 0 1 0 0 0 1 0 0 "
      "0 1\n"
      ".5 0 0 .5 .5 0 0 .5 0 0 0 .5 .5 0 .5 0 .5 .5\nCELLS 2 15\n3 0 1 2\n10 0 1 2 3 4 5 6 7 8 9\nCELL_TYPES "
      "2\n5\n24\n"
      "POINT_DATA 10\nVECTORS v float\n0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 nan\n"
      "CELL_DATA 2\nSCALARS other float 2\nLOOKUP_TABLE default\n1 2 3 nan\nFIELD f 2\na 1 2 double\n1 2\n"
      "Material 1 2 float\n3 4\n"));
  EXPECT_EQ(loaded.mesh.tets.size(), 1u);
  EXPECT_EQ(loaded.mesh.positions.size(), 4u);
  EXPECT_EQ(loaded.mesh.regions, (std::vector<std::int32_t>{4}));
  ASSERT_EQ(loaded.warnings.size(), 2u);
  EXPECT_NE(loaded.warnings[0].find("1 tetrahedra of higher order"), std::string::npos) << loaded.warnings[0];
}

TEST(TetFiles, PiecesOfAVtuBecomeOneMesh) {
  const TestDirectory directory;
  const auto piece = [](const char* z) {
    return std::string(
               "<Piece NumberOfPoints='4' NumberOfCells='1'>\n<!-- a > b --><Points><DataArray "
               "type=\"Float64\" "
               "NumberOfComponents=\"3\">0 0 ") +
           z + " 1 0 " + z + " 0 1 " + z + " 0 0 " + z +
           "1</DataArray></Points><Cells><DataArray type='Int32' "
           "Name='connectivity' format='ascii'>0 1 2 3</DataArray><DataArray type='Int32' Name='offsets' "
           "format='ascii'>4</DataArray><DataArray type='UInt8' Name='types' "
           "format='ascii'>10</DataArray></Cells></Piece>";
  };
  const core::MeshData mesh =
      load_mesh(directory.write("a.vtu",
                                "<?xml version='1.0'?><VTKFile type='UnstructuredGrid'><UnstructuredGrid>" +
                                    piece("0") + piece("5") + "</UnstructuredGrid></VTKFile>"))
          .mesh;
  EXPECT_EQ(mesh.positions.size(), 8u);
  EXPECT_EQ(mesh.tets[1], (std::array<core::VertexId, 4>{4, 5, 6, 7}));
}

// What other programs say about our files.
std::string output_of(const std::string& command) {
  FILE* pipe = popen((command + " 2>&1").c_str(), "r");
  std::string output;
  for (int c; pipe && (c = std::fgetc(pipe)) != EOF;) output += static_cast<char>(c);
  if (pipe) pclose(pipe);
  return output;
}

TEST(TetFiles, VtkReadsLegacyFiles) {
  if (output_of("/usr/bin/python3 -c 'import vtk; print(1)'") != "1\n") {
    GTEST_SKIP() << "needs /usr/bin/python3 with the module vtk (Debian: python3-vtk9)";
  }
  const TestDirectory directory;
  const core::MeshData mesh = cube_mesh(3);
  const std::vector<CellArray> arrays = {{"region", std::vector<std::int32_t>(162, -7)},
                                         {"cut mask", std::vector<std::uint8_t>(162, 15)},
                                         {"piece", std::vector<std::uint32_t>(162, 4'000'000'000u)},
                                         {"quality", std::vector<float>(162, 0.5f)},
                                         {"volume", std::vector<double>(162, 1e-300)}};
  write_mesh(directory / "a.vtk", mesh.positions, mesh.tets, arrays);
  const auto script = directory.write("read.py", R"(
import sys, vtk
reader = vtk.vtkUnstructuredGridReader()
reader.SetFileName(sys.argv[1])
reader.ReadAllScalarsOn()
reader.Update()
grid = reader.GetOutput()
print(grid.GetNumberOfPoints(), grid.GetNumberOfCells(), set(grid.GetCellType(i) for i in range(grid.GetNumberOfCells())))
print(grid.GetPoint(63), [grid.GetCell(161).GetPointId(i) for i in range(4)])
data = grid.GetCellData()
for i in range(data.GetNumberOfArrays()):
    array = data.GetArray(i)
    print(array.GetName(), array.GetDataTypeAsString(), array.GetNumberOfTuples(), array.GetTuple1(161))
)");
  EXPECT_EQ(output_of("/usr/bin/python3 " + script.string() + " " + (directory / "a.vtk").string()),
            "64 162 {10}\n(3.0, 3.0, 3.0) [42, 59, 43, 63]\n"
            "region int 162 -7.0\ncut mask unsigned char 162 15.0\npiece unsigned int 162 4000000000.0\n"
            "quality float 162 0.5\nvolume double 162 1e-300\n");
}

// Gmsh reads each of our files and writes it again, in each of its versions.
TEST(TetFiles, GmshReadsAndWritesOurFiles) {
  if (std::system("command -v gmsh > /dev/null 2>&1") != 0) GTEST_SKIP() << "needs gmsh (Debian: gmsh)";
  const TestDirectory directory;
  core::MeshData mesh = three_regions();
  for (std::int32_t& region : mesh.regions) region += 1;  // Gmsh has no group 0
  for (const char* name : {"a.msh", "a.msh2"}) {
    write_mesh(directory / name, mesh);
    for (const char* format : {"msh1", "msh2", "msh2 -bin", "msh41", "msh41 -bin", "vtk"}) {
      SCOPED_TRACE(std::string(name) + " to " + format);
      const auto out = directory / (format == std::string("vtk") ? "b.vtk" : "b.msh");
      std::filesystem::remove(out);
      const std::string said = output_of("cd " + (directory / "").string() + " && gmsh " + name +
                                         " -save -format " + format + " -o " + out.string());
      EXPECT_EQ(said.find("Error"), std::string::npos) << said;
      const LoadedMesh again = load_mesh(out);
      EXPECT_EQ(again.mesh.positions.size(), mesh.positions.size());
      std::map<std::int32_t, int> expected, found;
      for (const auto region : mesh.regions) ++expected[region];
      for (const auto region : again.mesh.regions) ++found[region];
      EXPECT_EQ(found, expected);
    }
  }
}

// What opened faces before the mesh was saved goes with the tetrahedra, also where their vertices change places.
TEST(TetFiles, FacesOfEarlierCutsAreReadBack) {
  const TestDirectory directory;
  core::MeshData mesh = cube_mesh(2);
  const core::TetMesh built(mesh);
  std::vector<std::uint8_t> masks;
  for (core::TetId t = 0; t < mesh.tets.size(); ++t) masks.push_back(built.boundary_mask(t));
  for (const char* name : {"a.vtu", "a.vtk"}) {
    SCOPED_TRACE(name);
    write_mesh(directory / name, mesh.positions, mesh.tets, std::vector<CellArray>{{"cut_mask", masks}});
    const core::MeshData loaded = load_mesh(directory / name).mesh;
    EXPECT_EQ(loaded.cut_masks, masks);
    write_mesh(directory / name, loaded);
    EXPECT_EQ(load_mesh(directory / name).mesh.cut_masks, masks);
    auto turned = mesh.tets;
    auto turned_masks = masks;
    for (std::size_t t = 0; t < turned.size(); ++t) {
      std::swap(turned[t][2], turned[t][3]);
      turned_masks[t] = static_cast<std::uint8_t>((masks[t] & 3) | (masks[t] & 4) << 1 | (masks[t] & 8) >> 1);
    }
    write_mesh(directory / name, mesh.positions, turned, std::vector<CellArray>{{"cut_mask", turned_masks}});
    EXPECT_EQ(load_mesh(directory / name).mesh.cut_masks, masks);
    // Inside the body there is no face of a cut.
    write_mesh(directory / name, mesh.positions, mesh.tets,
               std::vector<CellArray>{{"cut_mask", std::vector<std::uint8_t>(masks.size(), 15)}});
    EXPECT_EQ(core::TetMesh(load_mesh(directory / name).mesh).export_data().cut_masks, masks);
    write_mesh(directory / name, mesh.positions, mesh.tets,
               std::vector<CellArray>{{"cut_mask", std::vector<double>(masks.size(), 2.5)}});
    const LoadedMesh odd = load_mesh(directory / name);
    EXPECT_TRUE(odd.mesh.cut_masks.empty());
    ASSERT_EQ(odd.warnings.size(), 1u);
    EXPECT_NE(odd.warnings[0].find("other numbers than 0 to 15"), std::string::npos);
  }
}

// What blades have left in a body goes with it through these formats, and is left out where it belongs to another mesh.
TEST(TetFiles, WhatBladesHaveLeftIsReadBack) {
  const TestDirectory directory;
  core::CutConfig config;
  config.blade = {{0, 0, -1}, {0, 0, 2}};
  config.always_engaged = true;
  config.speed_limit_m_s = config.gap_limit_s = 1e9;
  core::CutSession session(cube_mesh(3), config);
  core::Delta delta;
  core::WorkBudget budget = core::WorkBudget::unlimited();
  for (int i = 0; i < 20; ++i) {
    session.push(0, {4'000'000 * (i + 1), {0.03 * i, 0.45, 0}, {}, 0});
    while (session.advance(budget, delta) != core::CutSession::Progress::kIdle) {
    }
  }
  core::MeshData saved = session.export_data();
  saved.regions.clear();  // as where all are 0
  ASSERT_FALSE(saved.cut_memory.empty());
  for (const char* name : {"a.vtu", "a.vtk"}) {
    SCOPED_TRACE(name);
    write_mesh(directory / name, saved);
    const LoadedMesh loaded = load_mesh(directory / name, {1, {}, true});
    EXPECT_EQ(loaded.mesh.cut_memory, saved.cut_memory);
    EXPECT_EQ(loaded.content_hash, mesh_hash(saved));
    EXPECT_TRUE(loaded.warnings.empty()) << loaded.warnings[0];
    EXPECT_TRUE(loaded.fields.empty());
    core::MeshData other = saved;
    other.positions[0].x += 0.001;
    write_mesh(directory / name, other);
    for (const LoadedMesh& left_out :
         {load_mesh(directory / name), load_mesh(directory / name, {1, {}, true})}) {
      EXPECT_TRUE(left_out.mesh.cut_memory.empty());
      EXPECT_EQ(left_out.mesh.cut_masks, saved.cut_masks);
      ASSERT_EQ(left_out.warnings.size(), 1u);
      EXPECT_NE(left_out.warnings[0].find("has been changed since it was saved with its cuts"),
                std::string::npos);
    }
    write_mesh(directory / name, saved);
    EXPECT_TRUE(load_mesh(directory / name, {0.001, {}, false}).mesh.cut_memory.empty()) << "in other units";
  }
}

// Every file with a byte changed or cut short loads or gets a MeshError (the fuzz corpus has every length of the files
// above).
TEST(TetFiles, AlteredFilesAreRefusedOrRead) {
  const TestDirectory directory;
  std::mt19937 random(1);
  core::MeshData mesh = cube_mesh(2);
  for (std::size_t t = 0; t < mesh.tets.size(); ++t) mesh.regions.push_back(static_cast<int>(t % 2));
  for (const char* name : {"a.vtu", "a.vtk", "a.msh", "a.msh2", "a.mesh"}) {
    SCOPED_TRACE(name);
    write_mesh(directory / name, mesh);
    const std::string good = read_whole_file(directory / name);
    for (int i = 0; i < 300; ++i) {
      std::string bad = good;
      for (std::size_t n = 1 + random() % 3; n > 0; --n)
        bad[random() % bad.size()] = static_cast<char>(random());
      if (i % 3 == 0) bad.resize(random() % bad.size() + 1);
      try {
        load_mesh(directory.write(name, bad));
      } catch (const MeshError& error) {
        const std::string text = error.what();
        EXPECT_NE(text.find(name), std::string::npos) << text;
        for (const char c : text) ASSERT_TRUE(c >= ' ' && c <= '~') << text;
      }
    }
  }
}

}  // namespace
}  // namespace incise::mesh_io
