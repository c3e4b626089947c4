#include "server/replay/session_view.hpp"

#include <bit>

namespace incise::replay {

protocol::Vec3 to_protocol(const core::Vec3& p) {
  return {p.x, p.y, p.z};
}

namespace {

protocol::MeshFacts mesh_facts(const std::string& name, const std::string& content_hash,
                               const core::TetMesh& mesh) {
  protocol::MeshFacts facts;
  facts.name = name.substr(0, 200);
  facts.content_hash = content_hash;
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (mesh.alive(t))
      facts.boundary_faces += static_cast<std::uint32_t>(std::popcount(mesh.boundary_mask(t)));
  }
  facts.mean_edge_length_m = mesh.mean_edge_length();
  return facts;
}

}  // namespace

protocol::MeshFacts mesh_facts(const std::string& name, const std::string& content_hash,
                               const core::MeshData& data, const core::TetMesh& mesh) {
  protocol::MeshFacts facts = mesh_facts(name, content_hash, mesh);
  facts.vertices = static_cast<std::uint32_t>(data.positions.size());
  facts.tets = static_cast<std::uint32_t>(data.tets.size());
  core::Vec3 low{1e300, 1e300, 1e300}, high{-1e300, -1e300, -1e300};
  for (const core::Vec3& p : data.positions) extend(p, low, high);
  facts.box = {to_protocol(low), to_protocol(high)};
  return facts;
}

protocol::MeshFacts mesh_facts(const std::string& name, const std::string& content_hash,
                               const core::TetMesh& loaded, const core::TetMesh& mesh) {
  protocol::MeshFacts facts = mesh_facts(name, content_hash, mesh);
  facts.vertices = loaded.vertex_slots() - loaded.initial_vertex_copies();
  facts.tets = loaded.tet_slots();
  core::Vec3 low{1e300, 1e300, 1e300}, high{-1e300, -1e300, -1e300};
  for (core::VertexId v = 0; v < loaded.vertex_slots(); ++v) extend(loaded.position(v), low, high);
  facts.box = {to_protocol(low), to_protocol(high)};
  return facts;
}

std::shared_ptr<const std::vector<core::Field>> shared_fields(const core::CarriedFields& fields) {
  return fields.all().empty() ? nullptr : std::make_shared<const std::vector<core::Field>>(fields.all());
}

stream::InitialState initial_state(const core::TetMesh& mesh, std::uint64_t session_id) {
  stream::InitialState state;
  state.epoch = session_id;
  state.positions.reserve(mesh.vertex_slots());
  for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) state.positions.push_back(mesh.position(v));
  if (mesh.deformed()) {
    state.rest.reserve(mesh.vertex_slots());
    for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) state.rest.push_back(mesh.rest_position(v));
  }
  state.tets.reserve(mesh.live_tets());
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (mesh.alive(t)) state.tets.push_back(mesh.state(t));
  }
  return state;
}

stream::InitialState initial_state(const core::CutSession& session, std::uint64_t session_id) {
  stream::InitialState state = initial_state(session.mesh(), session_id);
  state.revision = session.revision();
  for (const core::Delta::Piece& piece : session.pieces()) {
    state.piece_ids.push_back(piece.id);
    state.piece_names.push_back(piece.tet);
  }
  state.fields = shared_fields(session.fields());
  return state;
}

std::int32_t engage_button(const core::CutConfig& config) {
  return config.always_engaged ? -1 : std::countr_zero(config.engage_buttons);
}

const char* policy_name(const core::CutConfig& config) {
  return config.policy == core::Policy::kCroll ? "croll" : "conforming";
}

}  // namespace incise::replay
