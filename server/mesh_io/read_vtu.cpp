#include <algorithm>
#include <cmath>
#include <set>
#include <utility>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/tet_collector.hpp"
#include "server/mesh_io/tet_files.hpp"
#include "server/mesh_io/text_file.hpp"
#include "server/mesh_io/vtk_xml.hpp"

namespace incise::mesh_io {
namespace {

class VtuReader {
 public:
  VtuReader(const std::string& file, std::vector<std::string>& warnings, std::vector<Field>* fields)
      : file_(file), in_({}, file), out_(in_), warnings_(warnings), fields_(fields, file, warnings) {}

  void add(const VtkXmlPiece& piece) {
    const std::size_t first = out_.node_count();
    add_points(piece);
    add_cells(piece, first);
    if (!fields_.wanted()) return;
    join(point_data_, piece.point_data, pieces_);
    std::vector<VtkXmlArray> cell_data = piece.cell_data;
    if (const VtkXmlArray* regions = region_array(piece))
      std::erase_if(cell_data, [regions](const VtkXmlArray& array) { return array.name == regions->name; });
    join(cell_data_, cell_data, pieces_);
    note_others(Field::On::kVertices, piece.other_point_data);
    note_others(Field::On::kTets, piece.other_cell_data);
    cells_ += piece.cells;
    ++pieces_;
  }
  void note_cut_memory(const VtkXmlArray& memory) { out_.note_cut_memory(memory.values); }
  core::MeshData finish() {
    if (std::ranges::any_of(cell_data_, [](const Joined& joined) { return joined.array.name == kCutMask; }))
      fields_.note_own_file();
    add_fields(Field::On::kVertices, point_data_, out_.node_count(), nullptr);
    add_fields(Field::On::kTets, cell_data_, cells_, &tet_cells_);
    return out_.finish(warnings_,
                       skipped_ == 0 ? "" : " (" + std::to_string(skipped_) + " points, lines or faces)");
  }

 private:
  [[noreturn]] void fail(const std::string& message) const { throw MeshError(file_ + ": " + message); }

  // An array of all pieces; `pieces` have come so far.
  struct Joined {
    RawArray array;
    std::size_t pieces = 0;
  };
  // The arrays of the next piece behind those of the same names.
  static void join(std::vector<Joined>& all, const std::vector<VtkXmlArray>& arrays, std::size_t pieces) {
    for (const VtkXmlArray& array : arrays) {
      auto known = std::find_if(all.begin(), all.end(), [&](const Joined& j) {
        return j.array.name == array.name && j.pieces == pieces && pieces > 0;
      });
      if (known == all.end()) {
        all.push_back({{array.name, array.components, array.whole, {}}, 0});
        known = all.end() - 1;
      }
      known->array.whole = known->array.whole && array.whole;
      if (known->array.components != array.components) continue;  // then it is not there in all pieces
      known->array.values.insert(known->array.values.end(), array.values.begin(), array.values.end());
      ++known->pieces;
    }
  }
  // Once for all pieces.
  void note_others(Field::On on, const std::vector<VtkXmlArray>& arrays) {
    for (const VtkXmlArray& array : arrays) {
      if (!others_.emplace(on, array.name).second) continue;
      fields_.leave_out(
          on, array.name,
          (array.type == "String" ? "it holds texts" : "it is of type " + in_quotes(array.type)) +
              "; numbers are accepted");
    }
  }
  void add_fields(Field::On on, std::vector<Joined>& all, std::size_t rows,
                  const std::vector<std::uint32_t>* pick) {
    for (Joined& joined : all) {
      if (joined.pieces == pieces_) {
        fields_.add(on, std::move(joined.array), rows, pick);
      } else {
        fields_.leave_out(on, joined.array.name, "not all pieces of the file have it");
      }
    }
  }

  void add_points(const VtkXmlPiece& piece) {
    if (piece.points == 0 && piece.point_arrays.empty()) return;
    if (piece.point_arrays.size() != 1) fail("a piece has no <Points> with one array");
    const VtkXmlArray& points = piece.point_arrays[0];
    check_size(points, 3 * piece.points, "the points");
    for (std::size_t i = 0; i < piece.points; ++i) {
      const double* x = points.values.data() + 3 * i;
      const core::Vec3 p{x[0], x[1], x[2]};
      if (!core::is_finite(p)) fail("a coordinate of point " + std::to_string(i) + " is not finite");
      out_.add_node(static_cast<std::int64_t>(out_.node_count()), p);
    }
    out_.end_nodes();
  }

