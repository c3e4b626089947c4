// VegaFEM's mesh files. Source of the layout: J. Barbič, F. S. Sin, D. Schroeder, "Vega FEM Library" (2012), user's
// manual, "Volumetric mesh file format".

#include <algorithm>
#include <map>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/tet_collector.hpp"
#include "server/mesh_io/tet_files.hpp"
#include "server/mesh_io/text_file.hpp"
#include "server/mesh_io/token_reader.hpp"

namespace incise::mesh_io {
namespace {

class VegaReader {
 public:
  VegaReader(std::string_view text, const std::string& file) : in_(text, file, '#'), out_(in_) {}

  core::MeshData read(std::vector<std::string>& warnings) {
    while (!in_.at_end()) {
      const std::string section(in_.token("a section"));
      if (section == "*VERTICES") {
        read_vertices();
      } else if (section == "*ELEMENTS") {
        read_elements();
      } else if (section == "*MATERIAL") {
        const std::string name(in_.token("the name of a material"));
        materials_.emplace(name, static_cast<std::int32_t>(materials_.size()));
        skip_section();
      } else if (section == "*SET") {
        read_set();
      } else if (section == "*REGION") {
        read_region();
      } else if (section == "*INCLUDE") {
        in_.fail("'*INCLUDE' is not accepted: insert the file's text here");
      } else {
        in_.fail("'*VERTICES', '*ELEMENTS', '*MATERIAL', '*SET' or '*REGION' expected, found " +
                 in_quotes(section));
      }
    }
    return out_.finish(warnings, "");
  }

 private:
  void skip_section() {
    while (!in_.at_end() && !in_.peek().starts_with('*')) in_.token("a field");
  }

  void read_vertices() {
    const std::size_t count = in_.count("the number of vertices", 8);
    if (in_.integer("the dimension") != 3) in_.fail("the dimension is not 3");
    in_.line();
    out_.mesh().positions.reserve(count);
    for (std::size_t i = 0; i < count; ++i) {
      const std::int64_t number = in_.integer("the number of vertex " + std::to_string(i + 1));
      out_.add_node(number, out_.read_position());
    }
    out_.end_nodes();
  }

  void read_elements() {
    const std::string_view kind = in_.token("the kind of elements");
    if (kind != "TET" && kind != "TETS")
      in_.fail("elements of the kind " + in_quotes(kind) + "; TET is accepted");
    const std::size_t count = in_.count("the number of elements", 10);
    if (in_.integer("the number of vertices of an element") != 4) in_.fail("a tetrahedron has 4 vertices");
    in_.line();
    out_.mesh().tets.reserve(count);
    for (std::size_t i = 0; i < count; ++i) {
      const std::int64_t number = in_.integer("the number of element " + std::to_string(i + 1));
      if (i == 0) first_element_ = number == 0 ? 0 : 1;
      if (number != first_element_ + static_cast<std::int64_t>(i)) {
        in_.fail("the element's number is " + std::to_string(number) + ", expected " +
                 std::to_string(first_element_ + static_cast<std::int64_t>(i)));
      }
      std::array<core::VertexId, 4> corners;
      for (core::VertexId& v : corners)
        v = out_.vertex(in_.integer("a vertex of element " + std::to_string(number)));
      out_.add_tet(corners, 0);
    }
  }

  void read_set() {
    std::vector<std::uint32_t>& set = sets_[std::string(in_.token("the name of a set"))];
    while (!in_.at_end() && !in_.peek().starts_with('*')) {
      const std::int64_t number = in_.integer("an element of a set");
      const auto index = static_cast<std::uint64_t>(number) - static_cast<std::uint64_t>(first_element_);
      if (index >= out_.mesh().tets.size()) {
        in_.fail("the element " + std::to_string(number) + " does not exist; there are " +
                 std::to_string(out_.mesh().tets.size()));
      }
      set.push_back(static_cast<std::uint32_t>(index));
    }
  }

  void read_region() {
    const std::string set(in_.token("the set of a region"));
    const bool all = set == "allElements" && !sets_.contains(set);
    if (!all && !sets_.contains(set)) in_.fail("there is no set " + in_quotes(set));
    const auto material = materials_.find(std::string(in_.token("the material of a region")));
    if (material == materials_.end()) in_.fail("there is no such material; *MATERIAL comes before *REGION");
    std::vector<std::int32_t>& regions = out_.mesh().regions;
    if (all) {
      std::fill(regions.begin(), regions.end(), material->second);
    } else {
      for (const std::uint32_t t : sets_[set]) regions[t] = material->second;
    }
  }

  TokenReader in_;
  TetCollector out_;
  std::int64_t first_element_ = 1;
  std::map<std::string, std::vector<std::uint32_t>> sets_;
  std::map<std::string, std::int32_t> materials_;
};

}  // namespace

core::MeshData parse_vega(std::string_view bytes, const std::string& file, std::vector<std::string>& warnings,
                          std::vector<Field>*) {
  // Replaces the commas in lists; lines keep their numbers, for messages.
  std::string text(bytes);
  std::replace(text.begin(), text.end(), ',', ' ');
  return VegaReader(text, file).read(warnings);
}

}  // namespace incise::mesh_io
