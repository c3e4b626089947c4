// Gmsh MSH files. Source of the layouts: the Gmsh reference manual, "MSH file format", its version 4.1 and the appendix
// on legacy formats (1 and 2).

#include <algorithm>
#include <cstdio>
#include <map>
#include <numeric>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/tet_collector.hpp"
#include "server/mesh_io/tet_files.hpp"
#include "server/mesh_io/text_file.hpp"
#include "server/mesh_io/token_reader.hpp"

namespace incise::mesh_io {
namespace {

enum class Kind { kUnknown, kSkipped, kTetrahedron, kRefused };

struct ElementType {
  Kind kind = Kind::kUnknown;
  std::size_t nodes = 0;
};

// A Gmsh element type, by number: how many nodes follow, and whether we read or skip it.
ElementType element_type(std::int64_t type) {
  static const std::map<std::int64_t, ElementType> types = [] {
    std::map<std::int64_t, ElementType> t;
    const auto add = [&t](Kind kind, std::initializer_list<std::pair<int, std::size_t>> list) {
      for (const auto& [number, nodes] : list) t[number] = {kind, nodes};
    };
    // Points, lines, triangles, quadrangles of all orders: boundaries and curves.
    add(Kind::kSkipped, {{1, 2},  {2, 3},   {3, 4},   {8, 3},   {9, 6},   {10, 9},  {15, 1}, {16, 8},
                         {20, 9}, {21, 10}, {22, 12}, {23, 15}, {24, 15}, {25, 21}, {26, 4}, {27, 5},
                         {28, 6}, {36, 16}, {37, 25}, {38, 36}, {39, 12}, {40, 16}, {41, 20}});
    add(Kind::kTetrahedron, {{4, 4}, {11, 10}, {29, 20}, {30, 35}, {31, 56}});
    // Hexahedra, prisms, pyramids.
    add(Kind::kRefused, {{5, 8},
                         {6, 6},
                         {7, 5},
                         {12, 27},
                         {13, 18},
                         {14, 14},
                         {17, 20},
                         {18, 15},
                         {19, 13},
                         {92, 64},
                         {93, 125}});
    return t;
  }();
  const auto found = types.find(type);
  return found == types.end() ? ElementType{} : found->second;
}

class GmshReader {
 public:
  GmshReader(std::string_view bytes, const std::string& file, std::vector<std::string>& warnings,
             std::vector<Field>* fields)
      : in_(bytes, file),
        out_(in_),
        warnings_(warnings),
        fields_(fields, file, warnings),
        kept_fields_(fields) {}

  core::MeshData read() {
    if (!in_.peek().starts_with('$')) {
      in_.token("'$MeshFormat' or '$NOD'");
      in_.fail("a Gmsh file starts with '$MeshFormat', or '$NOD' in its first version");
    }
    while (!in_.at_end()) read_section();
    choose_regions();
    for (auto& [on, array] : arrays_)
      fields_.add(on, std::move(array),
                  on == Field::On::kVertices ? out_.node_count() : out_.mesh().tets.size());
    drop_repeated();
    return out_.finish(warnings_,
                       skipped_ == 0 ? "" : " (" + std::to_string(skipped_) + " points, lines or faces)");
  }

 private:
  void read_section() {
    in_.set_text();
    const std::string name(in_.token("a section"));
    if (!name.starts_with('$')) in_.fail("a section such as '$Nodes' expected");
    in_.line();
    if (name == "$MeshFormat") {
      read_format();
    } else if (name == "$NOD" || name == "$Nodes") {
      if (version_ == 4) {
        start_data();
        read_nodes_4();
      } else {
        read_nodes_2();
      }
      out_.end_nodes();
    } else if (name == "$ELM") {
      read_elements_1();
    } else if (name == "$Elements") {
      if (version_ == 4) {
        start_data();
        read_elements_4();
      } else {
        read_elements_2();
      }
    } else if (name == "$Entities" && version_ == 4) {
      start_data();
      read_entities();
    } else if (fields_.wanted() && (name == "$NodeData" || name == "$ElementData")) {
      read_data(name == "$NodeData" ? Field::On::kVertices : Field::On::kTets);
    } else {
      const std::string end = "$End" + name.substr(1);
      if (!in_.skip_past(end)) in_.fail("the section " + in_quotes(name) + " has no end");
      return;
    }
    in_.set_text();
    const std::string end = (name == "$NOD" || name == "$ELM" ? "$END" : "$End") + name.substr(1);
    if (in_.token("'" + end + "'") != end)
      in_.fail("'" + end + "' expected: the section has more than it declares");
  }

