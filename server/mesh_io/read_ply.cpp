// PLY 1.0, ASCII and binary.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <optional>
#include <string>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/read_materials.hpp"
#include "server/mesh_io/surface_reading.hpp"

namespace incise::mesh_io {
namespace {

using core::Vec3;
using core::VertexId;

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

  // The fewest bytes of the file that an element takes: bounds a declared count before anything is allocated.
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

// Reads the header up to end_header; leaves `in` there. `texture`: what the comment TextureFile names.
std::vector<PlyElement> read_ply_header(LineReader& in, PlyBody::Format& format, std::string& texture) {
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
    if (word == "comment" && in.size() > 2 && in.field(1) == "TextureFile" && texture.empty())
      texture = rest_of_line(in, 2);
    if (word == "comment" || word == "obj_info") continue;
    if (word == "element") {
      if (in.size() < 3) in.fail("'element NAME COUNT' expected");
      elements.push_back(
          {std::string(in.field(1)), in.count(2, "the number of elements", kMaxSurfaceVertices), {}});
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
        in.fail("the type of the property is not char, uchar, short, ushort, int, uint, float or double");
      property.type = *type;
      property.name = in.field(list ? 4 : 2);
      elements.back().properties.push_back(std::move(property));
    } else {
      in.fail("'element', 'property', 'comment' or 'end_header' expected");
    }
  }
}

// What a property of a vertex is besides a coordinate: place i of texture coordinates, normal or colour.
enum class PlyLook { kNone, kUv, kNormal, kColour };

std::pair<PlyLook, std::size_t> ply_look(std::string_view name) {
  constexpr std::pair<std::string_view, std::pair<PlyLook, std::size_t>> kNames[] = {
      {"u", {PlyLook::kUv, 0}},         {"v", {PlyLook::kUv, 1}},         {"s", {PlyLook::kUv, 0}},
      {"t", {PlyLook::kUv, 1}},         {"texture_u", {PlyLook::kUv, 0}}, {"texture_v", {PlyLook::kUv, 1}},
      {"nx", {PlyLook::kNormal, 0}},    {"ny", {PlyLook::kNormal, 1}},    {"nz", {PlyLook::kNormal, 2}},
      {"red", {PlyLook::kColour, 0}},   {"green", {PlyLook::kColour, 1}}, {"blue", {PlyLook::kColour, 2}},
      {"alpha", {PlyLook::kColour, 3}},
  };
  for (const auto& [known, place] : kNames) {
    if (known == name) return place;
  }
  return {PlyLook::kNone, 0};
}

// The look by vertex, of a file that has it so; as the file's own corners have it beside the triangles.
struct PlyVertices {
  std::vector<std::array<float, 2>> uvs;
  std::vector<std::array<float, 3>> normals;
  std::vector<std::array<std::uint8_t, 4>> colours;
};

std::uint8_t ply_colour(double value, PlyType type) {
  if (type == PlyType::kFloat || type == PlyType::kDouble) value *= 255;  // 0 to 1
  return static_cast<std::uint8_t>(std::lround(std::clamp(value, 0.0, 255.0)));
}

void read_ply_vertex(const PlyElement& element, PlyBody& body, Surface& surface, PlyVertices& vertices) {
  Vec3 p;
  std::array<float, 2> uv{};
  std::array<float, 3> normal{};
  std::array<std::uint8_t, 4> colour{255, 255, 255, 255};
  bool has[4] = {};
  for (const PlyProperty& property : element.properties) {
    const double value = body.read(property.type);
    if (property.name == "x") p.x = value;
    if (property.name == "y") p.y = value;
    if (property.name == "z") p.z = value;
    const auto [look, i] = ply_look(property.name);
    if (look == PlyLook::kNone) continue;
    if (!std::isfinite(value)) body.fail(property.name + " is not finite");
    has[static_cast<std::size_t>(look)] = true;
    if (look == PlyLook::kUv) uv[i] = static_cast<float>(value);
    if (look == PlyLook::kNormal) normal[i] = static_cast<float>(value);
    if (look == PlyLook::kColour) colour[i] = ply_colour(value, property.type);
  }
  if (!core::is_finite(p)) body.fail("a coordinate is not finite");
  surface.positions.push_back(p);
  if (has[static_cast<std::size_t>(PlyLook::kUv)]) vertices.uvs.push_back(uv);
  if (has[static_cast<std::size_t>(PlyLook::kNormal)]) vertices.normals.push_back(normal);
  if (has[static_cast<std::size_t>(PlyLook::kColour)]) vertices.colours.push_back(colour);
}

// The values of one face's list.
void read_ply_list(const PlyProperty& property, PlyBody& body, std::vector<double>& values) {
  values.clear();
  const double count = body.read(*property.count_type);
  const bool is_corners = property.name == "vertex_indices" || property.name == "vertex_index";
  if (count < 0 || count > static_cast<double>(2 * kMaxPolygonCorners) ||
      (is_corners && (count < 3 || count > static_cast<double>(kMaxPolygonCorners)))) {
    body.fail("a list of " + to_text(count) + " values; 3 to " + std::to_string(kMaxPolygonCorners) +
              " are accepted");
  }
  for (int i = 0; i < static_cast<int>(count); ++i) values.push_back(body.read(property.type));
}

void read_ply_face(const PlyElement& element, PlyBody& body, std::size_t vertices,
                   std::vector<VertexId>& corners, Surface& surface) {
  std::vector<double> values;
  std::vector<std::array<float, 2>> uvs;
  corners.clear();
  for (const PlyProperty& property : element.properties) {
    if (!property.count_type) {
      body.read(property.type);
      continue;
    }
    read_ply_list(property, body, values);
    if (property.name == "vertex_indices" || property.name == "vertex_index") {
      for (const double index : values) {
        if (!(index >= 0 && index < static_cast<double>(vertices)) || index != std::floor(index)) {
          body.fail("vertex " + to_text(index) + " does not exist; there are " + std::to_string(vertices) +
                    ", counted from 0");
        }
        corners.push_back(static_cast<VertexId>(index));
      }
    } else if (property.name == "texcoord") {
      for (std::size_t i = 0; i + 1 < values.size(); i += 2) {
        if (!std::isfinite(values[i]) || !std::isfinite(values[i + 1]))
          body.fail("a texture coordinate is not finite");
        uvs.push_back({static_cast<float>(values[i]), static_cast<float>(values[i + 1])});
      }
    }
  }
  const std::size_t before = 3 * surface.triangles.size();
  add_polygon(surface, corners);
  if (uvs.empty() && surface.look.uvs.empty()) return;
  if (!uvs.empty() && uvs.size() != corners.size()) {
    body.fail("a list texcoord for " + std::to_string(uvs.size()) + " corners; the face has " +
              std::to_string(corners.size()));
  }
  uvs.resize(corners.size());
  surface.look.uvs.resize(before);
  SurfaceLook::add_fan(surface.look.uvs, uvs);
}

// Each corner gets what its vertex has.
template <class T>
void spread(const std::vector<T>& by_vertex, const Surface& surface, std::vector<T>& by_corner) {
  if (by_vertex.empty() || !by_corner.empty()) return;
  for (const auto& triangle : surface.triangles)
    for (const VertexId v : triangle) by_corner.push_back(by_vertex[v]);
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

}  // namespace

Surface read_ply(const std::filesystem::path& path, std::vector<std::string>& warnings) {
  const std::string bytes = read_whole_file(path);
  LineReader in(bytes, path.string(), '\0');
  PlyBody::Format format = PlyBody::Format::kAscii;
  std::string texture;
  const auto elements = read_ply_header(in, format, texture);
  check_ply_elements(elements, path.string());
  PlyBody body(in, bytes, path.string(), format);
  std::size_t vertices = 0;
  for (const PlyElement& element : elements) {
    if (element.name == "vertex") vertices = element.count;
  }
  Surface surface;
  PlyVertices looks;
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
        read_ply_vertex(element, body, surface, looks);
      } else if (element.name == "face") {
        read_ply_face(element, body, vertices, corners, surface);
      } else {
        skip_ply_element(element, body);
      }
    }
  }
  spread(looks.uvs, surface, surface.look.uvs);
  spread(looks.normals, surface, surface.look.normals);
  spread(looks.colours, surface, surface.look.colours);
  if (!texture.empty()) {
    surface.look.material_of.assign(surface.triangles.size(), 0);
    read_texture(path, texture, surface.look.materials.emplace_back(), warnings);
  }
  return finish(std::move(surface), path);
}

}  // namespace incise::mesh_io
