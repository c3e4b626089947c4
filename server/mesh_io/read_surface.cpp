#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <numeric>
#include <optional>
#include <tuple>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/surface_files.hpp"
#include "server/mesh_io/text_file.hpp"

namespace incise::mesh_io {
namespace {

using core::Vec3;
using core::VertexId;

constexpr std::size_t kMaxVertices = std::size_t{1} << 30;
// A polygon of more corners than this is a mistake, not a face.
constexpr std::size_t kMaxCorners = 10'000;

// A fan around the first corner: right for convex polygons, and the checks that follow find the others.
void add_polygon(Surface& surface, const std::vector<VertexId>& corners) {
  for (std::size_t i = 2; i < corners.size(); ++i) {
    surface.triangles.push_back({corners[0], corners[i - 1], corners[i]});
  }
}

// Vertices at exactly one place become the first of them; unused ones are dropped.
void weld(Surface& surface) {
  const auto& p = surface.positions;
  std::vector<VertexId> order(p.size()), canonical(p.size());
  std::iota(order.begin(), order.end(), VertexId{0});
  std::sort(order.begin(), order.end(), [&p](VertexId a, VertexId b) {
    return std::tie(p[a].x, p[a].y, p[a].z, a) < std::tie(p[b].x, p[b].y, p[b].z, b);
  });
  for (std::size_t i = 0; i < order.size(); ++i) {
    canonical[order[i]] = i > 0 && p[order[i]] == p[order[i - 1]] ? canonical[order[i - 1]] : order[i];
  }
  std::vector<VertexId> renumbered(p.size(), core::kNone);
  for (const auto& triangle : surface.triangles) {
    for (const VertexId v : triangle) renumbered[canonical[v]] = 0;
  }
  std::vector<Vec3> kept;
  for (std::size_t v = 0; v < p.size(); ++v) {
    if (renumbered[v] == core::kNone) continue;
    renumbered[v] = static_cast<VertexId>(kept.size());
    kept.push_back(p[v]);
  }
  for (auto& triangle : surface.triangles) {
    for (VertexId& v : triangle) v = renumbered[canonical[v]];
  }
  surface.positions = std::move(kept);
}

Surface finish(Surface surface, const std::filesystem::path& path) {
  if (surface.triangles.empty()) throw MeshError(path.string() + ": there is no triangle");
  weld(surface);
  return surface;
}

bool equals_ignoring_case(std::string_view field, std::string_view lowercase) {
  return std::equal(field.begin(), field.end(), lowercase.begin(), lowercase.end(),
                    [](char a, char b) { return (a >= 'A' && a <= 'Z' ? a + 32 : a) == b; });
}

Vec3 read_point(const LineReader& in, std::size_t first) {
  return {in.number(first, "the coordinate x"), in.number(first + 1, "the coordinate y"),
          in.number(first + 2, "the coordinate z")};
}

// ---------------------------------------------------------------------------------------------------- STL

template <class T>
T load(const char* bytes) {
  T value;
  std::memcpy(&value, bytes, sizeof value);
  return value;
}

constexpr std::size_t kStlHeader = 84, kStlTriangle = 50;

Surface read_binary_stl(const std::string& bytes, std::size_t count, const std::string& file) {
  Surface surface;
  surface.positions.reserve(3 * count);
  for (std::size_t i = 0; i < count; ++i) {
    for (std::size_t k = 0; k < 3; ++k) {
      const char* corner = bytes.data() + kStlHeader + kStlTriangle * i + 12 * (k + 1);
      const Vec3 p{load<float>(corner), load<float>(corner + 4), load<float>(corner + 8)};
      if (!core::is_finite(p)) {
        throw MeshError(file + ": triangle " + std::to_string(i) + ", corner " + std::to_string(k) +
                        ": a coordinate is not finite");
      }
      surface.positions.push_back(p);
    }
    const auto v = static_cast<VertexId>(3 * i);
    surface.triangles.push_back({v, v + 1, v + 2});
  }
  return surface;
}

Surface read_ascii_stl(const std::string& text, const std::string& file) {
  LineReader in(text, file, '\0');
  Surface surface;
  int corners = -1;  // of the loop that is open; -1: none is
  bool in_solid = false;
  while (in.next()) {
    const std::string_view word = in.field(0);
    if (equals_ignoring_case(word, "vertex")) {
      if (corners < 0) in.fail("'vertex' outside of 'outer loop'");
      if (corners == 3) in.fail("a fourth vertex in a facet; STL has triangles only");
      surface.positions.push_back(read_point(in, 1));
      ++corners;
    } else if (equals_ignoring_case(word, "outer")) {
      if (corners >= 0) in.fail("'outer loop' inside of another");
      corners = 0;
    } else if (equals_ignoring_case(word, "endloop")) {
      if (corners != 3)
        in.fail("a facet of " + std::to_string(std::max(corners, 0)) + " vertices; it has three");
      const auto v = static_cast<VertexId>(surface.positions.size());
      surface.triangles.push_back({v - 3, v - 2, v - 1});
      corners = -1;
    } else if (equals_ignoring_case(word, "solid")) {
      in_solid = true;
    } else if (equals_ignoring_case(word, "endsolid")) {
      in_solid = false;
    } else if (!equals_ignoring_case(word, "facet") && !equals_ignoring_case(word, "endfacet")) {
      in.fail("'solid', 'facet', 'outer loop', 'vertex', 'endloop', 'endfacet' or 'endsolid' expected");
    }
  }
  if (corners >= 0 || in_solid) {
    throw MeshError(file + ": ends after line " + std::to_string(in.line()) +
                    " without 'endsolid': the file is cut short");
  }
  return surface;
}

// ---------------------------------------------------------------------------------------------------- PLY

enum class PlyType { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat, kDouble };

std::optional<PlyType> ply_type(std::string_view name) {
  if (name == "char" || name == "int8") return PlyType::kInt8;
  if (name == "uchar" || name == "uint8") return PlyType::kUint8;
  if (name == "short" || name == "int16") return PlyType::kInt16;
  if (name == "ushort" || name == "uint16") return PlyType::kUint16;
  if (name == "int" || name == "int32") return PlyType::kInt32;
  if (name == "uint" || name == "uint32") return PlyType::kUint32;
  if (name == "float" || name == "float32") return PlyType::kFloat;
  if (name == "double" || name == "float64") return PlyType::kDouble;
  return std::nullopt;
}

std::size_t size_of(PlyType type) {
  switch (type) {
    case PlyType::kInt8:
    case PlyType::kUint8:
      return 1;
    case PlyType::kInt16:
    case PlyType::kUint16:
      return 2;
    case PlyType::kInt32:
    case PlyType::kUint32:
    case PlyType::kFloat:
      return 4;
    case PlyType::kDouble:
      return 8;
  }
  return 0;
}

struct PlyProperty {
  std::string name;
  PlyType type = PlyType::kFloat;
  std::optional<PlyType> count_type;  // of a list
};

struct PlyElement {
  std::string name;
  std::size_t count = 0;
  std::vector<PlyProperty> properties;
};

// The values of one PLY body, in order: fields of text lines, or packed numbers of either byte order.
class PlyBody {
 public:
  enum class Format { kAscii, kLittle, kBig };

