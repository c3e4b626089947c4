#include "server/app/offline/carried_fields.hpp"

#include <numeric>
#include <variant>

#include "protocol/carry.hpp"

namespace incise::app {

using mesh_io::Field;

DeltaOrigins::DeltaOrigins(const core::Delta& delta)
    : vertex_count_(delta.first_added + static_cast<std::uint32_t>(delta.provenance.size())),
      elders_(delta.elders) {
  for (const core::Provenance& p : delta.provenance) {
    a_.push_back(p.a);
    b_.push_back(p.b);
    t_.push_back(p.t);
  }
  for (const core::Blend& blend : delta.blends) {
    blend_ids_.push_back(blend.vertex);
    blend_vertices_.insert(blend_vertices_.end(), blend.from.begin(), blend.from.end());
    blend_weights_.insert(blend_weights_.end(), blend.weights.begin(), blend.weights.end());
  }
  for (const core::TetState& tet : std::span(delta.upserted).last(delta.elders.size()))
    tet_ids_.push_back(tet.id);
}

protocol::Delta DeltaOrigins::message() const {
  protocol::Delta message;
  message.vertex_count = vertex_count_;
  message.provenance_a = a_;
  message.provenance_b = b_;
  message.provenance_t = t_;
  message.blend_ids = blend_ids_;
  message.blend_vertices = blend_vertices_;
  message.blend_weights = blend_weights_;
  message.tets.ids = tet_ids_;
  message.tet_elders = elders_;
  return message;
}

CarriedFields::CarriedFields(const mesh_io::LoadedMesh& loaded, const core::TetMesh& mesh)
    : fields_(loaded.fields) {
  if (fields_.empty() || mesh.initial_vertex_copies() == 0) return;
  // Vertices that joined parts which only touch there were copied: their rows, too.
  const auto n = static_cast<std::uint32_t>(loaded.mesh.positions.size());
  std::vector<std::uint32_t> rows(mesh.vertex_slots());
  std::iota(rows.begin(), rows.end(), 0u);
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    for (std::size_t k = 0; k < 4; ++k) {
      if (mesh.vertices(t)[k] >= n) rows[mesh.vertices(t)[k]] = loaded.mesh.tets[t][k];
    }
  }
  for (Field& field : fields_) {
    if (field.on == Field::On::kVertices) field = mesh_io::rows_of(field, rows);
  }
}

void CarriedFields::apply(const core::Delta& delta) {
  if (fields_.empty()) return;
  const DeltaOrigins origins(delta);
  const protocol::Delta message = origins.message();
  for (Field& field : fields_) {
    std::visit(
        [&](auto& values) {
          if (field.on == Field::On::kVertices) {
            protocol::carry(message, field.components, values);
          } else {
            protocol::carry_tets(message, field.components, values);
          }
        },
        field.values);
  }
}

std::vector<Field> CarriedFields::exported(const core::TetMesh& mesh) const {
  std::vector<Field> out;
  if (fields_.empty()) return out;
  std::vector<std::uint32_t> tets, vertices;
  std::vector<bool> used(mesh.vertex_slots(), false);
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    tets.push_back(t);
    for (const core::VertexId v : mesh.vertices(t)) used[v] = true;
  }
  for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) {
    if (used[v]) vertices.push_back(v);
  }
  for (const Field& field : fields_)
    out.push_back(mesh_io::rows_of(field, field.on == Field::On::kVertices ? vertices : tets));
  return out;
}

}  // namespace incise::app
