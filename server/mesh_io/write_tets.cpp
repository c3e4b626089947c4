// Writers of tetrahedral meshes; read_*.cpp name the sources of the layouts.

#include <algorithm>
#include <bit>
#include <limits>

#include "server/base/check.hpp"
#include "server/mesh_io/tet_files.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::mesh_io {
namespace {

using Tets = std::span<const std::array<core::VertexId, 4>>;

// Big-endian, as legacy VTK requires.
template <class T>
void append_big(std::string& bytes, T value) {
  const auto raw = std::bit_cast<std::array<char, sizeof(T)>>(value);
  static_assert(std::endian::native == std::endian::little);
  bytes.append(raw.rbegin(), raw.rend());
}

void append_numbers(std::string& text, std::initializer_list<std::int64_t> numbers) {
  for (const std::int64_t number : numbers) {
    if (!text.empty() && text.back() != '\n') text += ' ';
    append_number(text, number);
  }
}

void append_point(std::string& text, const core::Vec3& p) {
  for (const double x : {p.x, p.y, p.z}) {
    if (!text.empty() && text.back() != '\n') text += ' ';
    append_number(text, x);
  }
}

void append_tet(std::string& text, const std::array<core::VertexId, 4>& tet) {
  for (const core::VertexId v : tet) append_numbers(text, {std::int64_t{v} + 1});
}

template <class T>
constexpr const char* kVtkName = nullptr;
template <>
constexpr const char* kVtkName<std::uint8_t> = "unsigned_char";
template <>
constexpr const char* kVtkName<std::int32_t> = "int";
template <>
constexpr const char* kVtkName<std::uint32_t> = "unsigned_int";
template <>
constexpr const char* kVtkName<float> = "float";
template <>
constexpr const char* kVtkName<double> = "double";

// Blanks end a name in a legacy file; VTK writes and reads %20, and so on for all but visible ASCII.
std::string vtk_name(const std::string& name) {
  std::string text;
  for (const char c : name) {
    if (c <= ' ' || c >= '~' || c == '%' || c == '"') {
      static constexpr char kHex[] = "0123456789ABCDEF";
      text += '%';
      text += kHex[static_cast<unsigned char>(c) >> 4];
      text += kHex[static_cast<unsigned char>(c) & 15];
    } else {
      text += c;
    }
  }
  return text;
}

// The regions in ascending order, and the tetrahedra of each.
struct Volume {
  std::int32_t region = 0;
  std::vector<std::size_t> tets;
};
std::vector<Volume> volumes_of(std::size_t tets, std::span<const std::int32_t> regions) {
  std::vector<std::int32_t> values(regions.begin(), regions.end());
  if (values.empty()) values.push_back(0);
  std::sort(values.begin(), values.end());
  values.erase(std::unique(values.begin(), values.end()), values.end());
  std::vector<Volume> volumes;
  for (const std::int32_t region : values) volumes.push_back({region, {}});
  for (std::size_t t = 0; t < tets; ++t) {
    const auto at =
        regions.empty() ? values.begin() : std::lower_bound(values.begin(), values.end(), regions[t]);
    volumes[static_cast<std::size_t>(at - values.begin())].tets.push_back(t);
  }
  return volumes;
}

void append_bounds(std::string& text, std::span<const core::Vec3> positions, Tets tets,
                   const Volume& volume) {
  constexpr double kFar = std::numeric_limits<double>::max();
  core::Vec3 low{kFar, kFar, kFar}, high{-kFar, -kFar, -kFar};
  for (const std::size_t t : volume.tets) {
    for (const core::VertexId v : tets[t]) {
      const core::Vec3& p = positions[v];
      extend(p, low, high);
    }
  }
  append_point(text, low);
  append_point(text, high);
}

std::string gmsh_2(std::span<const core::Vec3> positions, Tets tets, const std::vector<Volume>& volumes) {
  std::string text =
      "$MeshFormat\n2.2 0 8\n$EndMeshFormat\n$Nodes\n" + std::to_string(positions.size()) + "\n";
  for (std::size_t i = 0; i < positions.size(); ++i) {
    append_numbers(text, {static_cast<std::int64_t>(i) + 1});
    append_point(text, positions[i]);
    text += '\n';
  }
  text += "$EndNodes\n$Elements\n" + std::to_string(tets.size()) + "\n";
  std::int64_t number = 0, tag = 0;
  for (const Volume& volume : volumes) {
    ++tag;
    for (const std::size_t t : volume.tets) {
      append_numbers(text, {++number, 4, 2, volume.region, tag});
      append_tet(text, tets[t]);
      text += '\n';
    }
  }
  return text + "$EndElements\n";
}

std::string gmsh_4(std::span<const core::Vec3> positions, Tets tets, const std::vector<Volume>& volumes) {
  const auto nodes = static_cast<std::int64_t>(positions.size());
  std::string text =
      "$MeshFormat\n4.1 0 8\n$EndMeshFormat\n$Entities\n0 0 0 " + std::to_string(volumes.size()) + "\n";
  std::int64_t tag = 0;
  for (const Volume& volume : volumes) {
    append_numbers(text, {++tag});
    append_bounds(text, positions, tets, volume);
    append_numbers(text, {volume.region != 0});
    if (volume.region != 0) append_numbers(text, {volume.region});
    text += " 0\n";
  }
  text += "$EndEntities\n$Nodes\n";
  append_numbers(text, {1, nodes, 1, nodes});
  text += '\n';
  append_numbers(text, {3, 1, 0, nodes});
  text += '\n';
  for (std::int64_t i = 1; i <= nodes; ++i) text += std::to_string(i) + '\n';
  for (const core::Vec3& p : positions) {
    append_point(text, p);
    text += '\n';
  }
  text += "$EndNodes\n$Elements\n";
  const auto count = static_cast<std::int64_t>(tets.size());
  append_numbers(text, {static_cast<std::int64_t>(volumes.size()), count, 1, count});
  text += '\n';
  std::int64_t number = tag = 0;
  for (const Volume& volume : volumes) {
    append_numbers(text, {3, ++tag, 4, static_cast<std::int64_t>(volume.tets.size())});
    text += '\n';
    for (const std::size_t t : volume.tets) {
      append_numbers(text, {++number});
      append_tet(text, tets[t]);
      text += '\n';
    }
  }
  return text + "$EndElements\n";
}

}  // namespace

