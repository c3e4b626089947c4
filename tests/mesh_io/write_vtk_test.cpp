#include "server/mesh_io/write_vtk.hpp"

#include <gtest/gtest.h>

#include <array>
#include <cstdio>

#include "server/mesh_io/mesh_io.hpp"
#include "tests/mesh_io/test_meshes.hpp"

namespace incise::mesh_io {
namespace {

using namespace testing;

constexpr const char* kPython = "/usr/bin/python3";  // the one that Debian's python3-vtk9 belongs to

// What a Python script writes, with its arguments.
std::string python(const std::string& script, const std::string& argument) {
  const TestDirectory directory;
  const auto path = directory.write("script.py", script);
  std::string command(kPython);
  command.append(" ").append(path.string()).append(" '").append(argument).append("' 2>&1");
  FILE* pipe = popen(command.c_str(), "r");
  if (!pipe) return "popen failed";
  std::string output;
  std::array<char, 4096> buffer;
  while (const std::size_t count = std::fread(buffer.data(), 1, buffer.size(), pipe))
    output.append(buffer.data(), count);
  pclose(pipe);
  return output;
}

bool has_vtk() {
  return python("import vtk\nprint('yes')", "") == "yes\n";
}

TEST(WriteVtk, VtkReadsTheMeshWithItsCellData) {
  if (!has_vtk()) GTEST_SKIP() << "needs " << kPython << " with the module vtk (Debian: python3-vtk9)";
  const TestDirectory directory;
  const core::MeshData mesh = cube_mesh(3);
  std::vector<std::int32_t> region;
  std::vector<std::uint8_t> cut_mask;
  std::vector<std::uint32_t> piece;
  std::vector<float> quality;
  std::vector<double> id;
  for (std::size_t t = 0; t < mesh.tets.size(); ++t) {
    region.push_back(-static_cast<std::int32_t>(t));
    cut_mask.push_back(static_cast<std::uint8_t>(t % 16));
    piece.push_back(4'000'000'000u);
    quality.push_back(static_cast<float>(t) * 0.5f);
    id.push_back(static_cast<double>(t));
  }
  const std::vector<CellArray> arrays = {
      {"region", region}, {"cut_mask", cut_mask}, {"piece", piece}, {"a<b & \"c\"", quality}, {"id", id}};
  write_mesh(directory / "a.vtu", mesh.positions, mesh.tets, arrays);
  EXPECT_EQ(python(R"(
import sys, vtk
reader = vtk.vtkXMLUnstructuredGridReader()
reader.SetFileName(sys.argv[1])
reader.Update()
grid = reader.GetOutput()
print(grid.GetNumberOfPoints(), grid.GetNumberOfCells(), set(grid.GetCellType(i) for i in range(grid.GetNumberOfCells())))
print(grid.GetPoint(63), [grid.GetCell(161).GetPointId(i) for i in range(4)])
data = grid.GetCellData()
for i in range(data.GetNumberOfArrays()):
    array = data.GetArray(i)
    print(array.GetName(), array.GetDataTypeAsString(), array.GetNumberOfTuples(), array.GetTuple1(161))
size = vtk.vtkCellSizeFilter()
size.SetInputData(grid)
size.Update()
volumes = size.GetOutput().GetCellData().GetArray('Volume')
print(round(sum(volumes.GetTuple1(i) for i in range(162)), 9), min(volumes.GetTuple1(i) for i in range(162)) > 0)
)",
                   (directory / "a.vtu").string()),
            "64 162 {10}\n(3.0, 3.0, 3.0) [42, 59, 43, 63]\n"
            "region int 162 -161.0\ncut_mask unsigned char 162 1.0\npiece unsigned int 162 4000000000.0\n"
            "a<b & \"c\" float 162 80.5\nid double 162 161.0\n27.0 True\n");
}

TEST(WriteVtk, VtkReadsTheSurface) {
  if (!has_vtk()) GTEST_SKIP() << "needs " << kPython << " with the module vtk (Debian: python3-vtk9)";
  const TestDirectory directory;
  const std::vector<CellArray> arrays = {{"cut", std::vector<std::uint8_t>(12, 1)}};
  for (const auto& [name, reader] :
       {std::pair{"a.vtp", "XMLPolyData"}, {"a.ply", "PLY"}, {"a.stl", "STL"}, {"a.obj", "OBJ"}}) {
    write_surface(directory / name, cube(), arrays);
    EXPECT_EQ(python(std::string("import sys, vtk\nreader = vtk.vtk") + reader + R"(Reader()
reader.SetFileName(sys.argv[1])
reader.Update()
mass = vtk.vtkMassProperties()
mass.SetInputConnection(reader.GetOutputPort())
print(reader.GetOutput().GetNumberOfPoints(), reader.GetOutput().GetNumberOfCells(), round(mass.GetVolume(), 6))
)",
                     (directory / name).string()),
              "8 12 1.0\n")
        << name;
  }
}

// Fields, names that need escapes included, survive VTK's readers and its writers, and then ours. (It writes six digits as text.)
TEST(WriteVtk, VtkReadsAndRewritesFields) {
  if (!has_vtk()) GTEST_SKIP() << "needs " << kPython << " with the module vtk (Debian: python3-vtk9)";
  const TestDirectory directory;
  const core::MeshData mesh = cube_mesh(2);
  const auto v = static_cast<std::int32_t>(mesh.positions.size()),
             t = static_cast<std::int32_t>(mesh.tets.size());
  std::vector<Field> fields{{"heat flow <%20>", Field::On::kVertices, 3, std::vector<float>()},
                            {"label", Field::On::kVertices, 1, std::vector<std::int32_t>()},
                            {"stress", Field::On::kTets, 9, std::vector<float>()}};
  for (std::int32_t i = 0; i < 3 * v; ++i)
    std::get<0>(fields[0].values).push_back(0.25f * static_cast<float>(i));
  for (std::int32_t i = 0; i < v; ++i) std::get<1>(fields[1].values).push_back(-i);
  for (std::int32_t i = 0; i < 9 * t; ++i)
    std::get<0>(fields[2].values).push_back(-0.5f * static_cast<float>(i));
  for (const char* name : {"a.vtu", "a.vtk"}) {
    SCOPED_TRACE(name);
    write_mesh(directory / name, mesh, fields);
    EXPECT_EQ(python(R"(
import sys, vtk
path = sys.argv[1]
reader = vtk.vtkXMLUnstructuredGridReader() if path.endswith("vtu") else vtk.vtkUnstructuredGridReader()
if path.endswith("vtk"):
    reader.ReadAllFieldsOn()
reader.SetFileName(path)
reader.Update()
grid = reader.GetOutput()
for data in (grid.GetPointData(), grid.GetCellData()):
    for i in range(data.GetNumberOfArrays()):
        array = data.GetArray(i)
        print(array.GetName(), array.GetDataTypeAsString(), array.GetNumberOfComponents(), array.GetNumberOfTuples())
for ending, make, settings in (("xml.vtu", vtk.vtkXMLUnstructuredGridWriter, lambda w: w.SetDataModeToAscii()),
                               ("zip.vtu", vtk.vtkXMLUnstructuredGridWriter, lambda w: w.SetCompressorTypeToZLib()),
                               ("text.vtk", vtk.vtkUnstructuredGridWriter, lambda w: w.SetFileTypeToASCII()),
                               ("packed.vtk", vtk.vtkUnstructuredGridWriter, lambda w: w.SetFileTypeToBinary())):
    writer = make()
    writer.SetFileName(path + "." + ending)
    writer.SetInputData(grid)
    settings(writer)
    writer.Write()
)",
                     directory / name),
              "heat flow <%20> float 3 27\nlabel int 1 27\nstress float 9 48\n");
    LoadOptions options;
    options.fields = true;
    for (const char* ending : {".xml.vtu", ".zip.vtu", ".text.vtk", ".packed.vtk"}) {
      SCOPED_TRACE(ending);
      const LoadedMesh loaded = load_mesh(directory / (std::string(name) + ending), options);
      ASSERT_EQ(loaded.fields.size(), fields.size());
      for (std::size_t f = 0; f < fields.size(); ++f) {
        EXPECT_EQ(loaded.fields[f].name, fields[f].name);
        EXPECT_EQ(loaded.fields[f].components, fields[f].components);
        EXPECT_EQ(loaded.fields[f].values, fields[f].values);
      }
    }
  }
}

}  // namespace
}  // namespace incise::mesh_io
