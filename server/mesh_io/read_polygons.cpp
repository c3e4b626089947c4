// The text formats of polygons, OFF and OBJ.
#include <cstdlib>
#include <string>

#include "server/mesh_io/surface_reading.hpp"

namespace incise::mesh_io {
namespace {

using core::VertexId;

// The vertex in "v", "v/vt", "v/vt/vn" or "v//vn": counted from 1, or backwards from the end if
// negative.
VertexId obj_vertex(const LineReader& in, std::string_view field, std::size_t vertices) {
  const std::string text(field.substr(0, field.find('/')));
  char* end = nullptr;
  const long long index = std::strtoll(text.c_str(), &end, 10);
  const auto count = static_cast<long long>(vertices);
  if (text.empty() || *end != '\0')
    in.fail("the vertex '" + std::string(field.substr(0, 40)) + "' is not an integer");
  if (index == 0 || index > count || index < -count) {
    in.fail("vertex " + std::to_string(index) + " does not exist; there are " + std::to_string(count) +
            " so far, counted from 1");
  }
  return static_cast<VertexId>(index > 0 ? index - 1 : count + index);
}

}  // namespace

Surface read_off(const std::filesystem::path& path) {
  const std::string text = read_whole_file(path);
  LineReader in(text, path.string());
  in.require("'OFF'");
  // [ST][C][N][4][n]OFF [BINARY]; the counts may share the line, and the word may be missing.
  std::size_t first = 0;
  std::string_view word = in.field(0);
  if (word.ends_with("OFF")) {
    word.remove_suffix(3);
    if (word.find('4') != word.npos || word.find('n') != word.npos)
      in.fail("only points of three dimensions are accepted");
    if (in.size() > 1 && in.field(1) == "BINARY") in.fail("binary OFF is not accepted: write it as ASCII");
    first = 1;
    if (in.size() == 1) {
      in.require("the counts of vertices, faces and edges");
      first = 0;
    }
  }
  // Least bytes: "0 0 0" and "3 0 1 2", each with its end of line.
  const std::size_t vertices = in.count_of_rest(first, "the number of vertices", 6);
  const std::size_t faces = in.count_of_rest(first + 1, "the number of faces", 8);
  Surface surface;
  surface.positions.reserve(vertices);
  surface.triangles.reserve(faces);
  for (std::size_t i = 0; i < vertices; ++i) {
    in.require("vertex " + std::to_string(i) + " of " + std::to_string(vertices));
    surface.positions.push_back(read_point(in, 0));
  }
  std::vector<VertexId> corners;
  for (std::size_t i = 0; i < faces; ++i) {
    in.require("face " + std::to_string(i) + " of " + std::to_string(faces));
    const std::size_t count = in.count(0, "the number of corners", kMaxPolygonCorners);
    if (count < 3) in.fail("a face of " + std::to_string(count) + " corners; it has three or more");
    corners.clear();
    for (std::size_t k = 1; k <= count; ++k) {
      const std::int64_t index = in.integer(k, "the index of a corner");
      if (index < 0 || index >= static_cast<std::int64_t>(vertices)) {
        in.fail("vertex " + std::to_string(index) + " does not exist; there are " + std::to_string(vertices) +
                ", counted from 0");
      }
      corners.push_back(static_cast<VertexId>(index));
    }
    add_polygon(surface, corners);
  }
  if (in.next())
    in.fail("a line after the last of the " + std::to_string(faces) + " faces that the header declares");
  return finish(std::move(surface), path);
}

Surface read_obj(const std::filesystem::path& path) {
  std::string text = read_whole_file(path);
  // A backslash before the end of a line joins it with the next.
  for (auto i = text.find("\\\n"); i != text.npos; i = text.find("\\\n", i)) text.replace(i, 2, "  ");
  LineReader in(text, path.string());
  Surface surface;
  std::vector<VertexId> corners;
  while (in.next()) {
    if (in.field(0) == "v") {
      surface.positions.push_back(read_point(in, 1));
      if (surface.positions.size() > kMaxSurfaceVertices)
        in.fail("more than " + std::to_string(kMaxSurfaceVertices) + " vertices");
    } else if (in.field(0) == "f") {
      if (in.size() < 4)
        in.fail("a face of " + std::to_string(in.size() - 1) + " corners; it has three or more");
      if (in.size() > kMaxPolygonCorners + 1)
        in.fail("a face of more than " + std::to_string(kMaxPolygonCorners) + " corners");
      corners.clear();
      for (std::size_t i = 1; i < in.size(); ++i) {
        corners.push_back(obj_vertex(in, in.field(i), surface.positions.size()));
      }
      add_polygon(surface, corners);
    }
  }
  return finish(std::move(surface), path);
}

}  // namespace incise::mesh_io
