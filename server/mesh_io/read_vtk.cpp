// Legacy VTK files. Source of the layout: "VTK File Formats" (Kitware), "Simple Legacy Formats"; for versions 4 and 5.1,
// what VTK's own writer makes.

#include <algorithm>
#include <optional>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/tet_collector.hpp"
#include "server/mesh_io/tet_files.hpp"
#include "server/mesh_io/text_file.hpp"
#include "server/mesh_io/token_reader.hpp"

namespace incise::mesh_io {
namespace {

enum class Number { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kInt64, kUint64, kFloat, kDouble };

std::optional<Number> number_type(const std::string& name) {
  // vtkIdType is written with 32 bits, whatever its size in memory.
  static const std::pair<const char*, Number> types[] = {{"char", Number::kInt8},
                                                         {"signed_char", Number::kInt8},
                                                         {"unsigned_char", Number::kUint8},
                                                         {"short", Number::kInt16},
                                                         {"unsigned_short", Number::kUint16},
                                                         {"int", Number::kInt32},
                                                         {"unsigned_int", Number::kUint32},
                                                         {"vtkidtype", Number::kInt32},
                                                         {"long", Number::kInt64},
                                                         {"unsigned_long", Number::kUint64},
                                                         {"vtktypeint64", Number::kInt64},
                                                         {"vtktypeuint64", Number::kUint64},
                                                         {"float", Number::kFloat},
                                                         {"double", Number::kDouble}};
  for (const auto& [known, type] : types) {
    if (name == known) return type;
  }
  return std::nullopt;
}

std::size_t size_of(Number type) {
  switch (type) {
    case Number::kInt8:
    case Number::kUint8:
      return 1;
    case Number::kInt16:
    case Number::kUint16:
      return 2;
    case Number::kInt32:
    case Number::kUint32:
    case Number::kFloat:
      return 4;
    case Number::kInt64:
    case Number::kUint64:
    case Number::kDouble:
      return 8;
  }
  return 8;
}

// What VTK makes of blanks and others in names: %20.
std::string decoded(std::string_view name) {
  const auto digit = [](char c) {
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
                                  : -1;
  };
  std::string text;
  for (std::size_t i = 0; i < name.size(); ++i) {
    const bool is_code =
        name[i] == '%' && i + 2 < name.size() && digit(name[i + 1]) >= 0 && digit(name[i + 2]) >= 0;
    text += is_code ? static_cast<char>(16 * digit(name[i + 1]) + digit(name[i + 2])) : name[i];
    i += is_code ? 2 : 0;
  }
  return text;
}

class VtkReader {
 public:
  VtkReader(std::string_view bytes, const std::string& file, std::vector<std::string>& warnings,
            std::vector<Field>* fields)
      : in_(bytes, file), out_(in_), fields_(fields, file, warnings) {}

  core::MeshData read(std::vector<std::string>& warnings) {
    read_header();
    while (!in_.at_end()) read_section();
    add_tets();
    add_fields();
    return out_.finish(warnings,
                       skipped_ == 0 ? "" : " (" + std::to_string(skipped_) + " points, lines or faces)");
  }

 private:
  void read_header() {
    if (!in_.line().starts_with("# vtk DataFile Version"))
      in_.fail("the first line must be like '# vtk DataFile Version 3.0'");
    in_.line();  // a title
    const std::string format = lowercase(in_.token("'ASCII' or 'BINARY'"));
    if (format != "ascii" && format != "binary")
      in_.fail("'ASCII' or 'BINARY' expected, found " + in_quotes(format));
    binary_ = format == "binary";
    if (lowercase(in_.token("'DATASET'")) != "dataset") in_.fail("'DATASET' expected");
    const std::string_view kind = in_.token("the kind of data");
    if (lowercase(kind) != "unstructured_grid") {
      in_.fail("a data set of the kind " + in_quotes(kind) + "; UNSTRUCTURED_GRID is accepted" +
               (lowercase(kind) == "polydata"
                    ? ". A surface to fill can be .stl, .ply, .off, .obj or .glb: save it as one of these"
                    : ""));
    }
  }

