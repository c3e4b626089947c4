#include "server/app/wiring.hpp"

#include <sys/random.h>

#include <algorithm>
#include <array>
#include <bit>

#include "server/app/offline/recorded_motion.hpp"
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

// A session's blade. Thread: the stream's.
class StreamPoseInput final : public stream::PoseInput {
 public:
  StreamPoseInput(input::PoseSource source, const core::Blade& blade, const loop::LoopStats* stats)
      : source_(std::move(source)), blade_(blade), stats_(stats) {}

  std::uint32_t number() const override { return source_.number(); }

  std::size_t enqueue(std::span<const protocol::PoseSample> poses, std::int64_t arrival_ns) override {
    std::array<input::TimedPose, 256> chunk;
    std::size_t taken = 0;
    while (taken < poses.size()) {
      const std::size_t count = std::min(chunk.size(), poses.size() - taken);
      for (std::size_t i = 0; i < count; ++i) {
        const protocol::PoseSample& sample = poses[taken + i];
        const protocol::Vec3& p = sample.position;
        const protocol::Quat& q = sample.orientation;
        chunk[i] = {{sample.source_ns, {p.x, p.y, p.z}, {q.w, q.x, q.y, q.z}, sample.buttons}, arrival_ns};
      }
      const std::size_t pushed = source_.enqueue(std::span(chunk).first(count));
      taken += pushed;
      if (pushed < count) break;
    }
    return taken;
  }

  bool end_stroke(std::int64_t arrival_ns) override { return source_.end_stroke(arrival_ns); }

  stream::PoseTotals totals() const override {
    using core::PoseVerdict;
    const input::SourceCounts counts = source_.counts();
    stream::PoseTotals totals;
    totals.too_fast = counts.count(PoseVerdict::kNewStroke);
    totals.accepted = counts.count(PoseVerdict::kAccepted) + totals.too_fast;
    totals.not_finite = counts.count(PoseVerdict::kNotFinite);
    totals.not_unit = counts.count(PoseVerdict::kNotUnit);
    totals.time_not_rising = counts.count(PoseVerdict::kTimeNotIncreasing);
    totals.last_source_ns = counts.last_source_ns;
    totals.recorded = counts.recorded;
    totals.recorded_source_ns = counts.recorded_source_ns;
    if (stats_) totals.backlog_segments = static_cast<std::uint32_t>(stats_->state.load().backlog_segments);
    return totals;
  }

  protocol::Vec3 heel() const override { return to_protocol(blade_.heel); }
  protocol::Vec3 tip() const override { return to_protocol(blade_.tip); }

 private:
  input::PoseSource source_;
  const core::Blade blade_;
  const loop::LoopStats* const stats_;
};

// A simulator's hold on the positions. Thread: the stream's.
class StreamPositionsInput final : public stream::PositionsInput {
 public:
  StreamPositionsInput(input::PositionsSlot& slot, bool& open)
      : slot_(slot), open_(open), before_(slot.skipped()) {
    open_ = true;
  }
  ~StreamPositionsInput() override { open_ = false; }

  void offer(const protocol::Positions& positions, std::int64_t arrival_ns) override {
    const auto buffer = slot_.buffer();
    if (!buffer) return;
    buffer->frame = positions.frame;
    buffer->revision = positions.revision;
    buffer->source_ns = positions.source_ns;
    buffer->arrival_ns = arrival_ns;
    buffer->ids.assign(positions.ids.begin(), positions.ids.end());
    buffer->first = positions.first;
    buffer->single = positions.f64.empty();
    if (buffer->single) {
      fill(*buffer, positions.f32);
    } else {
      fill(*buffer, positions.f64);
    }
    slot_.offer(buffer);
  }
  std::uint64_t skipped() const override { return slot_.skipped() - before_; }

 private:
  template <class Number>
  static void fill(core::VertexPositions& buffer, std::span<const Number> numbers) {
    buffer.positions.resize(numbers.size() / 3);
    for (std::size_t i = 0; i < buffer.positions.size(); ++i)
      buffer.positions[i] = {numbers[3 * i], numbers[3 * i + 1], numbers[3 * i + 2]};
  }

  input::PositionsSlot& slot_;
  bool& open_;
  const std::uint64_t before_;
};

}  // namespace

std::unique_ptr<stream::PositionsInput> StreamInput::open_positions() {
  return positions_open_ ? nullptr : std::make_unique<StreamPositionsInput>(positions_, positions_open_);
}

std::unique_ptr<stream::PoseInput> StreamInput::open(std::string_view source_name,
                                                     const std::optional<protocol::BladeEdge>& brought) {
  std::optional<core::Blade> own;
  if (brought) own = to_core(*brought);
  auto source = sources_.open(source_name.empty() ? "blade" : source_name, own);
  if (!source) return nullptr;
  const core::Blade blade = own ? *own : blade_of(config_, source->number());
  return std::make_unique<StreamPoseInput>(std::move(*source), blade, loop_ ? &loop_->stats() : nullptr);
}

void ForceOutput::feel(const haptics::BladeForce& force) noexcept {
  protocol::Force message;
  message.source = force.source;
  message.source_ns = force.pose_t_ns;
  message.force_n = to_protocol(force.newtons);
  message.engaged_length_m = force.feel.engagement.length_m;
  message.saturated = (force.flags & haptics::kForceLimited) != 0;
  message.ramping = (force.flags & haptics::kForceRamping) != 0;
  message.latched_off = (force.flags & haptics::kForceLatchedOff) != 0;
  // A latch holds on the far side, too.
  if (force.feel.contact && !message.latched_off) {
    const haptics::ContactPlane& plane = *force.feel.contact;
    message.contact = protocol::LocalContact{
        to_protocol(plane.point), to_protocol(plane.normal), plane.stiffness_n_m, plane.damping_n_s_m,
        plane.resistance_n,       plane.friction_n_s_m,      valid_ns_,           plane.penetrated};
  }
  server_.publish_force(message);
}

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
