#include "server/mesh_io/tetgen_files.hpp"

#include <cmath>
#include <filesystem>
#include <limits>
#include <string>
#include <system_error>
#include <tuple>
#include <utility>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/tet_files.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::mesh_io {
namespace {

// Least bytes: "0 0 0 0" and "0 0 1 2 3", each with its end of line.
constexpr std::size_t kMinNodeLine = 8, kMinEleLine = 10;

// The index at the start of a data line must count up from the first one: a gap means a lost line.
void check_index(const LineReader& in, std::size_t i, std::int64_t base, std::string_view what) {
  const std::int64_t index = in.integer(0, std::string("the index of a ") + std::string(what));
  const std::int64_t expected = base + static_cast<std::int64_t>(i);
  if (index != expected) {
    in.fail("the " + std::string(what) + "'s index is " + std::to_string(index) + ", expected " +
            std::to_string(expected) + ": indices start at 0 or 1 and count up by one");
  }
}

void require_end(LineReader& in, std::size_t count, std::string_view what) {
  if (in.next()) {
    in.fail("a line after the last of the " + std::to_string(count) + " " + std::string(what) +
            " that the header declares; correct the count in the first line");
  }
}

[[noreturn]] void fail_too_many(const LineReader& in, std::size_t count, std::string_view what) {
  in.fail("declares " + std::to_string(count) + " " + std::string(what) + "; at most " +
          std::to_string(kMaxTets) + " are accepted");
}

void read_nodes(const std::filesystem::path& path, core::MeshData& mesh, int& index_base) {
  const std::string text = read_whole_file(path);
  LineReader in(text, path.string());
  in.require("the header 'points dimension attributes markers'");
  in.integer(0, "the number of points");  // a file of another kind fails here
  // The dimension before the count is checked: a line of a flat mesh is shorter, so its count would look wrong.
  if (const std::int64_t dimension = in.integer(1, "the dimension"); dimension != 3) {
    in.fail("the dimension is not 3 but " + std::to_string(dimension) +
            ": a flat mesh; accepted are tetrahedra, as TetGen writes them");
  }
  const std::size_t count = in.count_of_rest(0, "the number of points", kMinNodeLine);
  if (count > kMaxTets) fail_too_many(in, count, "points");
  if (count < 4) in.fail("the number of points is " + std::to_string(count) + "; a tetrahedron needs four");
  mesh.positions.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    in.require("point " + std::to_string(i + 1) + " of " + std::to_string(count));
    if (i == 0) {
      index_base = in.integer(0, "the index of a point") == 1 ? 1 : 0;
    }
    check_index(in, i, index_base, "point");
    mesh.positions.push_back({in.number(1, "the coordinate x"), in.number(2, "the coordinate y"),
                              in.number(3, "the coordinate z")});
  }
  require_end(in, count, "points");
}