  void add_cells(const VtkXmlPiece& piece, std::size_t first_point) {
    if (piece.cells == 0) return;
    const VtkXmlArray &connectivity = find(piece, "connectivity"), &offsets = find(piece, "offsets"),
                      &types = find(piece, "types");
    check_size(offsets, piece.cells, "the offsets of cells");
    check_size(types, piece.cells, "the types of cells");
    const VtkXmlArray* regions = region_array(piece);
    const VtkXmlArray* masks = cut_mask_array(piece);
    double begin = 0;
    for (std::size_t i = 0; i < piece.cells; ++i) {
      const double end = offsets.values[i];
      if (!(end >= begin && end <= static_cast<double>(connectivity.values.size())) ||
          end != std::floor(end)) {
        fail("the offset " + to_text(end) + " of cell " + std::to_string(i) + " is out of order");
      }
      const auto from = static_cast<std::size_t>(begin), size = static_cast<std::size_t>(end) - from;
      add_cell(i, types.values[i], {connectivity.values.data() + from, size}, first_point, piece.points,
               regions ? regions->values[i] : 0, masks ? masks->values[i] : 0);
      begin = end;
    }
  }

  void add_cell(std::size_t index, double type, std::span<const double> points, std::size_t first_point,
                std::size_t point_count, double region, double cut_mask) {
    const std::string cell = "cell " + std::to_string(index);
    const int nodes = type >= 0 && type <= 255 ? vtk_tet_nodes(static_cast<std::int64_t>(type)) : -1;
    if (nodes < 0) {
      fail(cell + " is of type " + to_text(type) +
           "; of cells of three dimensions only tetrahedra (10) can be cut");
    }
    if (nodes == 0) {
      ++skipped_;
      return;
    }
    if (points.size() < static_cast<std::size_t>(nodes) || (type == 10 && points.size() != 4)) {
      fail(cell + " has " + std::to_string(points.size()) + " points; its type has " + std::to_string(nodes));
    }
    if (type != 10) out_.note_higher_order();
    std::array<core::VertexId, 4> corners;
    for (std::size_t k = 0; k < 4; ++k) {
      const double point = points[k];
      if (!(point >= 0 && point < static_cast<double>(point_count)) || point != std::floor(point)) {
        fail(cell + ": the point " + to_text(point) + " does not exist; there are " +
             std::to_string(point_count));
      }
      corners[k] = static_cast<core::VertexId>(first_point + static_cast<std::size_t>(point));
    }
    if (!(region >= -2147483648.0 && region <= 2147483647.0)) {
      fail(cell + ": the region " + to_text(region) +
           " is out of range; accepted are -2147483648 to 2147483647");
    }
    out_.add_tet(corners, static_cast<std::int64_t>(region));
    if (cut_mask != 0) out_.note_cut_faces(cut_mask);
    if (fields_.wanted()) tet_cells_.push_back(static_cast<std::uint32_t>(cells_ + index));
  }

  const VtkXmlArray& find(const VtkXmlPiece& piece, std::string_view name) const {
    for (const VtkXmlArray& array : piece.cell_arrays) {
      if (array.name == name) return array;
    }
    fail("<Cells> has no array '" + std::string(name) + "'");
  }

  const VtkXmlArray* region_array(const VtkXmlPiece& piece) const {
    std::vector<std::string> names;
    for (const VtkXmlArray& array : piece.cell_data) names.push_back(array.name);
    const int found = find_region_array(names);
    if (found < 0) return nullptr;
    const VtkXmlArray& array = piece.cell_data[static_cast<std::size_t>(found)];
    check_size(array, piece.cells, "the array '" + array.name + "'");
    return &array;
  }

  const VtkXmlArray* cut_mask_array(const VtkXmlPiece& piece) const {
    for (const VtkXmlArray& array : piece.cell_data) {
      if (array.name == kCutMask && array.values.size() == piece.cells) return &array;
    }
    return nullptr;
  }

  void check_size(const VtkXmlArray& array, std::size_t size, const std::string& what) const {
    if (array.values.size() == size) return;
    fail(what + " are " + std::to_string(array.values.size()) + " numbers; the piece declares " +
         std::to_string(size));
  }

  std::string file_;
  TokenReader in_;  // for messages of out_
  TetCollector out_;
  std::size_t skipped_ = 0;
  std::vector<std::string>& warnings_;
  FieldCollector fields_;
  std::vector<Joined> point_data_, cell_data_;
  std::set<std::pair<Field::On, std::string>> others_;  // arrays without numbers
  std::size_t pieces_ = 0, cells_ = 0;
  std::vector<std::uint32_t> tet_cells_;  // which cell of the file each tetrahedron is
};

}  // namespace

core::MeshData parse_vtu(std::string_view bytes, const std::string& file, std::vector<std::string>& warnings,
                         std::vector<Field>* fields) {
  VtuReader reader(file, warnings, fields);
  const VtkXmlContent content = read_vtk_xml(bytes, file, fields != nullptr);
  for (const VtkXmlPiece& piece : content.pieces) reader.add(piece);
  for (const VtkXmlArray& memory : content.field_data) reader.note_cut_memory(memory);
  return reader.finish();
}

}  // namespace incise::mesh_io
