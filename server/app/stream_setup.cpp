#include "server/app/stream_setup.hpp"

#include <sys/random.h>
#include <sys/resource.h>

#include <utility>

#include "server/app/token_file.hpp"
#include "server/base/clock.hpp"
#include "server/replay/session_view.hpp"

namespace incise::app {
namespace {

// The viewer that ./dev build puts beside the programs, or the installed one; empty where there is none.
std::string built_viewer() {
  std::error_code error;
  const std::filesystem::path program = std::filesystem::read_symlink("/proc/self/exe", error);
  if (error) return {};
  for (const char* place : {"viewer", "share/incise/viewer"}) {
    const std::filesystem::path viewer = program.parent_path().parent_path() / place;
    if (std::filesystem::exists(viewer / "index.html", error)) return viewer.string();
  }
  return {};
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

// Where that fails, clients beyond the limit wait until others leave.
void raise_descriptor_limit() {
  rlimit limit{};
  if (getrlimit(RLIMIT_NOFILE, &limit) != 0) return;
  limit.rlim_cur = limit.rlim_max;
  setrlimit(RLIMIT_NOFILE, &limit);
}

std::shared_ptr<const stream::Mirror> mirror_of(stream::InitialState state,
                                                std::shared_ptr<const protocol::OriginTree> origins) {
  state.origins = std::move(origins);
  auto mirror = std::make_shared<stream::Mirror>();
  mirror->reset(state);
  return mirror;
}

std::shared_ptr<const stream::Mirror> mirror_of(const core::CutSession& session,
                                                std::shared_ptr<const protocol::OriginTree> origins) {
  return mirror_of(replay::initial_state(session, fresh_session_id()), std::move(origins));
}

std::shared_ptr<stream::InitialState> shown_again(std::shared_ptr<const stream::Mirror> mirror,
                                                  std::shared_ptr<const std::vector<core::Field>> fields) {
  auto shown = std::make_shared<stream::InitialState>();
  shown->epoch = fresh_session_id();
  shown->mirror = std::move(mirror);
  shown->fields = std::move(fields);
  return shown;
}

stream::ServerFacts server_facts(const Config& config, const Body& body, const core::TetMesh& mesh) {
  stream::ServerFacts facts;
  const std::string& hash = body.loaded.content_hash;
  facts.mesh = body.built ? replay::mesh_facts(body.name, hash, body.built->mesh(), mesh)
                          : replay::mesh_facts(body.name, hash, body.loaded.mesh, mesh);
  facts.blade_heel = replay::to_protocol(config.cut.blade.heel);
  facts.blade_tip = replay::to_protocol(config.cut.blade.tip);
  facts.engage_button = replay::engage_button(config.cut);
  facts.max_speed_m_s = config.cut.speed_limit_m_s;
  facts.frame_rate_hz = config.loop.rate_hz;
  facts.policy = replay::policy_name(config.cut);
  return facts;
}

std::uint64_t fresh_session_id() {
  std::uint64_t id = 0;
  while (id == 0) {
    if (getrandom(&id, sizeof id, 0) != sizeof id) id = static_cast<std::uint64_t>(monotonic_ns());
  }
  return id;
}

}  // namespace incise::app