  void start_data() {
    if (binary_) in_.set_binary(order_);
  }

  void read_format() {
    const double version = in_.number("the version of the format");
    if (version != 2 && version != 2.1 && version != 2.2 && version != 4.1) {
      in_.fail("version " + to_text(version) +
               " of the format; 1, 2, 2.1, 2.2 and 4.1 are accepted (gmsh FILE -save "
               "-format msh41 converts it)");
    }
    version_ = version == 4.1 ? 4 : 2;
    const std::int64_t type = in_.integer("the file's type");
    if (type != 0 && type != 1) in_.fail("the file's type is neither 0 (ASCII) nor 1 (binary)");
    binary_ = type == 1;
    if (in_.integer("the size of a number") != 8 && binary_) in_.fail("numbers not of 8 bytes");
    in_.line();
    if (!binary_) return;
    in_.set_binary(std::endian::little);
    const auto one = in_.value<std::uint32_t>("the number one, which tells the byte order");
    if (one == 0x01000000u) {
      order_ = std::endian::big;
    } else if (one != 1) {
      char found[16];
      std::snprintf(found, sizeof found, "0x%08x", one);
      in_.fail("the number after $MeshFormat must be 1, little- or big-endian; found " + std::string(found));
    }
  }

  // --- Version 1 and 2

  void read_nodes_2() {
    const std::size_t count = count_line("the number of nodes", binary_ ? 28 : 8);
    start_data();
    out_.mesh().positions.reserve(count);
    for (std::size_t i = 0; i < count; ++i) {
      const auto number = in_.value<std::int32_t>("the number of a node");
      out_.add_node(number, out_.read_position());
    }
  }

  // A count, which is text even in binary files.
  std::size_t count_line(std::string_view what, std::size_t least_bytes) {
    in_.set_text();
    const std::size_t count = in_.count(what, least_bytes);
    in_.line();
    return count;
  }

  void read_elements_1() {
    const std::size_t count = count_line("the number of elements", 10);
    for (std::size_t i = 0; i < count; ++i) {
      number_ = in_.integer("the number of an element");
      const ElementType type = known_type(in_.integer("the type of an element"));
      const std::int64_t physical = in_.integer("the physical group of an element");
      const std::int64_t volume = in_.integer("the elementary region of an element");
      const std::int64_t nodes = in_.integer("the number of nodes of an element");
      if (nodes != static_cast<std::int64_t>(type.nodes)) {
        in_.fail("an element of " + std::to_string(nodes) + " nodes; its type has " +
                 std::to_string(type.nodes));
      }
      read_element<std::int32_t>(type, physical, volume);
    }
  }

  void read_elements_2() {
    const std::size_t count = count_line("the number of elements", 8);
    start_data();
    for (std::size_t i = 0; i < count;) {
      if (!binary_) {
        number_ = in_.integer("the number of an element");
        const ElementType type = known_type(in_.integer("the type of an element"));
        read_tagged(type, in_.integer("the number of tags of an element"));
        ++i;
        continue;
      }
      const ElementType type = known_type(in_.value<std::int32_t>("the type of an element"));
      const auto block = in_.value<std::int32_t>("the number of elements in a block");
      const auto tags = in_.value<std::int32_t>("the number of tags of an element");
      if (block < 1 || static_cast<std::size_t>(block) > count - i) {
        in_.fail("a block of " + std::to_string(block) + " elements, where " + std::to_string(count - i) +
                 " are left");
      }
      for (std::int32_t k = 0; k < block; ++k, ++i) {
        number_ = in_.value<std::int32_t>("the number of an element");
        read_tagged(type, tags);
      }
    }
  }

