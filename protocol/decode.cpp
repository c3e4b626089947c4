// The receiving half of framing.hpp: bytes from a stranger to a checked message.

#include <algorithm>
#include <cmath>
#include <cstring>
#include <memory>
#include <type_traits>

#include "protocol/field_reader.hpp"
#include "protocol/framing.hpp"
#include "protocol/incise_generated.h"

namespace incise::protocol {
namespace {

// One overload a message.
class MessageReader : public FieldReader {
 public:
  using FieldReader::FieldReader;

  Body read(const wire::Hello& m) {
    Hello out;
    out.protocol_version = m.protocol_version();
    out.role = enumeration<Role>("role", m.role());
    out.view = enumeration<View>("view", m.view());
    out.client_name = text("client_name", m.client_name());
    out.client_version = text("client_version", m.client_version());
    out.token = text("token", m.token(), kMaxTokenBytes);
    out.resume_session = m.resume_session();
    out.resume_revision = m.resume_revision();
    out.max_rate_hz = rate("max_rate_hz", m.max_rate_hz());
    out.box = box("box", m.box());
    out.source_name = text("source_name", m.source_name());
    out.take_over = m.take_over();
    out.blade_rate_hz = rate("blade_rate_hz", m.blade_rate_hz());
    out.blade = edge("blade", m.blade());
    out.resume_hash = m.resume_hash();
    out.load_rate_hz = rate("load_rate_hz", m.load_rate_hz());
    out.fields = texts("fields", m.fields());
    return out;
  }
  Body read(const wire::Welcome& m) {
    Welcome out;
    out.protocol_version = m.protocol_version();
    out.session = m.session();
    out.role = enumeration<Role>("role", m.role());
    out.view = enumeration<View>("view", m.view());
    out.resumed = m.resumed();
    out.revision = m.revision();
    out.state_hash = m.state_hash();
    if (const wire::MeshFacts* mesh = m.mesh()) {
      out.mesh.name = text("mesh.name", mesh->name());
      out.mesh.content_hash = text("mesh.content_hash", mesh->content_hash());
      out.mesh.vertices = mesh->vertices();
      out.mesh.tets = mesh->tets();
      out.mesh.boundary_faces = mesh->boundary_faces();
      out.mesh.mean_edge_length_m = finite("mesh.mean_edge_length_m", mesh->mean_edge_length_m());
      out.mesh.box = box("mesh.box", mesh->box()).value_or(Box{});
    }
    out.blade_heel = vector("blade_heel", m.blade_heel());
    out.blade_tip = vector("blade_tip", m.blade_tip());
    out.source = m.source();
    out.engage_button = m.engage_button();
    require(out.engage_button >= -1 && out.engage_button < 32, "engage_button", "accepted are -1 to 31");
    out.max_speed_m_s = finite("max_speed_m_s", m.max_speed_m_s());
    out.frame_rate_hz = finite("frame_rate_hz", m.frame_rate_hz());
    out.max_message_bytes = m.max_message_bytes();
    out.server_name = text("server_name", m.server_name());
    out.server_version = text("server_version", m.server_version());
    out.server_monotonic_ns = m.server_monotonic_ns();
    out.server_unix_ns = m.server_unix_ns();
    out.policy = text("policy", m.policy());
    out.recording = enumeration<Recording>("recording", m.recording());
    if (const wire::SurfaceFacts* surface = m.surface()) {
      out.surface = SurfaceFacts{surface->triangles(), text("surface.path", surface->path()),
                                 text("surface.content_hash", surface->content_hash())};
    }
    out.fields = field_facts(m.fields());
    out.restart = restart(m.restart());
    return out;
  }
  Body read(const wire::Subscribe& m) {
    return Subscribe{enumeration<View>("view", m.view()), rate("max_rate_hz", m.max_rate_hz()),
                     box("box", m.box()), texts("fields", m.fields())};
  }
  Body read(const wire::Resync& m) {
    return Resync{m.revision(), m.hash(), text("reason", m.reason(), kMaxTextBytes)};
  }
  Body read(const wire::Ping& m) { return Ping{m.nonce(), m.sent_ns()}; }
  Body read(const wire::Pong& m) { return Pong{m.nonce(), m.ping_sent_ns(), m.received_ns()}; }
  Body read(const wire::Error& m) {
    // Codes and reasons of a later version are still errors: what is unknown reads as Unknown.
    const auto code = m.code() > wire::ErrorCode::MAX ? ErrorCode::Unknown : static_cast<ErrorCode>(m.code());
    return Error{code, text("text", m.text(), kMaxTextBytes), m.fatal(), m.in_reply_to()};
  }
  Body read(const wire::Bye& m) {
    const auto reason =
        m.reason() > wire::ByeReason::MAX ? ByeReason::Unknown : static_cast<ByeReason>(m.reason());
    return Bye{reason, text("text", m.text(), kMaxTextBytes)};
  }
  Body read(const wire::PoseBatch& m) {
    // Poses as they come: which to take is the input's to decide, pose by pose, and to report.
    const std::size_t n = m.poses()->size();
    if (n > kMaxPosesPerBatch) {
      fail("poses", std::to_string(n) + ", accepted are at most " + std::to_string(kMaxPosesPerBatch));
    }
    return PoseBatch{array<PoseSample>("poses", m.poses())};
  }
  Body read(const wire::PoseReport& m) {
    return PoseReport{
        m.through_sequence(), m.accepted(),           m.not_finite(),
        m.not_unit(),         m.time_not_rising(),    m.queue_full(),
        m.too_fast(),         m.last_source_ns(),     m.backlog_segments(),
        m.recorded(),         m.recorded_source_ns(), enumeration<Recording>("recording", m.recording())};
  }
  Body read(const wire::StrokeControl& m) {
    return StrokeControl{enumeration<StrokeAction>("action", m.action()), m.source_ns()};
  }
  Body read(const wire::Force& m) {
    Force out;
    out.source = m.source();
    out.source_ns = m.source_ns();
    out.force_n = vector("force_n", m.force_n());
    out.engaged_length_m = finite("engaged_length_m", m.engaged_length_m());
    if (const wire::LocalContact* c = m.contact()) {
      LocalContact contact;
      contact.point = vector("contact.point", c->point());
      contact.normal = vector("contact.normal", c->normal());
      contact.stiffness_n_per_m = finite("contact.stiffness_n_per_m", c->stiffness_n_per_m());
      contact.damping_n_s_per_m = finite("contact.damping_n_s_per_m", c->damping_n_s_per_m());
      contact.cutting_resistance_n = finite("contact.cutting_resistance_n", c->cutting_resistance_n());
      contact.friction_n_s_per_m = finite("contact.friction_n_s_per_m", c->friction_n_s_per_m());
      contact.valid_for_ns = c->valid_for_ns();
      contact.penetrated = c->penetrated();
      if (c->arm()) contact.arm = vector("contact.arm", c->arm());
      out.contact = contact;
    }
    out.saturated = m.saturated();
    out.ramping = m.ramping();
    out.latched_off = m.latched_off();
    if (m.torque_n_m()) out.torque_n_m = vector("torque_n_m", m.torque_n_m());
    return out;
  }
  Body read(const wire::Delta& m) {
    Delta out;
    out.base_revision = m.base_revision();
    out.revision = m.revision();
    out.steps = steps(m.steps(), out.base_revision, out.revision);
    out.moved_ids = ids("moved_ids", m.moved_ids(), kMaxVertices);
    out.moved_positions = positions("moved_positions", m.moved_positions(), out.moved_ids.size());
    out.first_added = m.first_added();
    const std::size_t added = m.provenance_t() == nullptr ? 0 : m.provenance_t()->size();
    out.added_positions = positions("added_positions", m.added_positions(), added);
    out.provenance_a = array("provenance_a", m.provenance_a(), added, 1);
    out.provenance_b = array("provenance_b", m.provenance_b(), added, 1);
    out.provenance_t = array<double>("provenance_t", m.provenance_t());
    for (const double t : out.provenance_t) require(t >= 0 && t <= 1, "provenance_t", "accepted are 0 to 1");
    out.tets = tets(m.tets());
    out.removed_tets = ids("removed_tets", m.removed_tets(), kMaxTets);
    out.boundary_upserted = ids("boundary_upserted", m.boundary_upserted(), 4 * kMaxTets);
    out.boundary_removed = ids("boundary_removed", m.boundary_removed(), 4 * kMaxTets);
    out.piece_ids = array<std::uint32_t>("piece_ids", m.piece_ids());
    out.piece_sizes = array("piece_sizes", m.piece_sizes(), out.piece_ids.size(), 1);
    out.piece_tets = array<std::uint32_t>("piece_tets", m.piece_tets());
    out.piece_names = array<std::uint32_t>("piece_names", m.piece_names());
    if (!out.piece_names.empty()) {
      require(out.piece_names.size() == out.piece_ids.size(), "piece_names", "as many as piece_ids, or none");
      require(out.piece_tets.empty(), "piece_tets", "none with piece_names");
    }
    std::uint64_t listed = 0;
    for (const std::uint32_t n : out.piece_sizes) listed += n;
    if (out.piece_names.empty() && listed != out.piece_tets.size()) {
      fail("piece_tets", std::to_string(out.piece_tets.size()) + " entries, piece_sizes add up to " +
                             std::to_string(listed));
    }
    out.vertex_count = m.vertex_count();
    require(out.vertex_count <= kMaxVertices, "vertex_count", "above the limit");
    out.live_tets = m.live_tets();
    out.state_hash = m.state_hash();
    out.first_new_tet = m.first_new_tet();
    out.added_ids = ids("added_ids", m.added_ids(), kMaxVertices);
    require(out.added_ids.empty() || out.added_ids.size() == added, "added_ids",
            "as many as provenance_t, or none");
    out.removed_vertices = ids("removed_vertices", m.removed_vertices(), kMaxVertices);
    out.part_hash = m.part_hash();
    out.rest_ids = ids("rest_ids", m.rest_ids(), kMaxVertices);
    out.rest_positions = positions("rest_positions", m.rest_positions(), out.rest_ids.size());
    out.blend_ids = array<std::uint32_t>("blend_ids", m.blend_ids());
    out.blend_vertices = array("blend_vertices", m.blend_vertices(), out.blend_ids.size(), 4);
    out.blend_weights = array("blend_weights", m.blend_weights(), out.blend_ids.size(), 4);
    for (const double w : out.blend_weights) require(std::isfinite(w), "blend_weights", "not finite");
    out.round_added = array<std::uint32_t>("round_added", m.round_added());
    out.round_blends = array("round_blends", m.round_blends(), out.round_added.size(), 1);
    out.tet_elders = array<std::uint32_t>("tet_elders", m.tet_elders());
    return out;
  }
  Body read(const wire::SurfaceDelta& m) {
    SurfaceDelta out;
    out.base_revision = m.base_revision();
    out.revision = m.revision();
    out.steps = steps(m.steps(), out.base_revision, out.revision);
    out.vertices = surface_vertices("vertices.ids", "vertices.positions", m.vertices());
    out.removed_vertices = ids("removed_vertices", m.removed_vertices(), kMaxVertices);
    out.triangles = triangles(m.triangles());
    out.removed_triangles = ids("removed_triangles", m.removed_triangles(), 4 * kMaxTets);
    out.surface_hash = m.surface_hash();
    out.state_hash = m.state_hash();
    out.live_tets = m.live_tets();
    out.rest = surface_vertices("rest.ids", "rest.positions", m.rest());
    return out;
  }
  Body read(const wire::SnapshotBegin& m) {
    SnapshotBegin out;
    out.view = enumeration<View>("view", m.view());
    require(out.view != View::None, "view", "None has no snapshot");
    out.revision = m.revision();
    out.cause =
        m.cause() > wire::SnapshotCause::MAX ? SnapshotCause::Join : static_cast<SnapshotCause>(m.cause());
    out.chunks = m.chunks();
    require(out.chunks <= kMaxSnapshotChunks, "chunks", "above the limit of 65536");
    out.vertex_count = m.vertex_count();
    require(out.vertex_count <= kMaxVertices, "vertex_count", "above the limit");
    out.tet_count = m.tet_count();
    require(out.tet_count <= kMaxTets, "tet_count", "above the limit");
    out.triangle_count = m.triangle_count();
    require(out.triangle_count <= 4 * kMaxTets, "triangle_count", "above the limit");
    out.box = box("box", m.box());
    out.piece_ids = ids("piece_ids", m.piece_ids(), kNoId);
    out.piece_names = array("piece_names", m.piece_names(), out.piece_ids.size(), 1);
    out.fields = ids("fields", m.fields(), kMaxFields);
    return out;
  }
  Body read(const wire::SnapshotChunk& m) {
    SnapshotChunk out;
    out.index = m.index();
    out.first_vertex = m.first_vertex();
    const std::size_t numbers = m.positions() == nullptr ? 0 : m.positions()->size();
    out.positions = positions("positions", m.positions(), numbers / 3);
    out.tets = tets(m.tets());
    out.tet_pieces = array<std::uint32_t>("tet_pieces", m.tet_pieces());
    require(out.tet_pieces.empty() || out.tet_pieces.size() == out.tets.ids.size(), "tet_pieces",
            "one for each of tets, or none");
    out.surface_vertices =
        surface_vertices("surface_vertices.ids", "surface_vertices.positions", m.surface_vertices());
    out.triangles = triangles(m.triangles());
    out.vertex_ids = ids("vertex_ids", m.vertex_ids(), kMaxVertices);
    require(out.vertex_ids.empty() || 3 * out.vertex_ids.size() == numbers, "vertex_ids",
            "one for each of positions, or none");
    const bool rest = m.rest_positions() != nullptr && m.rest_positions()->size() > 0;
    out.rest_positions = positions("rest_positions", m.rest_positions(), rest ? numbers / 3 : 0);
    out.surface_rest = surface_vertices("surface_rest.ids", "surface_rest.positions", m.surface_rest());
    return out;
  }
  Body read(const wire::SnapshotEnd& m) {
    return SnapshotEnd{m.revision(), m.state_hash(), m.surface_hash(), m.part_hash()};
  }
  Body read(const wire::Positions& m) {
    Positions out;
    out.frame = m.frame();
    out.revision = m.revision();
    out.source_ns = m.source_ns();
    out.ids = ids("ids", m.ids(), kMaxVertices);
    out.first = m.first();
    const std::size_t single = m.f32() == nullptr ? 0 : m.f32()->size();
    const std::size_t twice = m.f64() == nullptr ? 0 : m.f64()->size();
    require(single == 0 || twice == 0, "f64", "present as well as f32, accepted is one of them");
    const std::size_t vertices = out.ids.empty() ? (single + twice) / 3 : out.ids.size();
    if (single > 0) out.f32 = positions("f32", m.f32(), vertices);
    if (twice > 0) out.f64 = positions("f64", m.f64(), vertices);
    require(single + twice == 3 * vertices, "ids", "without positions");
    require(vertices <= kMaxPositionsVertices, "ids", "more vertices than a Positions message may have");
    require(out.first <= kMaxVertices - vertices, "first", "above the limit");
    return out;
  }
  Body read(const wire::Stats& m) {
    Stats out;
    out.json = text("json", m.json(), kMaxStatsJsonBytes);
    out.revision = m.revision();
    out.live_tets = m.live_tets();
    out.pieces = m.pieces();
    out.sessions = m.sessions();
    out.backlog_segments = m.backlog_segments();
    out.frames = m.frames();
    out.late_frames = m.late_frames();
    out.poses_accepted = m.poses_accepted();
    out.poses_rejected = m.poses_rejected();
    out.frame_work_p99_us = finite("frame_work_p99_us", m.frame_work_p99_us());
    out.pose_to_delta_p99_us = finite("pose_to_delta_p99_us", m.pose_to_delta_p99_us());
    out.recording = enumeration<Recording>("recording", m.recording());
    out.undoable = m.undoable();
    out.blades = blade_stats(m.blades());
    return out;
  }
  Body read(const wire::Reset&) { return Reset{}; }
  Body read(const wire::Undo& m) { return Undo{m.others()}; }
  Body read(const wire::ReplayControl& m) {
    const float speed = finite("speed", m.speed());
    require(speed > 0, "speed", "accepted are numbers above 0");
    return ReplayControl{enumeration<ReplayAction>("action", m.action()), text("capture", m.capture()), speed,
                         m.revision()};
  }
  Body read(const wire::PositionsReport& m) {
    PositionsReport out;
    out.frame = m.frame();
    out.revision = m.revision();
    out.moved = m.moved();
    out.passed_over = m.passed_over();
    out.held = ids("held", m.held(), kMaxVertices);
    out.taken = m.taken();
    out.skipped = m.skipped();
    return out;
  }
  Body read(const wire::BladeLoad& m) {
    BladeLoad out;
    out.source = m.source();
    out.revision = m.revision();
    out.source_ns = m.source_ns();
    out.server_ns = m.server_ns();
    out.contact = enumeration<BladeContact>("contact", m.contact());
    out.engaged = m.engaged();
    out.heel = vector("heel", m.heel());
    out.tip = vector("tip", m.tip());
    out.tool = vector("tool", m.tool());
    out.force_n = vector("force_n", m.force_n());
    out.torque_n_m = vector("torque_n_m", m.torque_n_m());
    out.center = vector("center", m.center());
    out.engaged_length_m = finite("engaged_length_m", m.engaged_length_m());
    out.ids = ids("ids", m.ids(), kMaxVertices);
    out.forces = positions("forces", m.forces(), out.ids.size());
    out.number = m.number();
    out.skipped = m.skipped();
    return out;
  }
  Body read(const wire::BladeModel& m) {
    // Numbers as they come: the server refuses a bad model with a reason, and goes on.
    BladeModel out;
    out.source = m.source();
    out.server_ns = m.server_ns();
    out.point = {m.point()->x(), m.point()->y(), m.point()->z()};
    out.normal = {m.normal()->x(), m.normal()->y(), m.normal()->z()};
    out.stiffness = array<double>("stiffness", m.stiffness());
    out.damping_n_s_per_m = m.damping_n_s_per_m();
    out.resistance_n = m.resistance_n();
    out.valid_for_ns = m.valid_for_ns();
    return out;
  }
  Body read(const wire::FieldValues& m) {
    FieldValues out{
        m.field(),    m.first(), array<float>("f32", m.f32()), array<std::int32_t>("i32", m.i32()),
        m.revision(), m.last()};
    require(out.f32.empty() || out.i32.empty(), "i32", "present as well as f32, accepted is one of them");
    return out;
  }
  Body read(const wire::BladePose& m) {
    BladePose out;
    out.source = m.source();
    out.cutting = m.cutting();
    out.heel = vector("heel", m.heel());
    out.tip = vector("tip", m.tip());
    out.arrival_ns = m.arrival_ns();
    if (m.force_n()) out.force_n = vector("force_n", m.force_n());
    return out;
  }
  Body read(const wire::SurfaceAsset& m) {
    SurfaceAsset out;
    const std::size_t vertices = m.positions() == nullptr ? 0 : m.positions()->size() / 3;
    out.positions = positions("positions", m.positions(), vertices);
    const std::size_t triangles = m.triangles() == nullptr ? 0 : m.triangles()->size() / 3;
    out.triangles = array("triangles", m.triangles(), triangles, 3);
    for (const std::uint32_t v : out.triangles) {
      if (v < vertices) continue;
      fail("triangles", "vertex " + std::to_string(v) + " of " + std::to_string(vertices));
      break;
    }
    out.uvs = by_element("uvs", m.uvs(), 3 * triangles, 2);
    out.normals = by_element("normals", m.normals(), 3 * triangles, 3);
    out.colours = by_element("colours", m.colours(), 3 * triangles, 4);
    out.material_indices = by_element("material_indices", m.material_indices(), triangles, 1);
    for (const float x : out.uvs) finite("uvs", x);
    for (const float x : out.normals) finite("normals", x);
    if (m.materials() != nullptr) {
      require(m.materials()->size() <= kMaxMaterials, "materials", "above the limit of 4096");
      for (const wire::Material* from : *m.materials()) {
        Material material{
            text("materials.name", from->name()), {}, text("materials.texture", from->texture())};
        const auto diffuse = array("materials.diffuse", from->diffuse(), 1, 3);
        if (diffuse.size() == 3) std::copy_n(diffuse.begin(), 3, material.diffuse.begin());
        for (const float x : material.diffuse) finite("materials.diffuse", x);
        out.materials.push_back(std::move(material));
      }
    }
    for (const std::uint32_t i : out.material_indices)
      require(i < out.materials.size(), "material_indices", "a material that does not exist");
    return out;
  }
  Body read(const wire::ReplayState& m) {
    const auto times = array<std::uint32_t>("revision_ms", m.revision_ms());
    const auto sources = array("revision_sources", m.revision_sources(), times.size(), 1);
    const auto strokes = array("revision_strokes", m.revision_strokes(), times.size(), 1);
    require(std::is_sorted(times.begin(), times.end()), "revision_ms", "a time before the last one");
    return ReplayState{text("capture", m.capture()),
                       m.playing(),
                       finite("speed", m.speed()),
                       m.revision(),
                       m.last_revision(),
                       text("text", m.text(), kMaxTextBytes),
                       {times.begin(), times.end()},
                       {sources.begin(), sources.end()},
                       {strokes.begin(), strokes.end()}};
  }
};

Body read_body(MessageReader& reader, const wire::Message& message) {
  switch (message.body_type()) {
#define INCISE_MESSAGE(Type) \
  case wire::Body::Type:     \
    return reader.read(*message.body_as_##Type())
    INCISE_MESSAGE(Hello);
    INCISE_MESSAGE(Welcome);
    INCISE_MESSAGE(Subscribe);
    INCISE_MESSAGE(Resync);
    INCISE_MESSAGE(Ping);
    INCISE_MESSAGE(Pong);
    INCISE_MESSAGE(Error);
    INCISE_MESSAGE(Bye);
    INCISE_MESSAGE(PoseBatch);
    INCISE_MESSAGE(PoseReport);
    INCISE_MESSAGE(StrokeControl);
    INCISE_MESSAGE(Force);
    INCISE_MESSAGE(Delta);
    INCISE_MESSAGE(SurfaceDelta);
    INCISE_MESSAGE(SnapshotBegin);
    INCISE_MESSAGE(SnapshotChunk);
    INCISE_MESSAGE(SnapshotEnd);
    INCISE_MESSAGE(Positions);
    INCISE_MESSAGE(Stats);
    INCISE_MESSAGE(Reset);
    INCISE_MESSAGE(Undo);
    INCISE_MESSAGE(ReplayControl);
    INCISE_MESSAGE(ReplayState);
    INCISE_MESSAGE(BladePose);
    INCISE_MESSAGE(PositionsReport);
    INCISE_MESSAGE(SurfaceAsset);
    INCISE_MESSAGE(BladeLoad);
    INCISE_MESSAGE(BladeModel);
    INCISE_MESSAGE(FieldValues);
#undef INCISE_MESSAGE
    case wire::Body::NONE:
      break;
  }
  return Reset{};  // not reached: decode() has refused every other type
}

DecodeResult bad(ErrorCode code, std::string error) {
  return {std::nullopt, code, std::move(error)};
}

}  // namespace

DecodeResult decode(std::span<const std::byte> bytes, std::size_t max_bytes) {
  if (bytes.size() > max_bytes) {
    return bad(ErrorCode::TooLong, "message of " + std::to_string(bytes.size()) +
                                       " bytes, accepted are at most " + std::to_string(max_bytes));
  }
  if (bytes.size() < kMinMessageBytes) {
    return bad(ErrorCode::BadFrame, "message of " + std::to_string(bytes.size()) +
                                        " bytes, accepted are at least " + std::to_string(kMinMessageBytes));
  }
  std::shared_ptr<const void> storage;
  if (reinterpret_cast<std::uintptr_t>(bytes.data()) % 8 != 0) {
    auto copy = std::make_shared<std::vector<std::uint64_t>>((bytes.size() + 7) / 8);
    std::memcpy(copy->data(), bytes.data(), bytes.size());
    bytes = {reinterpret_cast<const std::byte*>(copy->data()), bytes.size()};
    storage = std::move(copy);
  }
  const auto* data = reinterpret_cast<const std::uint8_t*>(bytes.data());
  if (!wire::MessageBufferHasIdentifier(data)) {
    return bad(ErrorCode::BadFrame,
               std::string("message without the identifier ") + wire::MessageIdentifier());
  }
  flatbuffers::Verifier verifier(data, bytes.size(), kMaxDepth, kMaxTables);
  if (!wire::VerifyMessageBuffer(verifier)) {
    return bad(ErrorCode::BadFrame, "message that is no valid FlatBuffer of incise.fbs");
  }
  const wire::Message& message = *wire::GetMessage(data);
  if (message.body_type() == wire::Body::NONE || message.body_type() > wire::Body::MAX) {
    return bad(ErrorCode::BadFrame,
               "message type " + std::to_string(static_cast<unsigned>(message.body_type())) +
                   ", accepted are 1 to " + std::to_string(static_cast<unsigned>(wire::Body::MAX)));
  }
  MessageReader reader(wire::EnumNameBody(message.body_type()));
  Body body = read_body(reader, message);
  if (!reader.ok()) return bad(ErrorCode::BadFrame, reader.error());
  return {Message{{message.sequence(), message.sent_ns()}, std::move(body), std::move(storage)},
          ErrorCode::Unknown,
          {}};
}

}  // namespace incise::protocol
