// The text formats of polygons, OFF and OBJ.
#include <algorithm>
#include <cmath>
#include <cstdlib>
#include <string>

#include "server/mesh_io/read_materials.hpp"
#include "server/mesh_io/surface_reading.hpp"

namespace incise::mesh_io {
namespace {

using core::VertexId;

// An index of OBJ: counted from 1, or backwards from the end if negative. `what`: "vertex".
std::uint32_t obj_index(const LineReader& in, std::string_view field, const char* what, std::size_t count) {
  const std::string text(field);
  char* end = nullptr;
  const long long index = std::strtoll(text.c_str(), &end, 10);
  const auto last = static_cast<long long>(count);
  if (text.empty() || *end != '\0')
    in.fail(std::string("the ") + what + " " + in_quotes(field) + " is not an integer");
  if (index == 0 || index > last || index < -last) {
    in.fail(std::string(what) + " " + std::to_string(index) + " does not exist; there are " +
            std::to_string(last) + " so far, counted from 1");
  }
  return static_cast<std::uint32_t>(index > 0 ? index - 1 : last + index);
}

// The lines of an OBJ file. All corners of a file have texture coordinates as soon as one has; likewise normals.
class ObjReader {
 public:
  ObjReader(std::string_view text, const std::filesystem::path& path) : in_(text, path.string()) {}

  Surface read() {
    while (in_.next()) {
      const std::string_view word = in_.field(0);
      if (word == "v") {
        add_vertex();
      } else if (word == "vt") {
        uvs_.push_back({number(1, "u"), in_.size() > 2 ? number(2, "v") : 0.0f});
      } else if (word == "vn") {
        normals_.push_back({number(1, "x"), number(2, "y"), number(3, "z")});
      } else if (word == "f") {
        add_face();
      } else if (word == "usemtl") {
        use_material(rest_of_line(in_, 1));
      } else if (word == "mtllib") {
        libraries_.push_back(rest_of_line(in_, 1));
      }
    }
    if (!colours_.empty()) {
      colours_.resize(surface_.positions.size(), {255, 255, 255, 255});
      for (const auto& triangle : surface_.triangles)
        for (const VertexId v : triangle) surface_.look.colours.push_back(colours_[v]);
    }
    return std::move(surface_);
  }
  const std::vector<std::string>& libraries() const { return libraries_; }

 private:
  float number(std::size_t field, const char* what) const {
    return static_cast<float>(in_.number(field, what));
  }

  void add_vertex() {
    surface_.positions.push_back(read_point(in_, 1));
    if (surface_.positions.size() > kMaxSurfaceVertices)
      in_.fail("more than " + std::to_string(kMaxSurfaceVertices) + " vertices");
    if (in_.size() < 7) return;
    colours_.resize(surface_.positions.size(), {255, 255, 255, 255});
    for (std::size_t i = 0; i < 3; ++i) {
      const double x = std::clamp(in_.number(4 + i, "a component of the colour"), 0.0, 1.0);
      colours_.back()[i] = static_cast<std::uint8_t>(std::lround(255 * x));
    }
  }

  void add_face() {
    if (in_.size() < 4)
      in_.fail("a face of " + std::to_string(in_.size() - 1) + " corners; it has three or more");
    if (in_.size() > kMaxPolygonCorners + 1)
      in_.fail("a face of more than " + std::to_string(kMaxPolygonCorners) + " corners");
    corners_.clear();
    corner_uvs_.clear();
    corner_normals_.clear();
    bool has_uv = false, has_normal = false;
    for (std::size_t i = 1; i < in_.size(); ++i) {
      const std::string_view field = in_.field(i);
      const std::size_t first = std::min(field.find('/'), field.size());
      const std::size_t second = std::min(field.find('/', first + 1), field.size());
      corners_.push_back(obj_index(in_, field.substr(0, first), "vertex", surface_.positions.size()));
      const std::string_view uv = first < field.size() ? field.substr(first + 1, second - first - 1) : "";
      const std::string_view normal = second < field.size() ? field.substr(second + 1) : "";
      has_uv = has_uv || !uv.empty();
      has_normal = has_normal || !normal.empty();
      corner_uvs_.push_back(uv.empty() ? std::array<float, 2>{}
                                       : uvs_[obj_index(in_, uv, "texture coordinate", uvs_.size())]);
      corner_normals_.push_back(normal.empty() ? std::array<float, 3>{}
                                               : normals_[obj_index(in_, normal, "normal", normals_.size())]);
    }
    SurfaceLook& look = surface_.look;
    const std::size_t before = 3 * surface_.triangles.size();
    add_polygon(surface_, corners_);
    if (has_uv || !look.uvs.empty()) {
      look.uvs.resize(before);
      SurfaceLook::add_fan(look.uvs, corner_uvs_);
    }
    if (has_normal || !look.normals.empty()) {
      look.normals.resize(before);
      SurfaceLook::add_fan(look.normals, corner_normals_);
    }
    if (!look.materials.empty()) look.material_of.resize(surface_.triangles.size(), material_);
  }

  void use_material(const std::string& name) {
    std::vector<Material>& materials = surface_.look.materials;
    // Triangles before the first material have one without a name.
    if (materials.empty() && !surface_.triangles.empty()) {
      materials.emplace_back();
      surface_.look.material_of.resize(surface_.triangles.size(), 0);
    }
    const auto known =
        std::find_if(materials.begin(), materials.end(), [&](const Material& m) { return m.name == name; });
    material_ = static_cast<std::uint32_t>(known - materials.begin());
    if (known != materials.end()) return;
    if (materials.size() == kMaxMaterials)
      in_.fail("more than " + std::to_string(kMaxMaterials) + " materials");
    materials.emplace_back().name = name;
  }

  LineReader in_;
  Surface surface_;
  std::vector<std::array<float, 2>> uvs_, corner_uvs_;
  std::vector<std::array<float, 3>> normals_, corner_normals_;
  std::vector<std::array<std::uint8_t, 4>> colours_;  // by vertex
  std::vector<VertexId> corners_;
  std::vector<std::string> libraries_;
  std::uint32_t material_ = 0;
};

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

Surface read_obj(const std::filesystem::path& path, std::vector<std::string>& warnings) {
  std::string text = read_whole_file(path);
  // A backslash before the end of a line joins it with the next.
  for (auto i = text.find("\\\n"); i != text.npos; i = text.find("\\\n", i)) text.replace(i, 2, "  ");
  ObjReader reader(text, path);
  Surface surface = finish(reader.read(), path);
  for (const std::string& name : reader.libraries())
    read_material_library(path, name, surface.look.materials, warnings);
  return surface;
}

}  // namespace incise::mesh_io