  void read_section() {
    in_.set_text();
    const std::string_view field = in_.token("a keyword");
    const std::string word = lowercase(field);
    if (word == "points") {
      read_points();
    } else if (word == "cells") {
      read_cells();
    } else if (word == "cell_types") {
      read_types();
    } else if (word == "cell_data" || word == "point_data") {
      attributes_ = in_.count("the number of values", 1);
      of_cells_ = word == "cell_data";
      of_points_ = !of_cells_;
      if (of_cells_ && attributes_ != types_.size()) {
        in_.fail("data of " + std::to_string(attributes_) + " cells; there are " +
                 std::to_string(types_.size()));
      }
    } else if (word == "field") {
      read_field();
    } else if (word == "metadata") {
      skip_metadata();
    } else {
      read_attribute(word, field);
    }
  }

  // Runs `action` on what follows the current line: packed numbers, or text.
  template <class F>
  void data(F&& action) {
    in_.line();
    if (binary_) in_.set_binary(std::endian::big);
    action();
    in_.set_text();
  }

  Number read_type() {
    const std::string_view name = in_.token("a type of numbers");
    const auto type = number_type(lowercase(name));
    if (!type) in_.fail("the type of numbers " + in_quotes(name) + " is not known");
    return *type;
  }

  double read_number(Number type, std::string_view what) {
    if (!in_.is_binary()) return in_.number(what);
    switch (type) {
      case Number::kFloat:
        return in_.value<float>(what);
      case Number::kDouble:
        return in_.value<double>(what);
      default:
        return static_cast<double>(read_integer(type, what));
    }
  }

  std::int64_t read_integer(Number type, std::string_view what) {
    switch (type) {
      case Number::kInt8:
        return in_.value<std::int8_t>(what);
      case Number::kUint8:
        return in_.value<std::uint8_t>(what);
      case Number::kInt16:
        return in_.value<std::int16_t>(what);
      case Number::kUint16:
        return in_.value<std::uint16_t>(what);
      case Number::kInt32:
        return in_.value<std::int32_t>(what);
      case Number::kUint32:
        return in_.value<std::uint32_t>(what);
      case Number::kInt64:
        return in_.value<std::int64_t>(what);
      case Number::kUint64:
        return static_cast<std::int64_t>(in_.value<std::uint64_t>(what));
      default:
        in_.fail(std::string(what) + ": integers expected");
    }
  }

  void read_points() {
    if (out_.node_count() > 0) in_.fail("a second 'POINTS'");
    const std::size_t count = in_.count("the number of points", binary_ ? 3 : 6);
    const Number type = read_type();
    out_.mesh().positions.reserve(count);
    data([&] {
      for (std::size_t i = 0; i < count; ++i) {
        core::Vec3 p;
        p.x = read_number(type, "the coordinate x");
        p.y = read_number(type, "the coordinate y");
        p.z = read_number(type, "the coordinate z");
        if (!core::is_finite(p)) in_.fail("a coordinate of point " + std::to_string(i) + " is not finite");
        out_.add_node(static_cast<std::int64_t>(i), p);
      }
    });
    out_.end_nodes();
  }

  void read_cells() {
    if (!offsets_.empty()) in_.fail("a second 'CELLS'");
    const std::size_t count = in_.count("the number of cells", 1);
    const std::size_t size = in_.count("the size of the list of cells", binary_ ? 1 : 2);
    in_.line();
    if (lowercase(in_.peek().substr(0, 7)) == "offsets") {
      read_offsets(count, size);  // version 5: `count` is the number of offsets, one more than cells
    } else {
      read_counted_cells(count, size);
    }
  }

  // Each cell is its number of points, then the points, as 32-bit integers.
  void read_counted_cells(std::size_t count, std::size_t size) {
    if (binary_) in_.set_binary(std::endian::big);
    offsets_.reserve(count + 1);
    points_.reserve(size);
    offsets_.push_back(0);
    for (std::size_t i = 0; i < count; ++i) {
      const auto points = in_.value<std::int32_t>("the number of points of a cell");
      if (points < 0 || static_cast<std::size_t>(points) + points_.size() + i + 1 > size) {
        in_.fail("cell " + std::to_string(i) + " has " + std::to_string(points) +
                 " points: more than the size " + std::to_string(size) + " of the list leaves");
      }
      for (std::int32_t k = 0; k < points; ++k)
        points_.push_back(in_.value<std::int32_t>("a point of a cell"));
      offsets_.push_back(points_.size());
    }
    in_.set_text();
  }

