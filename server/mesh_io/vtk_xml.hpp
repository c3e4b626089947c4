#pragma once

#include <map>
#include <string>
#include <string_view>
#include <vector>

namespace incise::mesh_io {

// One <DataArray>: numbers of any type, as doubles (which hold every integer that a mesh of this size needs).
struct VtkXmlArray {
  std::string name;
  std::size_t components = 1;
  bool whole = false;  // its type is an integer
  std::string type;    // as the file names it: "UInt32"
  std::vector<double> values;
};

// A <Piece> of an unstructured grid, or of poly data.
struct VtkXmlPiece {
  std::size_t points = 0, cells = 0;      // of poly data: points, lines, strips and polygons are cells
  std::vector<VtkXmlArray> point_arrays;  // of <Points>
  std::vector<VtkXmlArray> cell_arrays;   // of <Cells>: connectivity, offsets, types; none of poly data
  std::vector<VtkXmlArray> cell_data;     // those that may be the region; with fields, all
  std::vector<VtkXmlArray> point_data;    // with fields
  // With fields: those of the last two that hold no numbers, but texts for example; without values.
  std::vector<VtkXmlArray> other_cell_data, other_point_data;
};

struct VtkXmlContent {
  std::vector<VtkXmlPiece> pieces;
  std::vector<VtkXmlArray> field_data;  // kCutMemory, if the file has it
};

enum class VtkXmlKind { kUnstructuredGrid, kPolyData };

// Reads a VTK XML file of that kind (for grids see parse_vtu in tet_files.hpp). Every array is checked against what its
// bytes can hold before anything is allocated. `fields`: all data of points and cells that are numbers are wanted. Throws MeshError with the file and the line, or the array's name.
VtkXmlContent read_vtk_xml(std::string_view bytes, const std::string& file, bool fields = false,
                           VtkXmlKind kind = VtkXmlKind::kUnstructuredGrid);

}  // namespace incise::mesh_io