  PlyBody(LineReader& in, const std::string& bytes, std::string file, Format format)
      : in_(in), file_(std::move(file)), bytes_(bytes), position_(in.position()), format_(format) {}

  // What an element takes at least, in bytes of the file: caps a declared count before anything is allocated.
  std::size_t least_size(const PlyElement& element) const {
    std::size_t size = 0;
    for (const PlyProperty& property : element.properties) {
      size += format_ == Format::kAscii ? 2 : size_of(property.count_type.value_or(property.type));
    }
    return size;
  }
  std::size_t remaining() const {
    return format_ == Format::kAscii ? in_.remaining() + 1 : bytes_.size() - position_;
  }

  void begin_element(const std::string& name, std::size_t index) {
    where_ = name + " " + std::to_string(index);
    if (format_ != Format::kAscii) return;
    in_.require(where_);
    field_ = 0;
  }

  double read(PlyType type) {
    if (format_ == Format::kAscii) {
      return type == PlyType::kFloat || type == PlyType::kDouble
                 ? in_.number(field_++, "a value of " + where_)
                 : static_cast<double>(in_.integer(field_++, "a value of " + where_));
    }
    const std::size_t size = size_of(type);
    if (remaining() < size) throw MeshError(file_ + ": ends inside " + where_ + ": the file is cut short");
    char raw[8];
    std::memcpy(raw, bytes_.data() + position_, size);
    position_ += size;
    if (format_ == Format::kBig) std::reverse(raw, raw + size);
    switch (type) {
      case PlyType::kInt8:
        return load<std::int8_t>(raw);
      case PlyType::kUint8:
        return load<std::uint8_t>(raw);
      case PlyType::kInt16:
        return load<std::int16_t>(raw);
      case PlyType::kUint16:
        return load<std::uint16_t>(raw);
      case PlyType::kInt32:
        return load<std::int32_t>(raw);
      case PlyType::kUint32:
        return load<std::uint32_t>(raw);
      case PlyType::kFloat:
        return static_cast<double>(load<float>(raw));
      case PlyType::kDouble:
        return load<double>(raw);
    }
    return 0;
  }

  [[noreturn]] void fail(const std::string& message) const {
    if (format_ == Format::kAscii) in_.fail(where_ + ": " + message);
    throw MeshError(file_ + ": " + where_ + ": " + message);
  }