  void read_offsets(std::size_t count, std::size_t size) {
    in_.token("'OFFSETS'");
    const Number offset_type = read_type();
    data([&] {
      offsets_.reserve(count);
      for (std::size_t i = 0; i < count; ++i) {
        const std::int64_t offset = read_integer(offset_type, "an offset");
        const std::int64_t least = offsets_.empty() ? 0 : static_cast<std::int64_t>(offsets_.back());
        if (offset < least || static_cast<std::uint64_t>(offset) > size || (i == 0 && offset != 0)) {
          in_.fail("the offset " + std::to_string(offset) + " of cell " + std::to_string(i) +
                   " is out of order");
        }
        offsets_.push_back(static_cast<std::size_t>(offset));
      }
    });
    if (lowercase(in_.token("'CONNECTIVITY'")) != "connectivity") in_.fail("'CONNECTIVITY' expected");
    const Number type = read_type();
    if (count > 0 && offsets_.back() != size)
      in_.fail("the last offset is not the size of the list of cells");
    data([&] {
      points_.reserve(size);
      for (std::size_t i = 0; i < size; ++i) points_.push_back(read_integer(type, "a point of a cell"));
    });
  }

  void read_types() {
    const std::size_t count = in_.count("the number of cell types", binary_ ? 4 : 2);
    if (count + 1 != std::max<std::size_t>(offsets_.size(), 1)) {
      in_.fail("types of " + std::to_string(count) + " cells; there are " +
               std::to_string(offsets_.empty() ? 0 : offsets_.size() - 1));
    }
    types_.reserve(count);
    data([&] {
      for (std::size_t i = 0; i < count; ++i) types_.push_back(in_.value<std::int32_t>("the type of a cell"));
    });
  }

  // Cell or point data of a single array, in the older form.
  void read_attribute(const std::string& word, std::string_view field) {
    struct Kind {
      const char* word;
      std::size_t components;
    };
    static const Kind kinds[] = {{"vectors", 3},    {"normals", 3},      {"tensors", 9},   {"tensors6", 6},
                                 {"global_ids", 1}, {"pedigree_ids", 1}, {"edge_flags", 1}};
    const auto name_and = [this](std::size_t components) {
      const std::string name(in_.token("the name of an array"));
      read_array(name, components, attributes_, read_type_name());
    };
    if (word == "scalars") {
      const std::string name(in_.token("the name of an array"));
      const std::string type = read_type_name();
      std::size_t components = 1;
      const std::string_view rest = in_.line();
      if (!rest.empty())
        components = rest.size() == 1 && rest[0] >= '1' && rest[0] <= '4' ? rest[0] - '0' : 0;
      if (components == 0)
        in_.fail("the number of components is " + in_quotes(rest) + "; 1 to 4 are accepted");
      if (lowercase(in_.peek()) == "lookup_table") {
        in_.line();
      }
      read_values(name, components, attributes_, type);
    } else if (word == "lookup_table") {
      in_.token("the name of a table");
      const std::size_t count = in_.count("the size of a table", 4);
      read_array("", 4, count, binary_ ? "unsigned_char" : "float");
    } else if (word == "color_scalars") {
      leave_out(in_.token("the name of an array"), "it is one of COLOR_SCALARS, which are not carried");
      const std::size_t components = in_.count("the number of components", 1);
      read_array("", components, attributes_, binary_ ? "unsigned_char" : "float");
    } else if (word == "texture_coordinates") {
      leave_out(in_.token("the name of an array"), "it is one of TEXTURE_COORDINATES, which are not carried");
      const std::size_t components = in_.count("the number of components", 1);
      read_array("", components, attributes_, read_type_name());
    } else {
      const auto kind =
          std::find_if(std::begin(kinds), std::end(kinds), [&](const Kind& k) { return word == k.word; });
      if (kind == std::end(kinds))
        in_.fail("'POINTS', 'CELLS', 'CELL_TYPES' or data expected, found " + in_quotes(field));
      name_and(kind->components);
    }
  }

  void read_field() {
    in_.token("the name of a field");
    const std::size_t arrays = in_.count("the number of arrays", 4);
    for (std::size_t i = 0; i < arrays; ++i) {
      const std::string name(in_.token("the name of an array"));
      if (lowercase(name) == "metadata") {  // of the array before
        skip_metadata();
        --i;
        continue;
      }
      const std::size_t components = in_.count("the number of components", 1);
      const std::size_t tuples = in_.count("the number of values", 1);
      read_array(name, components, tuples, read_type_name());
    }
  }

  std::string read_type_name() { return lowercase(in_.token("a type of numbers")); }

  void read_array(const std::string& name, std::size_t components, std::size_t tuples,
                  const std::string& type) {
    in_.line();
    read_values(name, components, tuples, type);
  }

