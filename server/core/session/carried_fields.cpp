#include "server/core/session/carried_fields.hpp"

#include <numeric>
#include <string>
#include <variant>

namespace incise::core {
namespace {

void archive_field(Archive& io, Field& field) {
  std::vector<char> name(field.name.begin(), field.name.end());
  io.list(name, 1, [&](char& c) { io(c); });
  io.demand(!name.empty() && name.size() <= kMaxFieldName, "a field's name is empty or too long");
  field.name.assign(name.begin(), name.end());
  io(field.on);
  io.demand(field.on <= Field::On::kTets, "a field is neither on vertices nor on tetrahedra");
  std::uint64_t components = field.components;
  io(components);
  io.demand(components >= 1 && components <= kMaxFieldComponents, "a field has a wrong number of components");
  field.components = components;
  bool whole = field.values.index() == 1;
  io(whole);
  if (io.reads() && whole) field.values.emplace<1>();
  std::visit([&](auto& values) { io.list(values, 4, [&](auto& value) { io(value); }); }, field.values);
}

// Deltas read rows by id and add some, so each must be there from the beginning.
void check_field(const Field& field, const MeshData& mesh) {
  const bool on_vertices = field.on == Field::On::kVertices;
  const std::string name = "the " + std::string(on_vertices ? "vertex" : "tetrahedron") + " field '" +
                           field.name.substr(0, kMaxFieldName) + "'";
  if (field.name.empty() || field.name.size() > kMaxFieldName) {
    throw MeshError(name + " has a name of " + std::to_string(field.name.size()) +
                    " bytes; accepted are 1 to " + std::to_string(kMaxFieldName));
  }
  if (field.components < 1 || field.components > kMaxFieldComponents) {
    throw MeshError(name + " has " + std::to_string(field.components) + " components; accepted are 1 to " +
                    std::to_string(kMaxFieldComponents));
  }
  const std::size_t rows = on_vertices ? mesh.positions.size() : mesh.tets.size();
  const std::size_t found = std::visit([](const auto& values) { return values.size(); }, field.values);
  if (found != rows * field.components) {
    throw MeshError(name + " has " + std::to_string(found) + " values; accepted are " +
                    std::to_string(rows * field.components) + ", " + std::to_string(field.components) +
                    " for each " + (on_vertices ? "vertex" : "tetrahedron"));
  }
}

}  // namespace

CarriedFields::CarriedFields(std::span<const Field> fields, const MeshData& loaded, const TetMesh& mesh)
    : fields_(fields.begin(), fields.end()) {
  for (const Field& field : fields_) check_field(field, loaded);
  if (fields_.empty() || mesh.initial_vertex_copies() == 0) return;
  // Vertices that joined parts which only touch there were copied: their rows, too.
  const auto n = static_cast<std::uint32_t>(loaded.positions.size());
  std::vector<std::uint32_t> rows(mesh.vertex_slots());
  std::iota(rows.begin(), rows.end(), 0u);
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    for (std::size_t k = 0; k < 4; ++k) {
      if (mesh.vertices(t)[k] >= n) rows[mesh.vertices(t)[k]] = loaded.tets[t][k];
    }
  }
  for (Field& field : fields_) {
    if (field.on == Field::On::kVertices) field = rows_of(field, rows);
  }
}

void CarriedFields::apply(const Delta& delta) {
  for (Field& field : fields_) {
    std::visit(
        [&](auto& values) {
          if (field.on == Field::On::kVertices) {
            carry(delta, field.components, values);
          } else {
            carry_tets(delta, field.components, values);
          }
        },
        field.values);
  }
}

std::vector<Field> exported_rows(std::span<const Field> fields, const TetMesh& mesh) {
  std::vector<Field> out;
  if (fields.empty()) return out;
  std::vector<std::uint32_t> tets, vertices;
  std::vector<bool> used(mesh.vertex_slots(), false);
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    tets.push_back(t);
    for (const VertexId v : mesh.vertices(t)) used[v] = true;
  }
  for (VertexId v = 0; v < mesh.vertex_slots(); ++v) {
    if (used[v]) vertices.push_back(v);
  }
  for (const Field& field : fields)
    out.push_back(rows_of(field, field.on == Field::On::kVertices ? vertices : tets));
  return out;
}

void CarriedFields::archive(Archive& io, const TetMesh& mesh) {
  std::size_t tets = mesh.tet_slots();
  while (tets > 0 && !mesh.alive(static_cast<TetId>(tets - 1))) --tets;
  constexpr std::size_t kLeast_bytes = 27;
  io.list(fields_, kLeast_bytes, [&](Field& field) {
    if (io.failed()) return;
    archive_field(io, field);
    const std::size_t numbers = std::visit([](const auto& v) { return v.size(); }, field.values);
    const std::size_t rows = field.components > 0 ? numbers / field.components : 0;
    const bool fits =
        field.on == Field::On::kTets ? rows >= tets && rows <= mesh.tet_slots() : rows == mesh.vertex_slots();
    io.demand(fits && rows * field.components == numbers, "a field has other rows than the mesh");
  });
  if (io.failed()) fields_.clear();
}

}  // namespace incise::core
