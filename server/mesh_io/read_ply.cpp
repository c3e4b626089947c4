// PLY 1.0, ASCII and binary.
#include <algorithm>
#include <cmath>
#include <cstring>
#include <optional>
#include <string>

#include "server/mesh_io/mesh_error.hpp"
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
    if (count < 0 || count > static_cast<double>(kMaxPolygonCorners) || (is_corners && count < 3)) {
      body.fail("a list of " + to_text(count) + " values; 3 to " + std::to_string(kMaxPolygonCorners) +
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

}  // namespace

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

}  // namespace incise::mesh_io