  // An array of cells or points; what the file as a whole has is no field.
  void leave_out(std::string_view name, const std::string& why) {
    if (!fields_.wanted() || !(of_cells_ || of_points_)) return;
    fields_.leave_out(of_cells_ ? Field::On::kTets : Field::On::kVertices, decoded(name), why);
  }

  // As vtkDataWriter::WriteArray() writes a vtkStringArray: encoded text, one a line, or packed: the two upper bits of the first byte say how
  // many bytes the length has (3: one, 2: two, 1: four, 0: eight; big endian).
  void skip_texts(std::size_t count) {
    for (std::size_t i = 0; i < count; ++i) {
      if (in_.remaining() == 0) in_.fail("the file ends inside an array of texts");
      if (!binary_) {
        in_.line();
        continue;
      }
      const auto first = static_cast<unsigned char>(in_.take(1, "the length of a text")[0]);
      std::uint64_t length = first & 0x3fu;
      constexpr std::size_t kMore[] = {7, 3, 1, 0};
      for (const char byte : in_.take(kMore[first >> 6], "the length of a text"))
        length = length << 8 | static_cast<unsigned char>(byte);
      in_.take(length, "a text");
    }
  }

  // The values, from the start of a line; kept if they can be regions.
  void read_values(const std::string& name, std::size_t components, std::size_t tuples,
                   const std::string& type_name) {
    if (components != 0 && tuples > in_.remaining() / components * 8 + 8) {
      in_.fail(std::to_string(tuples) + " values of " + std::to_string(components) +
               " numbers: the file is too short");
    }
    const std::size_t count = components * tuples;
    if (type_name == "string" || type_name == "utf8_string") {
      leave_out(name, "it holds texts; numbers are accepted");
      return skip_texts(count);
    }
    if (type_name == "bit") {
      leave_out(name, "it holds single bits; numbers of 8 bits and more are accepted");
      if (binary_) {
        in_.take((count + 7) / 8, "an array of bits");
      } else {
        for (std::size_t i = 0; i < count; ++i) in_.token("a value");
      }
      return;
    }
    const auto type = number_type(type_name);
    if (!type)
      in_.fail("the type " + in_quotes(type_name) + " of the array " + in_quotes(name) + " is not known");
    const bool keep = of_cells_ && components == 1 && tuples == types_.size() &&
                      (name == kCutMask || find_region_array({&name, 1}) >= 0);
    const bool is_memory = name == kCutMemory && !of_cells_ && !of_points_ && components == 1;
    const bool is_field = !keep && fields_.wanted() && (of_cells_ || of_points_) && !name.empty();
    if (binary_) in_.set_binary(std::endian::big);
    if (is_field) {
      RawArray array{decoded(name), components, *type != Number::kFloat && *type != Number::kDouble, {}};
      array.values.reserve(count);
      const std::string what = "a value of the array " + in_quotes(name);
      for (std::size_t i = 0; i < count; ++i) {
        array.values.push_back(binary_ ? read_number(*type, what) : in_.any_number(what));
      }
      (of_cells_ ? of_tets_ : of_vertices_).push_back(std::move(array));
    } else if (is_memory) {
      std::vector<double> memory;
      memory.reserve(count);
      for (std::size_t i = 0; i < count; ++i)
        memory.push_back(read_number(*type, "a byte of the array " + in_quotes(name)));
      out_.note_cut_memory(memory);
    } else if (!keep) {
      if (binary_) {
        in_.take(count * size_of(*type), "the values of an array");
      } else {
        for (std::size_t i = 0; i < count; ++i) in_.token("a value");
      }
    } else {
      names_.push_back(name);
      std::vector<double>& values = arrays_.emplace_back();
      values.reserve(count);
      for (std::size_t i = 0; i < count; ++i)
        values.push_back(read_number(*type, "a value of the array " + in_quotes(name)));
    }
    in_.set_text();
  }

  void add_fields() {
    std::vector<std::uint32_t> tet_cells;
    for (std::size_t i = 0; i < types_.size(); ++i) {
      if (vtk_tet_nodes(types_[i]) > 0) tet_cells.push_back(static_cast<std::uint32_t>(i));
    }
    if (std::ranges::find(names_, kCutMask) != names_.end()) fields_.note_own_file();
    for (RawArray& array : of_vertices_)
      fields_.add(Field::On::kVertices, std::move(array), out_.node_count());
    for (RawArray& array : of_tets_)
      fields_.add(Field::On::kTets, std::move(array), types_.size(), &tet_cells);
  }

