#include "server/mesh_io/write_vtk.hpp"

#include <bit>
#include <cstring>
#include <map>

#include "server/base/check.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::mesh_io {
namespace {

static_assert(std::endian::native == std::endian::little, "arrays are written as they lie in memory");
static_assert(sizeof(core::Vec3) == 3 * sizeof(double));

template <class T>
constexpr const char* kTypeName = nullptr;
template <>
constexpr const char* kTypeName<std::uint8_t> = "UInt8";
template <>
constexpr const char* kTypeName<std::int32_t> = "Int32";
template <>
constexpr const char* kTypeName<std::uint32_t> = "UInt32";
template <>
constexpr const char* kTypeName<std::int64_t> = "Int64";
template <>
constexpr const char* kTypeName<float> = "Float32";
template <>
constexpr const char* kTypeName<double> = "Float64";

// Collects the XML part and the appended data of one file.
class VtkXmlFile {
 public:
  explicit VtkXmlFile(const char* type) : type_(type) {
    xml_ = "<?xml version=\"1.0\"?>\n<VTKFile type=\"" + type_ +
           "\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n<" + type_ + ">\n";
  }

  void add(const std::string& xml) { xml_ += xml; }

  // `tuples`: said where neither points nor cells do.
  template <class T>
  void add_array(const std::string& name, const T* values, std::size_t count, int components = 1,
                 std::size_t tuples = 0) {
    xml_ += "<DataArray type=\"" + std::string(kTypeName<T>) + "\" Name=\"" + escaped(name) +
            "\" NumberOfComponents=\"" + std::to_string(components) +
            (tuples == 0 ? "" : "\" NumberOfTuples=\"" + std::to_string(tuples)) +
            "\" format=\"appended\" offset=\"" + std::to_string(data_.size()) + "\"/>\n";
    const std::uint64_t bytes = count * sizeof(T);
    append(&bytes, sizeof bytes);
    append(values, bytes);
  }

  void add_fields(std::span<const Field> fields, Field::On on, std::size_t rows) {
    for (const Field& field : fields) {
      if (field.on != on) continue;
      INCISE_CHECK(field.rows() == rows, field.name, field.rows(), rows);
      std::visit(
          [&](const auto& values) {
            add_array(field.name, values.data(), values.size(), static_cast<int>(field.components));
          },
          field.values);
    }
  }

  void add_cell_data(std::span<const CellArray> arrays, std::size_t cells,
                     std::span<const Field> fields = {}) {
    xml_ += "<CellData>\n";
    for (const CellArray& array : arrays) {
      std::visit(
          [&](const auto& values) {
            INCISE_CHECK(values.size() == cells, array.name, values.size(), cells);
            add_array(array.name, values.data(), values.size());
          },
          array.values);
    }
    add_fields(fields, Field::On::kTets, cells);
    xml_ += "</CellData>\n";
  }

  void write(const std::filesystem::path& path) {
    xml_ += "</Piece>\n</" + type_ + ">\n<AppendedData encoding=\"raw\">\n_";
    xml_ += data_;
    xml_ += "\n</AppendedData>\n</VTKFile>\n";
    write_whole_file(path, xml_);
  }

 private:
  static std::string escaped(const std::string& name) {
    std::string text;
    for (const char c : name) {
      switch (c) {
        case '&':
          text += "&amp;";
          break;
        case '<':
          text += "&lt;";
          break;
        case '"':
          text += "&quot;";
          break;
        default:
          text += c;
      }
    }
    return text;
  }
  void append(const void* bytes, std::size_t count) {
    if (count > 0) data_.append(static_cast<const char*>(bytes), count);
  }

  std::string type_, xml_, data_;
};

template <std::size_t N>
void add_cells(VtkXmlFile& file, std::span<const std::array<core::VertexId, N>> cells) {
  std::vector<std::int64_t> connectivity, offsets;
  connectivity.reserve(N * cells.size());
  offsets.reserve(cells.size());
  for (const auto& cell : cells) {
    connectivity.insert(connectivity.end(), cell.begin(), cell.end());
    offsets.push_back(static_cast<std::int64_t>(connectivity.size()));
  }
  file.add_array("connectivity", connectivity.data(), connectivity.size());
  file.add_array("offsets", offsets.data(), offsets.size());
}

void add_points(VtkXmlFile& file, std::span<const core::Vec3> positions) {
  file.add("<Points>\n");
  file.add_array("Points", reinterpret_cast<const double*>(positions.data()), 3 * positions.size(), 3);
  file.add("</Points>\n");
}

}  // namespace

