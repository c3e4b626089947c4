#include "server/app/stream_setup.hpp"

#include <sys/random.h>

#include <bit>

#include "server/app/token_file.hpp"
#include "server/base/clock.hpp"

namespace incise::app {
namespace {

protocol::Vec3 to_protocol(const core::Vec3& p) {
  return {p.x, p.y, p.z};
}

// The viewer that ./dev build puts beside the programs; empty where it was not built.
std::string built_viewer() {
  std::error_code error;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", error);
  const std::filesystem::path viewer = program.parent_path().parent_path() / "viewer";
  return !error && std::filesystem::exists(viewer / "index.html", error) ? viewer.string() : std::string();
}

}  // namespace

stream::StreamConfig stream_config(const Config& config) {
  const Config::Listen& listen = config.listen;
  stream::StreamConfig made;
  made.address = listen.address;
  made.tcp_port = static_cast<int>(listen.tcp_port);
  made.http_port = static_cast<int>(listen.http_port);
  made.viewer_directory =
      listen.viewer_directory.empty() ? built_viewer() : config.resolve(listen.viewer_directory).string();
  made.allowed_origins = listen.allowed_origins;
  if (!listen.token_file.empty()) made.tokens = read_tokens(config.resolve(listen.token_file));
  made.certificate_file = config.resolve(listen.certificate_file).string();
  made.private_key_file = config.resolve(listen.private_key_file).string();
  made.insecure = listen.insecure;
  made.max_sessions = static_cast<std::uint32_t>(listen.max_sessions);
  made.max_handshakes = static_cast<std::uint32_t>(listen.max_handshakes);
  made.handshake_timeout_s = listen.handshake_timeout_s;
  made.idle_timeout_s = listen.idle_timeout_s;
  made.write_timeout_s = listen.write_timeout_s;
  made.stop_grace_s = listen.stop_grace_s;
  made.max_messages_per_s = static_cast<std::uint32_t>(listen.max_messages_per_s);
  made.outbox_bytes = static_cast<std::size_t>(config.stream.outbox_bytes);
  made.max_slow_snapshots = static_cast<std::uint32_t>(config.stream.max_slow_snapshots);
  made.ring_bytes = static_cast<std::size_t>(config.stream.ring_bytes);
  made.max_report_rate_hz = config.stream.max_report_rate_hz;
  return made;
}

stream::ServerFacts server_facts(const Config& config, const Body& body, const core::TetMesh& mesh) {
  stream::ServerFacts facts;
  facts.mesh.name = body.name.substr(0, 200);
  facts.mesh.content_hash = body.loaded.content_hash;
  facts.mesh.vertices = static_cast<std::uint32_t>(body.loaded.mesh.positions.size());
  facts.mesh.tets = static_cast<std::uint32_t>(body.loaded.mesh.tets.size());
  core::Vec3 low{1e300, 1e300, 1e300}, high{-1e300, -1e300, -1e300};
  for (const core::Vec3& p : body.loaded.mesh.positions) {
    extend(p, low, high);
  }
  facts.mesh.box = {to_protocol(low), to_protocol(high)};
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (mesh.alive(t))
      facts.mesh.boundary_faces += static_cast<std::uint32_t>(std::popcount(mesh.boundary_mask(t)));
  }
  facts.mesh.mean_edge_length_m = mesh.mean_edge_length();
  facts.blade_heel = to_protocol(config.cut.blade.heel);
  facts.blade_tip = to_protocol(config.cut.blade.tip);
  facts.engage_button = config.cut.always_engaged ? -1 : std::countr_zero(config.cut.engage_buttons);
  facts.max_speed_m_s = config.cut.speed_limit_m_s;
  facts.frame_rate_hz = config.loop.rate_hz;
  facts.policy = config.cut.policy == core::Policy::kCroll ? "croll" : "conforming";
  return facts;
}

stream::InitialState initial_state(const core::CutSession& session, std::uint64_t session_id) {
  const core::TetMesh& mesh = session.mesh();
  stream::InitialState state;
  state.epoch = session_id;
  state.revision = session.revision();
  state.positions.reserve(mesh.vertex_slots());
  for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) state.positions.push_back(mesh.position(v));
  if (mesh.deformed()) {
    state.rest.reserve(mesh.vertex_slots());
    for (core::VertexId v = 0; v < mesh.vertex_slots(); ++v) state.rest.push_back(mesh.rest_position(v));
  }
  state.tets.reserve(mesh.live_tets());
  state.pieces.reserve(mesh.live_tets());
  for (core::TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    state.tets.push_back(mesh.state(t));
    state.pieces.push_back(mesh.piece(t));
  }
  return state;
}

std::uint64_t fresh_session_id() {
  std::uint64_t id = 0;
  while (id == 0) {
    if (getrandom(&id, sizeof id, 0) != sizeof id) id = static_cast<std::uint64_t>(monotonic_ns());
  }
  return id;
}

}  // namespace incise::app