  // The rest of an element of version 2: tags (physical group, volume, others), nodes.
  void read_tagged(const ElementType& type, std::int64_t tags) {
    if (tags < 0 || tags > 10'000) in_.fail("an element of " + std::to_string(tags) + " tags");
    std::int64_t physical = 0, volume = 0;
    for (std::int64_t k = 0; k < tags; ++k) {
      const auto tag = in_.value<std::int32_t>("a tag of an element");
      if (k == 0) physical = tag;
      if (k == 1) volume = tag;
    }
    read_element<std::int32_t>(type, physical, volume);
  }

  // --- Version 4.1

  void read_entities() {
    const std::size_t least = in_.least(10, 20);
    std::array<std::size_t, 4> counts{};
    for (std::size_t& count : counts) count = in_.count<std::uint64_t>("the number of entities", least);
    for (std::size_t dimension = 0; dimension < 4; ++dimension) {
      for (std::size_t i = 0; i < counts[dimension]; ++i) {
        const auto tag = in_.value<std::int32_t>("the number of an entity");
        for (int k = 0; k < (dimension == 0 ? 3 : 6); ++k) in_.value<double>("an entity's bounding box");
        const std::size_t groups = in_.count<std::uint64_t>("the number of physical groups", in_.least(2, 4));
        for (std::size_t k = 0; k < groups; ++k) {
          const auto group = in_.value<std::int32_t>("a physical group");
          if (dimension == 3 && k == 0) group_of_volume_[tag] = group;
        }
        if (dimension == 0) continue;
        const std::size_t bounds =
            in_.count<std::uint64_t>("the number of bounding entities", in_.least(2, 4));
        for (std::size_t k = 0; k < bounds; ++k) in_.value<std::int32_t>("a bounding entity");
      }
    }
  }

  void read_nodes_4() {
    const std::size_t blocks = in_.count<std::uint64_t>("the number of blocks of nodes", in_.least(8, 20));
    const std::size_t nodes = in_.count<std::uint64_t>("the number of nodes", in_.least(8, 32));
    for (const char* what : {"the least number of a node", "the greatest number of a node"}) {
      in_.value<std::int64_t>(what);
    }
    out_.mesh().positions.reserve(nodes);
    std::vector<std::int64_t> numbers;
    for (std::size_t i = 0; i < blocks; ++i) {
      const auto dimension = in_.value<std::int32_t>("the dimension of an entity");
      if (dimension < 0 || dimension > 3) in_.fail("an entity of dimension " + std::to_string(dimension));
      in_.value<std::int32_t>("the number of an entity");
      const bool parametric = in_.value<std::int32_t>("whether nodes have parameters") != 0;
      const std::size_t count = in_.count<std::uint64_t>("the number of nodes in a block", in_.least(8, 32));
      numbers.clear();
      for (std::size_t k = 0; k < count; ++k)
        numbers.push_back(in_.value<std::int64_t>("the number of a node"));
      for (std::size_t k = 0; k < count; ++k) {
        out_.add_node(numbers[k], out_.read_position());
        for (int p = 0; parametric && p < dimension; ++p) in_.value<double>("a parameter of a node");
      }
    }
    if (out_.node_count() != nodes) {
      in_.fail("there are " + std::to_string(out_.node_count()) +
               " nodes in the blocks; the section declares " + std::to_string(nodes));
    }
  }

  void read_elements_4() {
    const std::size_t blocks = in_.count<std::uint64_t>("the number of blocks of elements", in_.least(8, 20));
    const std::size_t elements = in_.count<std::uint64_t>("the number of elements", in_.least(4, 16));
    for (const char* what : {"the least number of an element", "the greatest number of an element"}) {
      in_.value<std::int64_t>(what);
    }
    std::size_t read = 0;
    for (std::size_t i = 0; i < blocks; ++i) {
      in_.value<std::int32_t>("the dimension of an entity");
      const auto volume = in_.value<std::int32_t>("the number of an entity");
      const ElementType type = known_type(in_.value<std::int32_t>("the type of elements"));
      const std::size_t count =
          in_.count<std::uint64_t>("the number of elements in a block", in_.least(2, 8) * (1 + type.nodes));
      const auto group = group_of_volume_.find(volume);
      const std::int64_t physical = group == group_of_volume_.end() ? 0 : group->second;
      for (std::size_t k = 0; k < count; ++k) {
        number_ = in_.value<std::int64_t>("the number of an element");
        read_element<std::int64_t>(type, physical, volume);
      }
      read += count;
    }
    if (read != elements) {
      in_.fail("there are " + std::to_string(read) + " elements in the blocks; the section declares " +
               std::to_string(elements));
    }
  }

  // --- Data: versions 2 and 4.1

  // Text tags (the name first), real tags, integer tags (time step, components, entities), then for each entity its
  // number and its values.
  void read_data(Field::On on) {
    RawArray array;
    const std::size_t texts = count_line("the number of text tags", 1);
    for (std::size_t i = 0; i < texts; ++i) {
      std::string_view text = in_.line();
      if (text.size() >= 2 && text.starts_with('"') && text.ends_with('"'))
        text = text.substr(1, text.size() - 2);
      if (i == 0) array.name = text;
    }
    const std::size_t reals = in_.count("the number of real tags", 1);
    for (std::size_t i = 0; i < reals; ++i) in_.any_number("a real tag");
    const std::size_t integers = in_.count("the number of integer tags", 1);
    std::int64_t components = 0, entities = -1;
    for (std::size_t i = 0; i < integers; ++i) {
      const std::int64_t tag = in_.integer("an integer tag");
      if (i == 1) components = tag;
      if (i == 2) entities = tag;
    }
    in_.line();
    const std::size_t least = binary_ ? 12 : 4;
    if (components < 1 || components > 1'000'000 || entities < 0 ||
        static_cast<std::size_t>(entities) > in_.remaining() / least + 1) {
      in_.fail("the data " + in_quotes(array.name) + " declare " + std::to_string(components) +
               " components for " + std::to_string(entities) +
               " entities: more than the rest of the file can hold, or none");
    }
    array.components = static_cast<std::size_t>(components);
    start_data();
    const bool keep = array.components <= core::kMaxFieldComponents;
    const std::size_t rows = on == Field::On::kVertices ? out_.node_count() : numbers_.size();
    if (keep) array.values.assign(rows * array.components, 0);
    if (keep && on == Field::On::kTets) sort_numbers();
    std::vector<bool> given(rows, false);
    for (std::int64_t i = 0; i < entities; ++i) {
      const auto number = in_.value<std::int32_t>("the number of a node or element");
      const std::size_t row = on == Field::On::kVertices ? out_.vertex(number) : row_of(number);
      for (std::size_t c = 0; c < array.components; ++c) {
        const double value = binary_ ? in_.value<double>("a value") : in_.any_number("a value");
        if (keep && row < rows) array.values[row * array.components + c] = value;
      }
      if (row < rows) given[row] = true;
    }
    const auto missing = static_cast<std::size_t>(std::count(given.begin(), given.end(), false));
    if (missing > 0) {
      fields_.leave_out(on, array.name,
                        std::to_string(missing) + " of " + std::to_string(rows) + " have no value");
    } else {
      arrays_.emplace_back(on, std::move(array));
    }
  }

  void sort_numbers() {
    sorted_numbers_.clear();
    for (std::size_t t = 0; t < numbers_.size(); ++t) sorted_numbers_.emplace_back(numbers_[t], t);
    std::sort(sorted_numbers_.begin(), sorted_numbers_.end());
  }
  // Which tetrahedron an element is; SIZE_MAX: none.
  std::size_t row_of(std::int64_t number) const {
    const auto found =
        std::lower_bound(sorted_numbers_.begin(), sorted_numbers_.end(), std::pair{number, std::size_t{0}});
    return found == sorted_numbers_.end() || found->first != number ? SIZE_MAX : found->second;
  }

  // --- All versions

  ElementType known_type(std::int64_t number) {
    const ElementType type = element_type(number);
    if (type.kind == Kind::kUnknown) in_.fail("the element type " + std::to_string(number) + " is not known");
    if (type.kind == Kind::kRefused) {
      in_.fail("an element of type " + std::to_string(number) +
               " (hexahedron, prism or pyramid); of elements of three dimensions only tetrahedra can be cut");
    }
    return type;
  }

  // The nodes of an element; T is the packed type of a node's number.
  template <class T>
  void read_element(const ElementType& type, std::int64_t physical, std::int64_t volume) {
    std::array<core::VertexId, 4> corners{};
    for (std::size_t k = 0; k < type.nodes; ++k) {
      const auto number = in_.value<T>("a node of an element");
      if (type.kind == Kind::kTetrahedron && k < 4) corners[k] = out_.vertex(number);
    }
    if (type.kind != Kind::kTetrahedron) {
      ++skipped_;
      return;
    }
    if (type.nodes > 4) out_.note_higher_order();
    out_.add_tet(corners, physical);
    volumes_.push_back(out_.checked_region(volume));
    if (fields_.wanted()) numbers_.push_back(number_);
  }

  void choose_regions() {
    std::vector<std::int32_t>& regions = out_.mesh().regions;
    const auto is_zero = [](std::int32_t r) { return r == 0; };
    if (volumes_.empty() || !std::all_of(regions.begin(), regions.end(), is_zero)) return;
    if (std::adjacent_find(volumes_.begin(), volumes_.end(), std::not_equal_to<>()) == volumes_.end()) return;
    regions = std::move(volumes_);
  }

  // MSH 2 has a tetrahedron once for each of its physical groups.
  void drop_repeated() {
    core::MeshData& mesh = out_.mesh();
    std::vector<std::uint32_t> order(mesh.tets.size());
    std::iota(order.begin(), order.end(), 0u);
    std::sort(order.begin(), order.end(), [&mesh](std::uint32_t a, std::uint32_t b) {
      return std::pair(mesh.tets[a], a) < std::pair(mesh.tets[b], b);
    });
    std::vector<bool> repeats(mesh.tets.size());
    std::size_t count = 0;
    for (std::size_t i = 1; i < order.size(); ++i) {
      if (mesh.tets[order[i]] != mesh.tets[order[i - 1]]) continue;
      repeats[order[i]] = true;
      ++count;
    }
    if (count == 0) return;
    std::size_t kept = 0;
    std::vector<std::uint32_t> rows;
    for (std::size_t t = 0; t < mesh.tets.size(); ++t) {
      if (repeats[t]) continue;
      rows.push_back(static_cast<std::uint32_t>(t));
      mesh.tets[kept] = mesh.tets[t];
      mesh.regions[kept++] = mesh.regions[t];
    }
    mesh.tets.resize(kept);
    mesh.regions.resize(kept);
    for (std::size_t f = 0; fields_.wanted() && f < kept_fields_->size(); ++f) {
      Field& field = (*kept_fields_)[f];
      if (field.on == Field::On::kTets) field = rows_of(field, rows);
    }
    warnings_.push_back(in_.file_name() + ": " + std::to_string(count) +
                        " tetrahedra are there again, for other physical groups; the first group counts");
  }

  TokenReader in_;
  TetCollector out_;
  std::vector<std::string>& warnings_;
  int version_ = 1;
  bool binary_ = false;
  std::endian order_ = std::endian::little;
  std::map<std::int32_t, std::int32_t> group_of_volume_;
  std::vector<std::int32_t> volumes_;  // of each tetrahedron
  std::size_t skipped_ = 0;
  FieldCollector fields_;
  std::vector<Field>* kept_fields_;  // what it collects
  std::vector<std::pair<Field::On, RawArray>> arrays_;
  std::int64_t number_ = 0;            // of the element that is read
  std::vector<std::int64_t> numbers_;  // of each tetrahedron, with fields
  std::vector<std::pair<std::int64_t, std::size_t>> sorted_numbers_;
};

}  // namespace

core::MeshData parse_gmsh(std::string_view bytes, const std::string& file, std::vector<std::string>& warnings,
                          std::vector<Field>* fields) {
  return GmshReader(bytes, file, warnings, fields).read();
}

}  // namespace incise::mesh_io