void write_vtu(const std::filesystem::path& path, std::span<const core::Vec3> positions,
               std::span<const std::array<core::VertexId, 4>> tets, std::span<const CellArray> cell_data,
               std::span<const Field> fields, std::span<const std::byte> cut_memory) {
  VtkXmlFile file("UnstructuredGrid");
  if (!cut_memory.empty()) {
    file.add("<FieldData>\n");
    file.add_array(std::string(kCutMemory), reinterpret_cast<const std::uint8_t*>(cut_memory.data()),
                   cut_memory.size(), 1, cut_memory.size());
    file.add("</FieldData>\n");
  }
  file.add("<Piece NumberOfPoints=\"" + std::to_string(positions.size()) + "\" NumberOfCells=\"" +
           std::to_string(tets.size()) + "\">\n");
  file.add("<PointData>\n");
  file.add_fields(fields, Field::On::kVertices, positions.size());
  file.add("</PointData>\n");
  file.add_cell_data(cell_data, tets.size(), fields);
  add_points(file, positions);
  file.add("<Cells>\n");
  add_cells(file, tets);
  const std::vector<std::uint8_t> types(tets.size(), 10);  // VTK_TETRA
  file.add_array("types", types.data(), types.size());
  file.add("</Cells>\n");
  file.write(path);
}

namespace {

// The surface with a point for each pair of a vertex and its texture coordinates, which VTK keeps by point.
struct SplitAtSeams {
  std::vector<core::Vec3> positions;
  std::vector<std::array<float, 2>> uvs;
  std::vector<std::array<core::VertexId, 3>> triangles;
};

SplitAtSeams split_at_seams(const Surface& surface) {
  SplitAtSeams out;
  std::map<std::pair<core::VertexId, std::array<float, 2>>, core::VertexId> known;
  for (std::size_t t = 0; t < surface.triangles.size(); ++t) {
    auto& corners = out.triangles.emplace_back();
    for (std::size_t k = 0; k < 3; ++k) {
      const core::VertexId v = surface.triangles[t][k];
      const auto& uv = surface.look.uvs[3 * t + k];
      const auto [place, is_new] = known.try_emplace({v, uv}, static_cast<core::VertexId>(known.size()));
      corners[k] = place->second;
      if (!is_new) continue;
      out.positions.push_back(surface.positions[v]);
      out.uvs.push_back(uv);
    }
  }
  return out;
}

}  // namespace

void write_vtp(const std::filesystem::path& path, const Surface& surface,
               std::span<const CellArray> cell_data) {
  SplitAtSeams split;
  const bool textured = !surface.look.uvs.empty();
  if (textured) split = split_at_seams(surface);
  const auto& positions = textured ? split.positions : surface.positions;
  const auto& triangles = textured ? split.triangles : surface.triangles;
  VtkXmlFile file("PolyData");
  file.add("<Piece NumberOfPoints=\"" + std::to_string(positions.size()) +
           "\" NumberOfVerts=\"0\" NumberOfLines=\"0\" NumberOfStrips=\"0\" NumberOfPolys=\"" +
           std::to_string(triangles.size()) + "\">\n");
  if (textured) {
    file.add("<PointData TCoords=\"TextureCoordinates\">\n");
    file.add_array("TextureCoordinates", split.uvs.front().data(), 2 * split.uvs.size(), 2);
    file.add("</PointData>\n");
  }
  file.add_cell_data(cell_data, triangles.size());
  add_points(file, positions);
  file.add("<Polys>\n");
  add_cells(file, std::span<const std::array<core::VertexId, 3>>(triangles));
  file.add("</Polys>\n");
  file.write(path);
}

}  // namespace incise::mesh_io
