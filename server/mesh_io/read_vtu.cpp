#include <cmath>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/tet_collector.hpp"
#include "server/mesh_io/tet_files.hpp"
#include "server/mesh_io/vtk_xml.hpp"

namespace incise::mesh_io {
namespace {

class VtuReader {
 public:
  explicit VtuReader(const std::string& file) : file_(file), in_({}, file), out_(in_) {}

  void add(const VtkXmlPiece& piece) {
    const std::size_t first = out_.node_count();
    add_points(piece);
    add_cells(piece, first);
  }
  core::MeshData finish(std::vector<std::string>& warnings) {
    return out_.finish(warnings,
                       skipped_ == 0 ? "" : " (" + std::to_string(skipped_) + " points, lines or faces)");
  }

 private:
  [[noreturn]] void fail(const std::string& message) const { throw MeshError(file_ + ": " + message); }

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
    double begin = 0;
    for (std::size_t i = 0; i < piece.cells; ++i) {
      const double end = offsets.values[i];
      if (!(end >= begin && end <= static_cast<double>(connectivity.values.size())) ||
          end != std::floor(end)) {
        fail("the offset " + to_text(end) + " of cell " + std::to_string(i) + " is out of order");
      }
      const auto from = static_cast<std::size_t>(begin), size = static_cast<std::size_t>(end) - from;
      add_cell(i, types.values[i], {connectivity.values.data() + from, size}, first_point, piece.points,
               regions ? regions->values[i] : 0);
      begin = end;
    }
  }

  void add_cell(std::size_t index, double type, std::span<const double> points, std::size_t first_point,
                std::size_t point_count, double region) {
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

  void check_size(const VtkXmlArray& array, std::size_t size, const std::string& what) const {
    if (array.values.size() == size) return;
    fail(what + " are " + std::to_string(array.values.size()) + " numbers; the piece declares " +
         std::to_string(size));
  }

  std::string file_;
  TokenReader in_;  // for messages of out_
  TetCollector out_;
  std::size_t skipped_ = 0;
};

}  // namespace

core::MeshData parse_vtu(std::string_view bytes, const std::string& file,
                         std::vector<std::string>& warnings) {
  VtuReader reader(file);
  for (const VtkXmlPiece& piece : read_vtk_xml(bytes, file)) reader.add(piece);
  return reader.finish(warnings);
}

}  // namespace incise::mesh_io