namespace {

// Those on vertices or on tetrahedra, `rows` values each. Empty where there are none.
std::string vtk_fields(std::span<const Field> fields, Field::On on, std::size_t rows) {
  std::string bytes;
  std::size_t count = 0;
  for (const Field& field : fields) {
    if (field.on != on) continue;
    ++count;
    INCISE_CHECK(field.rows() == rows, field.name, field.rows(), rows);
    std::visit(
        [&](const auto& values) {
          using T = typename std::decay_t<decltype(values)>::value_type;
          bytes += "\n" + vtk_name(field.name) + " " + std::to_string(field.components) + " " +
                   std::to_string(rows) + " " + kVtkName<T> + "\n";
          for (const T value : values) append_big(bytes, value);
        },
        field.values);
  }
  return count == 0 ? "" : "\nFIELD fields " + std::to_string(count) + bytes;
}

}  // namespace

void write_vtk_legacy(const std::filesystem::path& path, std::span<const core::Vec3> positions, Tets tets,
                      std::span<const CellArray> cell_data, std::span<const Field> fields,
                      std::span<const std::byte> cut_memory) {
  const std::string cells = std::to_string(tets.size());
  std::string bytes = "# vtk DataFile Version 3.0\nincise, metres\nBINARY\nDATASET UNSTRUCTURED_GRID\n";
  if (!cut_memory.empty()) {
    bytes += "FIELD FieldData 1\n" + std::string(kCutMemory) + " 1 " + std::to_string(cut_memory.size()) +
             " unsigned_char\n";
    bytes.append(reinterpret_cast<const char*>(cut_memory.data()), cut_memory.size());
    bytes += "\n";
  }
  bytes += "POINTS " + std::to_string(positions.size()) + " double\n";
  for (const core::Vec3& p : positions) {
    for (const double x : {p.x, p.y, p.z}) append_big(bytes, x);
  }
  bytes += "\nCELLS " + cells + " " + std::to_string(5 * tets.size()) + "\n";
  for (const auto& tet : tets) {
    append_big(bytes, std::int32_t{4});
    for (const core::VertexId v : tet) append_big(bytes, static_cast<std::int32_t>(v));
  }
  bytes += "\nCELL_TYPES " + cells + "\n";
  for (std::size_t t = 0; t < tets.size(); ++t) append_big(bytes, std::int32_t{10});  // VTK_TETRA
  const std::string of_tets = vtk_fields(fields, Field::On::kTets, tets.size()),
                    of_vertices = vtk_fields(fields, Field::On::kVertices, positions.size());
  if (!cell_data.empty() || !of_tets.empty()) bytes += "\nCELL_DATA " + cells;
  for (const CellArray& array : cell_data) {
    std::visit(
        [&](const auto& values) {
          INCISE_CHECK(values.size() == tets.size(), array.name, values.size(), tets.size());
          using T = typename std::decay_t<decltype(values)>::value_type;
          bytes += "\nSCALARS " + vtk_name(array.name) + " " + kVtkName<T> + " 1\nLOOKUP_TABLE default\n";
          for (const T value : values) append_big(bytes, value);
        },
        array.values);
  }
  bytes += of_tets;
  if (!of_vertices.empty()) bytes += "\nPOINT_DATA " + std::to_string(positions.size()) + of_vertices;
  write_whole_file(path, bytes + "\n");
}

void write_gmsh(const std::filesystem::path& path, std::span<const core::Vec3> positions, Tets tets,
                std::span<const std::int32_t> regions, bool version_4) {
  const std::vector<Volume> volumes = volumes_of(tets.size(), regions);
  write_whole_file(path, version_4 ? gmsh_4(positions, tets, volumes) : gmsh_2(positions, tets, volumes));
}

void write_medit(const std::filesystem::path& path, std::span<const core::Vec3> positions, Tets tets,
                 std::span<const std::int32_t> regions) {
  std::string text =
      "MeshVersionFormatted 2\nDimension 3\nVertices\n" + std::to_string(positions.size()) + "\n";
  for (const core::Vec3& p : positions) {
    append_point(text, p);
    text += " 0\n";
  }
  text += "Tetrahedra\n" + std::to_string(tets.size()) + "\n";
  for (std::size_t t = 0; t < tets.size(); ++t) {
    append_tet(text, tets[t]);
    append_numbers(text, {regions.empty() ? 0 : regions[t]});
    text += '\n';
  }
  write_whole_file(path, text + "End\n");
}

}  // namespace incise::mesh_io
