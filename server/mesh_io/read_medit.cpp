// Medit's ASCII mesh files. Source of the layout: P. Frey, "MEDIT: an interactive mesh visualization software" (INRIA
// RT-0253, 2001), the appendix on file formats.

#include <algorithm>
#include <utility>

#include "server/mesh_io/mesh_error.hpp"
#include "server/mesh_io/tet_collector.hpp"
#include "server/mesh_io/tet_files.hpp"
#include "server/mesh_io/text_file.hpp"
#include "server/mesh_io/token_reader.hpp"

namespace incise::mesh_io {
namespace {

bool is_keyword(std::string_view field) {
  return !field.empty() && ((field[0] >= 'A' && field[0] <= 'Z') || (field[0] >= 'a' && field[0] <= 'z'));
}

// To the next section.
void skip_numbers(TokenReader& in) {
  while (!in.at_end() && !is_keyword(in.peek())) in.token("a number");
}

void read_tetrahedra(TokenReader& in, TetCollector& out) {
  const std::size_t count = in.count("the number of tetrahedra", 10);
  out.mesh().tets.reserve(count);
  out.mesh().regions.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    std::array<core::VertexId, 4> corners;
    for (core::VertexId& v : corners)
      v = out.vertex(in.integer("a vertex of tetrahedron " + std::to_string(i + 1)));
    out.add_tet(corners, in.integer("the reference of tetrahedron " + std::to_string(i + 1)));
  }
}

}  // namespace

core::MeshData parse_medit(std::string_view bytes, const std::string& file,
                           std::vector<std::string>& warnings, std::vector<Field>* fields) {
  FieldCollector collected(fields, file, warnings);
  RawArray references{"medit:ref", 1, true, {}};
  TokenReader in(bytes, file, '#');
  TetCollector out(in);
  if (in.token("'MeshVersionFormatted'") != "MeshVersionFormatted") {
    in.fail("a Medit file in ASCII starts with 'MeshVersionFormatted'");
  }
  in.integer("the version");
  // Sections may come in any order, but only known vertices can be looked up.
  std::vector<TokenReader> tets_before_vertices;
  while (!in.at_end()) {
    const std::string_view word = in.token("a keyword");
    if (word == "End") break;
    if (word == "Dimension") {
      if (in.integer("the dimension") != 3) in.fail("the dimension is not 3");
    } else if (word == "Vertices") {
      const std::size_t count = in.count("the number of vertices", 8);
      out.mesh().positions.reserve(count);
      for (std::size_t i = 0; i < count; ++i) {
        out.add_node(static_cast<std::int64_t>(out.node_count()) + 1, out.read_position());
        const double reference = in.number("the reference of a vertex");
        if (collected.wanted()) references.values.push_back(reference);
      }
      out.end_nodes();
    } else if (word == "Tetrahedra") {
      if (out.node_count() > 0) {
        read_tetrahedra(in, out);
      } else {
        tets_before_vertices.push_back(in);
        skip_numbers(in);
      }
    } else if (word == "Hexahedra" || word == "Prisms" || word == "Pyramids" ||
               word.starts_with("TetrahedraP")) {
      if (in.integer("the number of elements") > 0) {
        in.fail("elements of the kind " + in_quotes(word) +
                "; of elements of three dimensions only tetrahedra can be cut");
      }
    } else if (is_keyword(word)) {
      skip_numbers(in);
    } else {
      in.fail("a keyword such as 'Vertices' expected, found " + in_quotes(word) +
              ": the section before it has more than it declares");
    }
  }
  for (const TokenReader& section : tets_before_vertices) {
    in = section;
    read_tetrahedra(in, out);
  }
  if (std::any_of(references.values.begin(), references.values.end(), [](double r) { return r != 0; }))
    collected.add(Field::On::kVertices, std::move(references), out.node_count());
  return out.finish(warnings, "");
}

}  // namespace incise::mesh_io