  // Skips to an empty line.
  void skip_metadata() {
    in_.line();
    while (in_.remaining() > 0 && !in_.line().empty()) {
    }
  }

  void add_tets() {
    if (offsets_.size() > 1 && types_.size() + 1 != offsets_.size()) {
      throw MeshError(in_.file_name() + ": there are cells and no 'CELL_TYPES'");
    }
    const int chosen = find_region_array(names_);
    const auto masks = static_cast<std::size_t>(std::ranges::find(names_, kCutMask) - names_.begin());
    for (std::size_t i = 0; i < types_.size(); ++i) {
      const int nodes = vtk_tet_nodes(types_[i]);
      if (nodes == 0) {
        ++skipped_;
        continue;
      }
      const std::string cell = "cell " + std::to_string(i);
      if (nodes < 0) {
        throw MeshError(in_.file_name() + ": " + cell + " is of type " + std::to_string(types_[i]) +
                        "; of cells of three dimensions only tetrahedra (10) can be cut");
      }
      const std::size_t first = offsets_[i], size = offsets_[i + 1] - first;
      if (size < static_cast<std::size_t>(nodes) || (nodes == 4 && size > 4 && types_[i] == 10)) {
        throw MeshError(in_.file_name() + ": " + cell + " has " + std::to_string(size) +
                        " points; its type has " + std::to_string(nodes));
      }
      if (types_[i] != 10) out_.note_higher_order();
      std::array<core::VertexId, 4> corners;
      for (std::size_t k = 0; k < 4; ++k) corners[k] = out_.vertex(points_[first + k]);
      out_.add_tet(corners, chosen < 0 ? 0 : to_region(arrays_[static_cast<std::size_t>(chosen)][i]));
      if (masks < names_.size() && arrays_[masks][i] != 0) out_.note_cut_faces(arrays_[masks][i]);
    }
  }

  std::int64_t to_region(double value) {
    if (!(value >= -2147483648.0 && value <= 2147483647.0))
      in_.fail("the region " + to_text(value) + " is out of range; accepted are -2147483648 to 2147483647");
    return static_cast<std::int64_t>(value);
  }

  TokenReader in_;
  TetCollector out_;
  bool binary_ = false;
  std::vector<std::size_t> offsets_;  // into points_: where each cell begins, and the end
  std::vector<std::int64_t> points_;
  std::vector<std::int64_t> types_;
  std::size_t attributes_ = 0;  // values of each array that follows
  bool of_cells_ = false, of_points_ = false;
  std::vector<std::string> names_;
  std::vector<std::vector<double>> arrays_;
  std::size_t skipped_ = 0;
  FieldCollector fields_;
  std::vector<RawArray> of_vertices_, of_tets_;
};

}  // namespace

int vtk_tet_nodes(std::int64_t type) {
  switch (type) {
    case 10:  // VTK_TETRA
      return 4;
    case 24:  // VTK_QUADRATIC_TETRA
      return 10;
    case 71:  // VTK_LAGRANGE_TETRAHEDRON
    case 78:  // VTK_BEZIER_TETRAHEDRON
      return 4;
    default:
      break;
  }
  // Vertices, lines, polygons, and their curved kinds.
  static constexpr std::int64_t kLower[] = {0,  1,  2,  3,  4,  5,  6,  7,  8,  9,  21,
                                            22, 23, 28, 30, 34, 35, 36, 51, 52, 53, 55,
                                            56, 60, 61, 62, 63, 68, 69, 70, 75, 76, 77};
  return std::find(std::begin(kLower), std::end(kLower), type) != std::end(kLower) ? 0 : -1;
}

int find_region_array(std::span<const std::string> names) {
  for (const char* wanted : {"region", "regions", "gmsh:physical", "physicalids", "materialids", "material",
                             "medit:ref", "cellentityids", "attribute"}) {
    for (std::size_t i = 0; i < names.size(); ++i) {
      if (lowercase(names[i]) == wanted) return static_cast<int>(i);
    }
  }
  return -1;
}

core::MeshData parse_vtk(std::string_view bytes, const std::string& file, std::vector<std::string>& warnings,
                         std::vector<Field>* fields) {
  return VtkReader(bytes, file, warnings, fields).read(warnings);
}

}  // namespace incise::mesh_io
