// Fields of mesh files: what each format carries, and what is left out, with a reason.

#include "server/mesh_io/field.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/mesh_io.hpp"
#include "server/mesh_io/text_file.hpp"
#include "tests/mesh_io/test_meshes.hpp"

namespace incise::mesh_io {
namespace {

using namespace testing;
using Floats = std::vector<float>;
using Ints = std::vector<std::int32_t>;
using On = Field::On;

LoadOptions with_fields() {
  LoadOptions options;
  options.fields = true;
  return options;
}

LoadedMesh load_text(const std::string& name, const std::string& text,
                     const LoadOptions& options = with_fields()) {
  const TestDirectory directory;
  write_whole_file(directory / name, text);
  return load_mesh(directory / name, options);
}

const Field& named(const LoadedMesh& loaded, On on, const std::string& name) {
  const auto found = std::find_if(loaded.fields.begin(), loaded.fields.end(),
                                  [&](const Field& f) { return f.on == on && f.name == name; });
  if (found == loaded.fields.end()) throw std::runtime_error("no field " + name);
  return *found;
}

const Floats& floats(const LoadedMesh& loaded, On on, const std::string& name) {
  return std::get<Floats>(named(loaded, on, name).values);
}
const Ints& ints(const LoadedMesh& loaded, On on, const std::string& name) {
  return std::get<Ints>(named(loaded, on, name).values);
}

bool warns(const LoadedMesh& loaded, const std::string& text) {
  return std::any_of(loaded.warnings.begin(), loaded.warnings.end(),
                     [&](const std::string& w) { return w.find(text) != w.npos; });
}

TEST(Fields, OfNamesThatResultsHaveOfTheirOwnAreLeftOut) {
  const TestDirectory directory;
  const core::MeshData mesh = cube_mesh(2);
  const std::vector<double> ones(mesh.tets.size(), 1);
  for (const char* name : {"a.vtu", "a.vtk"}) {
    write_mesh(directory / name, mesh.positions, mesh.tets, std::vector<CellArray>{{"volume", ones}});
    const LoadedMesh theirs = load_mesh(directory / name, with_fields());
    EXPECT_TRUE(warns(theirs, "'volume' is left out: results have an array of this name")) << name;
    const std::vector<std::uint8_t> masks(mesh.tets.size(), 0);
    write_mesh(directory / name, mesh.positions, mesh.tets,
               std::vector<CellArray>{{"volume", ones}, {"cut_mask", masks}});
    const LoadedMesh ours = load_mesh(directory / name, with_fields());
    EXPECT_TRUE(ours.warnings.empty()) << ours.warnings.front();
    EXPECT_TRUE(ours.fields.empty());
  }
}

// The texture of the surface is lost in a second run, and that must not come as a surprise.
TEST(Fields, OriginsOfFacesAreLeftOutWithOneWarning) {
  const TestDirectory directory;
  const core::MeshData mesh = cube_mesh(2);
  const std::vector<std::uint32_t> origins(mesh.tets.size(), 7);
  const std::vector<std::uint8_t> masks(mesh.tets.size(), 0);
  for (const char* name : {"a.vtu", "a.vtk"}) {
    std::vector<CellArray> arrays{{"cut_mask", masks}};
    for (const char* origin : {"origin_0", "origin_1", "origin_2", "origin_3"})
      arrays.push_back({origin, origins});
    write_mesh(directory / name, mesh.positions, mesh.tets, arrays);
    const LoadedMesh loaded = load_mesh(directory / name, with_fields());
    ASSERT_EQ(loaded.warnings.size(), 1u) << name;
    EXPECT_TRUE(warns(loaded, ": origin_0 to origin_3 are left out: ")) << loaded.warnings[0];
    EXPECT_TRUE(loaded.fields.empty());
  }
}

TEST(Fields, WhatIsWrittenIsReadBackToTheLastBit) {
  const TestDirectory directory;
  core::MeshData mesh = cube_mesh(2);
  const std::size_t v = mesh.positions.size(), t = mesh.tets.size();
  for (std::size_t i = 0; i < t; ++i) mesh.regions.push_back(static_cast<std::int32_t>(i % 2));
  std::vector<Field> fields{{"temperature <K> in % \u00b5\"\n", On::kVertices, 1, Floats(v, 0.1f)},
                            {"stress", On::kTets, 9, Floats(9 * t, -1e30f)},
                            {"label", On::kVertices, 1, Ints(v, INT32_MIN)},
                            {"label", On::kTets, 2, Ints(2 * t, 7)}};
  std::get<Floats>(fields[0].values)[3] = std::numeric_limits<float>::infinity();
  std::get<Ints>(fields[2].values)[1] = INT32_MAX;
  for (const char* name : {"a.vtu", "a.vtk"}) {
    SCOPED_TRACE(name);
    write_mesh(directory / name, mesh, fields);
    const LoadedMesh loaded = load_mesh(directory / name, with_fields());
    ASSERT_EQ(loaded.fields.size(), 4u) << "the region is none";
    for (const Field& field : fields) {
      const Field& read = named(loaded, field.on, field.name);
      EXPECT_EQ(read.components, field.components);
      EXPECT_EQ(read.values, field.values) << field.name;
    }
    EXPECT_EQ(loaded.mesh.regions, mesh.regions);
    EXPECT_TRUE(loaded.warnings.empty());
    EXPECT_EQ(loaded.content_hash, load_mesh(directory / name).content_hash);
    EXPECT_TRUE(load_mesh(directory / name).fields.empty()) << "nobody asked";
  }
}

constexpr const char* kVtkMesh =
    "# vtk DataFile Version 3.0\nbody\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 double\n"
    "0 0 0\n1 0 0\n0 1 0\n0 0 1\n1 1 1\nCELLS 3 13\n2 0 1\n4 0 1 2 3\n4 1 2 3 4\nCELL_TYPES 3\n3 10 10\n";

TEST(Fields, LegacyVtkFromTextAndOfTetrahedraAlone) {
  std::string many;
  for (int i = 0; i < 30; ++i) many += " 1";
  const LoadedMesh loaded = load_text(
      "a.vtk",
      std::string(kVtkMesh) +
          "POINT_DATA 5\nSCALARS heat float 1\nLOOKUP_TABLE default\n1 2 nan 4 5\n"
          "VECTORS fibre double\n1 0 0 0 1 0 0 0 1 1 0 0 0 1 0\n"
          "CELL_DATA 3\nFIELD data 4\nregion 1 3 int\n9 1 2\nkind 1 3 int\n90 91 92\nmany 10 3 float\n" +
          many + "\nfar 1 3 long\n1 2 4294967296\n");
  const Floats& heat = floats(loaded, On::kVertices, "heat");
  EXPECT_EQ(heat[1], 2);
  EXPECT_TRUE(std::isnan(heat[2])) << "allowed";
  EXPECT_EQ(named(loaded, On::kVertices, "fibre").components, 3u);
  EXPECT_EQ(floats(loaded, On::kVertices, "fibre")[4], 1);
  EXPECT_EQ(ints(loaded, On::kTets, "kind"), (Ints{91, 92})) << "not that of the line";
  EXPECT_EQ(loaded.fields.size(), 3u);
  EXPECT_TRUE(warns(loaded, "'many' is left out: it has 10 components; accepted are 1 to 9"));
  EXPECT_TRUE(warns(loaded, "'far' is left out: the whole number 4294967296 in it is beyond 32 bits"));
}

// What VTK writes of a vtkStringArray, a vtkBitArray and colours. Texts of the file as a whole are no field.
TEST(Fields, ArraysOfLegacyVtkThatHoldNoNumbersAreLeftOut) {
  const std::string mesh = kVtkMesh;
  const auto points = mesh.find("POINTS");
  const std::string text = mesh.substr(0, points) + "FIELD FieldData 1\nwho 1 2 string\nDr.%20A\n\n" +
                           mesh.substr(points) +
                           "POINT_DATA 5\nFIELD data 2\nthe%20label 1 5 string\nfirst one\n\nPOINT_DATA "
                           "7\nb\n3\nheat 1 5 double\n1 2 3 4 5\n"
                           "COLOR_SCALARS tint 1\n0 0.5 1 0 0\nCELL_DATA 3\nSCALARS on bit 1\n"
                           "LOOKUP_TABLE default\n0 1 1\nSCALARS kind int 1\nLOOKUP_TABLE default\n7 8 9\n";
  const LoadedMesh loaded = load_text("a.vtk", text);
  EXPECT_EQ(loaded.mesh.tets.size(), 2u);
  EXPECT_EQ(floats(loaded, On::kVertices, "heat"), (Floats{1, 2, 3, 4, 5}));
  EXPECT_EQ(ints(loaded, On::kTets, "kind"), (Ints{8, 9}));
  EXPECT_EQ(loaded.fields.size(), 2u);
  EXPECT_EQ(loaded.warnings.size(), 3u);
  EXPECT_TRUE(warns(loaded, "the vertex field 'the label' is left out: it holds texts"));
  EXPECT_TRUE(warns(loaded, "the vertex field 'tint' is left out: it is one of COLOR_SCALARS"));
  EXPECT_TRUE(warns(loaded, "the tetrahedron field 'on' is left out: it holds single bits"));
  EXPECT_TRUE(load_text("a.vtk", text, {}).warnings.empty());
  EXPECT_THROW(load_text("a.vtk", mesh + "POINT_DATA 5\nFIELD data 1\nlabel 1 5 string\na\n"), MeshError);
}

TEST(Fields, PackedTextsOfLegacyVtkAreLeftOut) {
  const TestDirectory directory;
  write_mesh(directory / "a.vtk", cube_mesh(1));
  const std::string packed = read_whole_file(directory / "a.vtk");
  const std::string texts = std::string(
                                "\xc3"
                                "abc") +
                            std::string("\xc0") + std::string("\x80\x64", 2) + std::string(100, '\n') +
                            std::string("\x40\0\0\x01z", 5) + std::string("\0\0\0\0\0\0\0\x02yz", 10);
  const std::string head = packed + "\nPOINT_DATA 8\nFIELD data 2\nlabel 1 8 string\n";
  const std::string rest = "\nheat 1 8 float\n" + std::string(32, '\0') + "\n";
  const LoadedMesh loaded = load_text("a.vtk", head + texts + std::string(3, '\xc0') + rest);
  EXPECT_EQ(floats(loaded, On::kVertices, "heat"), Floats(8, 0));
  EXPECT_TRUE(warns(loaded, "the vertex field 'label' is left out: it holds texts"));
  EXPECT_THROW(load_text("a.vtk", head + texts), MeshError);
  EXPECT_THROW(load_text("a.vtk", head + std::string(8, '\x7f') + rest), MeshError)
      << "a length beyond the file";
  EXPECT_THROW(load_text("a.vtk", head + std::string("\x3f") + std::string(7, '\xff') + rest), MeshError);
}

constexpr const char* kMshMesh =
    "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n5\n10 0 0 0\n20 1 0 0\n30 0 1 0\n40 0 0 1\n50 1 1 "
    "1\n$EndNodes\n"
    "$Elements\n3\n7 1 2 0 1 10 20\n8 4 2 1 1 10 20 30 40\n9 4 2 1 1 20 30 40 50\n$EndElements\n";

std::string msh_data(const std::string& section, const std::string& name, int components,
                     const std::string& rows, int count) {
  return "$" + section + "\n1\n\"" + name + "\"\n1\n0.0\n3\n0\n" + std::to_string(components) + "\n" +
         std::to_string(count) + "\n" + rows + "$End" + section + "\n";
}

TEST(Fields, GmshDataGoByNumber) {
  const LoadedMesh loaded =
      load_text("a.msh", kMshMesh + msh_data("NodeData", "heat", 1, "50 5\n40 4\n30 nan\n20 2\n10 1\n", 5) +
                             msh_data("ElementData", "stress", 3, "9 4 5 6\n7 0 0 0\n8 1 2 3\n", 3) +
                             msh_data("NodeData", "some", 1, "50 5\n40 4\n", 2) +
                             msh_data("NodeData", "heat", 1, "50 0\n40 0\n30 0\n20 0\n10 0\n", 5));
  const Floats& heat = floats(loaded, On::kVertices, "heat");
  EXPECT_EQ(heat[0], 1);
  EXPECT_TRUE(std::isnan(heat[2]));
  EXPECT_EQ(heat[4], 5);
  EXPECT_EQ(floats(loaded, On::kTets, "stress"), (Floats{1, 2, 3, 4, 5, 6}));
  EXPECT_EQ(loaded.fields.size(), 2u);
  EXPECT_TRUE(warns(loaded, "'some' is left out: 3 of 5 have no value"));
  EXPECT_TRUE(warns(loaded, "'heat' is left out: there is another one of this name before it"));
  EXPECT_THROW(load_text("a.msh", kMshMesh + msh_data("NodeData", "heat", 1, "11 5\n", 1)), MeshError);
  EXPECT_THROW(load_text("a.msh", kMshMesh + msh_data("NodeData", "heat", 0, "10 5\n", 1)), MeshError);
  EXPECT_THROW(load_text("a.msh", kMshMesh + msh_data("NodeData", "heat", 1, "10 5\n", 2000000000)),
               MeshError);
  EXPECT_THROW(load_text("a.msh", kMshMesh + msh_data("NodeData", "heat", 1, "10 five\n", 1)), MeshError);
}

// The same tetrahedron for two groups counts once, and so do its values.
TEST(Fields, OfATetrahedronThatIsThereTwice) {
  std::string text = kMshMesh;
  text.replace(text.find("9 4 2 1 1"), 0, "12 4 2 5 1 10 20 30 40\n")
      .replace(text.find("$Elements\n3"), 11, "$Elements\n4");
  const LoadedMesh loaded = load_text("a.msh", text + msh_data("ElementData", "x", 1, "8 1\n12 2\n9 3\n", 3));
  EXPECT_EQ(floats(loaded, On::kTets, "x"), (Floats{1, 3}));
}

TEST(Fields, ReferencesOfMeditVertices) {
  const std::string mesh =
      "MeshVersionFormatted 2 Dimension 3 Vertices 4 0 0 0 A 1 0 0 0 0 1 0 0 0 0 1 7 Tetrahedra 1 1 2 3 4 0 "
      "End";
  std::string with = mesh, without = mesh;
  with.replace(with.find('A'), 1, "3");
  without.replace(without.find('A'), 1, "0").replace(without.find(" 7 "), 3, " 0 ");
  EXPECT_EQ(ints(load_text("a.mesh", with), On::kVertices, "medit:ref"), (Ints{3, 0, 0, 7}));
  EXPECT_TRUE(load_text("a.mesh", without).fields.empty());
}

TEST(Fields, RowsFollowWhatARepairDrops) {
  // Vertex 1 has no tetrahedron.
  const LoadedMesh loaded =
      load_text("a.vtk",
                "# vtk DataFile Version 3.0\nbody\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS 5 double\n"
                "0 0 0\n9 9 9\n1 0 0\n0 1 0\n0 0 1\nCELLS 1 5\n4 0 2 3 4\nCELL_TYPES 1\n10\n"
                "POINT_DATA 5\nSCALARS id int 1\nLOOKUP_TABLE default\n0 1 2 3 4\n");
  EXPECT_EQ(ints(loaded, On::kVertices, "id"), (Ints{0, 2, 3, 4}));
}

std::string vtu(const std::string& data) {
  return "<?xml version=\"1.0\"?><VTKFile type=\"UnstructuredGrid\"><UnstructuredGrid>"
         "<Piece NumberOfPoints=\"4\" NumberOfCells=\"1\"><Points><DataArray type=\"Float64\" "
         "NumberOfComponents=\"3\">"
         "0 0 0 1 0 0 0 1 0 0 0 1</DataArray></Points><Cells><DataArray type=\"Int64\" "
         "Name=\"connectivity\">0 1 2 3"
         "</DataArray><DataArray type=\"Int64\" Name=\"offsets\">4</DataArray><DataArray type=\"UInt8\" "
         "Name=\"types\">10"
         "</DataArray></Cells>" +
         data + "</Piece></UnstructuredGrid></VTKFile>";
}

TEST(Fields, OfVtuThatCannotBeKept) {
  struct Case {
    std::string array, reason;
  };
  const std::string name(300, 'n');
  const Case cases[] = {
      {"<DataArray type=\"Float32\" Name=\"short\">1 2 3</DataArray>",
       "'short' is left out: it has 3 numbers; 4 times 1"},
      {"<DataArray type=\"Float32\">1 2 3 4</DataArray>", "its name has 0 bytes; accepted are 1 to 256"},
      {"<DataArray type=\"Float32\" Name=\"" + name + "\">1 2 3 4</DataArray>", "its name has 300 bytes"},
      {"<DataArray type=\"Float32\" Name=\"a\">1 2 3 4</DataArray><DataArray type=\"Float32\" Name=\"a\">1 2 "
       "3 4</DataArray>",
       "'a' is left out: there is another one of this name before it"},
      {"<DataArray type=\"Float32\" Name=\"a\x01z\">1 2 3 4</DataArray>", "its name has a control character"},
      {"<DataArray type=\"UInt32\" Name=\"ids\">1 2 3 4294967295</DataArray>", "the whole number 4294967295"},
      {"<DataArray type=\"Int32\" Name=\"gap\">1 2 3 nan</DataArray>",
       "'gap' is left out: the whole number nan"},
      {"<DataArray type=\"Float64\" Name=\"big\" NumberOfComponents=\"10\"></DataArray>",
       "it has 10 components"},
  };
  for (const Case& c : cases) {
    const std::string text = vtu("<PointData>" + c.array + "</PointData>");
    const LoadedMesh loaded = load_text("a.vtu", text);
    EXPECT_TRUE(warns(loaded, c.reason))
        << c.reason << (loaded.warnings.empty() ? "" : "; " + loaded.warnings[0]);
    EXPECT_TRUE(load_text("a.vtu", text, {}).warnings.empty());
  }
  const LoadedMesh kept = load_text(
      "a.vtu",
      vtu("<PointData><DataArray type=\"Float64\" Name=\"x\">1 nan 1e300 -inf</DataArray></PointData>"
          "<CellData><DataArray type=\"Int32\" Name=\"tet_id\">5</DataArray>"
          "<DataArray type=\"Bit\" Name=\"on\">1</DataArray>"
          "<Array type=\"String\" Name=\"text\" format=\"ascii\">49 0</Array></CellData>"));
  const Floats& x = floats(kept, On::kVertices, "x");
  EXPECT_TRUE(std::isnan(x[1]) && x[2] > 1e38f && x[3] < -1e38f);
  EXPECT_EQ(kept.fields.size(), 1u) << "what Incise writes itself is no field";
  ASSERT_EQ(kept.warnings.size(), 3u);
  EXPECT_TRUE(warns(kept, "'tet_id' is left out"));
  EXPECT_TRUE(warns(kept, "the tetrahedron field 'on' is left out: it is of type 'Bit'; numbers are"));
  EXPECT_TRUE(warns(kept, "the tetrahedron field 'text' is left out: it holds texts; numbers are"));
}

}  // namespace
}  // namespace incise::mesh_io