 private:
  LineReader& in_;
  std::string file_;
  const std::string& bytes_;
  std::size_t position_;
  Format format_;
  std::size_t field_ = 0;
  std::string where_;
};

// Reads the header up to end_header; leaves `in` there.
std::vector<PlyElement> read_ply_header(LineReader& in, PlyBody::Format& format) {
  in.require("'ply'");
  if (in.size() != 1 || in.field(0) != "ply") in.fail("a PLY file starts with the line 'ply'");
  in.require("'format'");
  if (in.size() < 3 || in.field(0) != "format") in.fail("the second line is 'format KIND 1.0'");
  if (in.field(1) == "ascii") {
    format = PlyBody::Format::kAscii;
  } else if (in.field(1) == "binary_little_endian") {
    format = PlyBody::Format::kLittle;
  } else if (in.field(1) == "binary_big_endian") {
    format = PlyBody::Format::kBig;
  } else {
    in.fail("the format is none of ascii, binary_little_endian and binary_big_endian");
  }
  std::vector<PlyElement> elements;
  while (true) {
    in.require("'end_header'");
    const std::string_view word = in.field(0);
    if (word == "end_header") return elements;
    if (word == "comment" || word == "obj_info") continue;
    if (word == "element") {
      if (in.size() < 3) in.fail("'element NAME COUNT' expected");
      elements.push_back({std::string(in.field(1)), in.count(2, "the number of elements", kMaxVertices), {}});
    } else if (word == "property") {
      if (elements.empty()) in.fail("a property before the first element");
      PlyProperty property;
      const bool list = in.size() > 1 && in.field(1) == "list";
      if (in.size() < (list ? 5u : 3u))
        in.fail("'property TYPE NAME' or 'property list TYPE TYPE NAME' expected");
      if (list) {
        property.count_type = ply_type(in.field(2));
        if (!property.count_type || *property.count_type >= PlyType::kFloat)
          in.fail("a list is counted in integers");
      }
      const auto type = ply_type(in.field(list ? 3 : 1));
      if (!type)
        in.fail(
            "the type of the property is none of char, uchar, short, ushort, int, uint, float and double");
      property.type = *type;
      property.name = in.field(list ? 4 : 2);
      elements.back().properties.push_back(std::move(property));
    } else {
      in.fail("'element', 'property', 'comment' or 'end_header' expected");
    }
  }
}

void read_ply_vertex(const PlyElement& element, PlyBody& body, Surface& surface) {
  Vec3 p;
  for (const PlyProperty& property : element.properties) {
    const double value = body.read(property.type);
    if (property.name == "x") p.x = value;
    if (property.name == "y") p.y = value;
    if (property.name == "z") p.z = value;
  }
  if (!core::is_finite(p)) body.fail("a coordinate is not finite");
  surface.positions.push_back(p);
}

void read_ply_face(const PlyElement& element, PlyBody& body, std::size_t vertices,
                   std::vector<VertexId>& corners, Surface& surface) {
  for (const PlyProperty& property : element.properties) {
    if (!property.count_type) {
      body.read(property.type);
      continue;
    }
    const double count = body.read(*property.count_type);
    const bool is_corners = property.name == "vertex_indices" || property.name == "vertex_index";
    if (count < 0 || count > static_cast<double>(kMaxCorners) || (is_corners && count < 3)) {
      body.fail("a list of " + to_text(count) + " values; 3 to " + std::to_string(kMaxCorners) +
                " are accepted");
    }
    if (is_corners) corners.clear();
    for (int i = 0; i < static_cast<int>(count); ++i) {
      const double index = body.read(property.type);
      if (!is_corners) continue;
      if (!(index >= 0 && index < static_cast<double>(vertices)) || index != std::floor(index)) {
        body.fail("vertex " + to_text(index) + " does not exist; there are " + std::to_string(vertices) +
                  ", counted from 0");
      }
      corners.push_back(static_cast<VertexId>(index));
    }
    if (is_corners) add_polygon(surface, corners);
  }
}

void check_ply_elements(const std::vector<PlyElement>& elements, const std::string& file) {
  const auto find = [&elements](std::string_view name) {
    return std::find_if(elements.begin(), elements.end(),
                        [name](const PlyElement& e) { return e.name == name; });
  };
  const auto vertex = find("vertex"), face = find("face");
  if (vertex == elements.end() || face == elements.end()) {
    throw MeshError(file + ": the header has no element '" + (vertex == elements.end() ? "vertex" : "face") +
                    "'");
  }
  for (const char* axis : {"x", "y", "z"}) {
    if (std::none_of(vertex->properties.begin(), vertex->properties.end(),
                     [axis](const PlyProperty& p) { return p.name == axis && !p.count_type; })) {
      throw MeshError(file + ": the element 'vertex' has no property '" + axis + "'");
    }
  }
  if (std::any_of(vertex->properties.begin(), vertex->properties.end(),
                  [](const PlyProperty& p) { return p.count_type.has_value(); })) {
    throw MeshError(file + ": the element 'vertex' has a list property, which is not supported");
  }
  if (std::none_of(face->properties.begin(), face->properties.end(), [](const PlyProperty& p) {
        return p.count_type && p.type < PlyType::kFloat &&
               (p.name == "vertex_indices" || p.name == "vertex_index");
      })) {
    throw MeshError(file + ": the element 'face' has no list of integers 'vertex_indices' or 'vertex_index'");
  }
}

void skip_ply_element(const PlyElement& element, PlyBody& body) {
  for (const PlyProperty& property : element.properties) {
    double count = 1;
    if (property.count_type) count = body.read(*property.count_type);
    if (count < 0) body.fail("a list of " + to_text(count) + " values");
    for (double i = 0; i < count; ++i) body.read(property.type);
  }
}

// ---------------------------------------------------------------------------------------------------- OBJ

// The vertex that the first part of "v", "v/vt", "v/vt/vn" or "v//vn" names: from 1, or from the end if
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

Surface read_stl(const std::filesystem::path& path, std::vector<std::string>& warnings) {
  const std::string bytes = read_whole_file(path);
  const std::string file = path.string();
  // Many binary files begin with "solid" too, so the size decides first.
  const std::size_t count = bytes.size() >= kStlHeader ? load<std::uint32_t>(bytes.data() + 80) : 0;
  const bool binary_size = bytes.size() >= kStlHeader && bytes.size() == kStlHeader + kStlTriangle * count;
  if (binary_size) return finish(read_binary_stl(bytes, count, file), path);
  const std::size_t begin = bytes.find_first_not_of(" \t\r\n");
  if (begin != std::string::npos && equals_ignoring_case(std::string_view(bytes).substr(begin, 5), "solid") &&
      bytes.find('\0') == std::string::npos) {
    return finish(read_ascii_stl(bytes, file), path);
  }
  if (bytes.size() < kStlHeader || bytes.size() < kStlHeader + kStlTriangle * count) {
    throw MeshError(file + ": neither ASCII STL (it does not start with 'solid') nor binary STL (" +
                    (bytes.size() < kStlHeader
                         ? "shorter than its header of 84 bytes)"
                         : std::to_string(count) + " triangles take " +
                               std::to_string(kStlHeader + kStlTriangle * count) + " bytes, the file has " +
                               std::to_string(bytes.size()) + ")"));
  }
  warnings.push_back(file + ": " + std::to_string(bytes.size() - kStlHeader - kStlTriangle * count) +
                     " bytes after the last of " + std::to_string(count) + " triangles are not read");
  return finish(read_binary_stl(bytes, count, file), path);
}

Surface read_ply(const std::filesystem::path& path) {
  const std::string bytes = read_whole_file(path);
  LineReader in(bytes, path.string(), '\0');
  PlyBody::Format format = PlyBody::Format::kAscii;
  const auto elements = read_ply_header(in, format);
  check_ply_elements(elements, path.string());
  PlyBody body(in, bytes, path.string(), format);
  std::size_t vertices = 0;
  for (const PlyElement& element : elements) {
    if (element.name == "vertex") vertices = element.count;
  }
  Surface surface;
  std::vector<VertexId> corners;
  for (const PlyElement& element : elements) {
    const std::size_t least = body.least_size(element);
    if (element.count > 0 && (least == 0 || element.count > body.remaining() / least)) {
      throw MeshError(path.string() + ": the header declares " + std::to_string(element.count) +
                      " of element '" + element.name + "', more than the " +
                      std::to_string(body.remaining()) +
                      " bytes that follow can hold: the file is cut short");
    }
    if (element.name == "vertex") surface.positions.reserve(element.count);
    for (std::size_t i = 0; i < element.count; ++i) {
      body.begin_element(element.name, i);
      if (element.name == "vertex") {
        read_ply_vertex(element, body, surface);
      } else if (element.name == "face") {
        read_ply_face(element, body, vertices, corners, surface);
      } else {
        skip_ply_element(element, body);
      }
    }
  }
  return finish(std::move(surface), path);
}

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
  // "0 0 0" and its end of line; "3 0 1 2" and its.
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
    const std::size_t count = in.count(0, "the number of corners", kMaxCorners);
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
      if (surface.positions.size() > kMaxVertices)
        in.fail("more than " + std::to_string(kMaxVertices) + " vertices");
    } else if (in.field(0) == "f") {
      if (in.size() < 4)
        in.fail("a face of " + std::to_string(in.size() - 1) + " corners; it has three or more");
      if (in.size() > kMaxCorners + 1)
        in.fail("a face of more than " + std::to_string(kMaxCorners) + " corners");
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
