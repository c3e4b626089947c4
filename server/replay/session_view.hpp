#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "protocol/messages.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/stream/published_delta.hpp"

namespace incise::replay {

// What a stream needs to know of a session, in its own terms.

protocol::Vec3 to_protocol(const core::Vec3& p);
// The body as loaded, for Welcome. `mesh` is what was built from `data`. O(mesh).
protocol::MeshFacts mesh_facts(const std::string& name, const std::string& content_hash,
                               const core::MeshData& data, const core::TetMesh& mesh);
// The same of a body that is `loaded`; the mesh may have been cut since.
protocol::MeshFacts mesh_facts(const std::string& name, const std::string& content_hash,
                               const core::TetMesh& loaded, const core::TetMesh& mesh);
// The state that clients start from, of a mesh in one piece, without fields. O(mesh).
stream::InitialState initial_state(const core::TetMesh& mesh, std::uint64_t session_id);
// The same of a session as it is.
stream::InitialState initial_state(const core::CutSession& session, std::uint64_t session_id);
// Its fields, as InitialState has them. O(mesh) where there are any.
std::shared_ptr<const std::vector<core::Field>> shared_fields(const core::CarriedFields& fields);
// The button whose press engages the blade, for Welcome.
std::int32_t engage_button(const core::CutConfig& config);
// The policy's name in Welcome.
const char* policy_name(const core::CutConfig& config);

}  // namespace incise::replay