void read_elements(const std::filesystem::path& path, core::MeshData& mesh, int index_base,
                   std::vector<std::string>& warnings) {
  const std::string text = read_whole_file(path);
  LineReader in(text, path.string());
  in.require("the header 'tetrahedra nodes attributes'");
  const std::size_t count = in.count_of_rest(0, "the number of tetrahedra", kMinEleLine);
  if (count > kMaxTets) fail_too_many(in, count, "tetrahedra");
  if (count == 0) in.fail("the number of tetrahedra is 0: there is nothing to cut");
  const std::int64_t nodes = in.size() > 1 ? in.integer(1, "the number of nodes a tetrahedron") : 4;
  if (nodes != 4 && nodes != 10)
    in.fail("tetrahedra of " + std::to_string(nodes) + " nodes; 4 and 10 are accepted");
  const bool has_region = in.size() > 2 && in.integer(2, "the number of attributes") > 0;
  if (nodes == 10) {
    warnings.push_back(path.string() +
                       ": tetrahedra of 10 nodes: the corners are kept, the edges become straight");
  }
  mesh.tets.reserve(count);
  if (has_region) mesh.regions.reserve(count);
  std::size_t rounded = 0;
  for (std::size_t i = 0; i < count; ++i) {
    in.require("tetrahedron " + std::to_string(i + 1) + " of " + std::to_string(count));
    // TetGen counts tetrahedra from the same base as points; a few writers do not, and nothing depends on it.
    if (i == 0 && in.integer(0, "the index of a tetrahedron") != index_base)
      check_index(in, 0, 1 - index_base, "tetrahedron");
    std::array<core::VertexId, 4> tet;
    for (std::size_t k = 0; k < 4; ++k) {
      const std::int64_t index = in.integer(1 + k, "the index of a node");
      const std::int64_t vertex = index - index_base;
      if (vertex < 0 || vertex >= static_cast<std::int64_t>(mesh.positions.size())) {
        in.fail("the node " + std::to_string(index) + " does not exist; the .node file has " +
                std::to_string(index_base) + " to " +
                std::to_string(index_base + static_cast<std::int64_t>(mesh.positions.size()) - 1));
      }
      tet[k] = static_cast<core::VertexId>(vertex);
    }
    mesh.tets.push_back(tet);
    if (has_region) {
      const double value = in.number(1 + static_cast<std::size_t>(nodes), "the region attribute");
      const double region = std::nearbyint(value);
      if (std::abs(region) > std::numeric_limits<std::int32_t>::max())
        in.fail("the region attribute is out of range; accepted are -2147483647 to 2147483647");
      if (region != value && rounded++ == 0) {
        warnings.push_back(path.string() + ":" + std::to_string(in.line()) + ": the attribute " +
                           to_text(value) + " is not an integer: regions are rounded to the nearest");
      }
      mesh.regions.push_back(static_cast<std::int32_t>(region));
    }
  }
  require_end(in, count, "tetrahedra");
}

}  // namespace

TetgenPaths tetgen_paths(const std::filesystem::path& path) {
  auto base = path;
  const auto ending = path.extension();
  if (ending == ".node" || ending == ".ele") base.replace_extension();
  TetgenPaths paths{base, base};
  paths.node += ".node";
  paths.ele += ".ele";
  return paths;
}

core::MeshData read_tetgen(const std::filesystem::path& path, int& index_base,
                           std::vector<std::string>& warnings) {
  const TetgenPaths paths = tetgen_paths(path);
  const auto is_there = [](const std::filesystem::path& file) {
    std::error_code error;
    return std::filesystem::exists(file, error);
  };
  for (const auto& [missing, other, has] :
       {std::tuple{paths.ele, paths.node, "points"}, {paths.node, paths.ele, "tetrahedra"}}) {
    if (is_there(other) && !is_there(missing))
      throw MeshError(missing.string() + ": no such file; " + other.string() + " has only the " + has +
                      ": put the other file of TetGen's pair beside it");
  }
  core::MeshData mesh;
  read_nodes(paths.node, mesh, index_base);
  read_elements(paths.ele, mesh, index_base, warnings);
  return mesh;
}

void write_tetgen(const std::filesystem::path& path, std::span<const core::Vec3> positions,
                  std::span<const std::array<core::VertexId, 4>> tets,
                  std::span<const std::int32_t> regions) {
  const TetgenPaths paths = tetgen_paths(path);
  std::string text = std::to_string(positions.size()) + " 3 0 0\n";
  text.reserve(positions.size() * 70);
  for (std::size_t i = 0; i < positions.size(); ++i) {
    append_number(text, static_cast<std::int64_t>(i));
    for (const double x : {positions[i].x, positions[i].y, positions[i].z}) {
      text += ' ';
      append_number(text, x);
    }
    text += '\n';
  }
  const std::string nodes = std::exchange(text, {});
  text = std::to_string(tets.size()) + (regions.empty() ? " 4 0\n" : " 4 1\n");
  for (std::size_t i = 0; i < tets.size(); ++i) {
    append_number(text, static_cast<std::int64_t>(i));
    for (const core::VertexId v : tets[i]) {
      text += ' ';
      append_number(text, static_cast<std::int64_t>(v));
    }
    if (!regions.empty()) {
      text += ' ';
      append_number(text, static_cast<std::int64_t>(regions[i]));
    }
    text += '\n';
  }
  write_whole_files({{paths.node, nodes}, {paths.ele, text}});  // one alone is of no use
}

}  // namespace incise::mesh_io
