#include "protocol/framing.hpp"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <stdexcept>
#include <type_traits>

#include "protocol/incise_generated.h"

namespace incise::protocol {

static_assert(std::endian::native == std::endian::little, "arrays go to the wire as they lie in memory");
static_assert(sizeof(wire::PoseSample) == sizeof(PoseSample) && sizeof(wire::Vec3) == sizeof(Vec3));
static_assert(std::variant_size_v<Body> == static_cast<std::size_t>(wire::Body::MAX),
              "Body lists the union's members");

namespace {

using flatbuffers::FlatBufferBuilder;
using flatbuffers::Offset;
template <class T>
using Vec = flatbuffers::Vector<T>;

constexpr std::size_t kPrefixBytes = 4;

// ---- Encoding ----

wire::Vec3 to_wire(const Vec3& v) {
  return {v.x, v.y, v.z};
}

template <class T>
Offset<Vec<T>> array(FlatBufferBuilder& b, std::span<const T> values) {
  return values.empty() ? Offset<Vec<T>>() : b.CreateVector(values.data(), values.size());
}

Offset<flatbuffers::String> text(FlatBufferBuilder& b, const std::string& s) {
  return s.empty() ? Offset<flatbuffers::String>() : b.CreateString(s);
}

Offset<wire::Box> box(FlatBufferBuilder& b, const std::optional<Box>& value) {
  if (!value) return {};
  const wire::Vec3 min = to_wire(value->min), max = to_wire(value->max);
  return wire::CreateBox(b, &min, &max);
}

Offset<wire::BladeEdge> edge(FlatBufferBuilder& b, const std::optional<BladeEdge>& value) {
  if (!value) return {};
  const wire::Vec3 heel = to_wire(value->heel), tip = to_wire(value->tip);
  return wire::CreateBladeEdge(b, &heel, &tip);
}

Offset<wire::Tets> tets(FlatBufferBuilder& b, const TetArrays& t) {
  if (t.ids.empty()) return {};
  return wire::CreateTets(b, array(b, t.ids), array(b, t.vertices), array(b, t.regions),
                          array(b, t.cut_masks), array(b, t.boundary_masks));
}

Offset<wire::Triangles> triangles(FlatBufferBuilder& b, const TriangleArrays& t) {
  if (t.ids.empty()) return {};
  return wire::CreateTriangles(b, array(b, t.ids), array(b, t.vertices), array(b, t.flags),
                               array(b, t.pieces), array(b, t.regions), array(b, t.origins));
}

Offset<wire::SurfaceVertices> surface_vertices(FlatBufferBuilder& b, const SurfaceVertexArrays& v) {
  if (v.ids.empty()) return {};
  return wire::CreateSurfaceVertices(b, array(b, v.ids), array(b, v.positions));
}

Offset<Vec<Offset<wire::Step>>> steps(FlatBufferBuilder& b, const std::vector<Step>& values) {
  std::vector<Offset<wire::Step>> offsets;
  offsets.reserve(values.size());
  for (const Step& s : values) {
    const wire::Vec3 from_heel = to_wire(s.from_heel), from_tip = to_wire(s.from_tip);
    const wire::Vec3 to_heel = to_wire(s.to_heel), to_tip = to_wire(s.to_tip);
    offsets.push_back(wire::CreateStep(
        b, s.revision, s.source, s.stroke, s.batch, s.stroke_ended, &from_heel, &from_tip, &to_heel, &to_tip,
        s.from_source_ns, s.to_source_ns, s.arrival_ns, s.drain_ns, s.cut_ns, s.cut_faces, s.cut_area_m2,
        s.snaps, s.splits, s.min_dihedral_deg, s.max_deviation_h, s.state_hash));
  }
  return offsets.empty() ? Offset<Vec<Offset<wire::Step>>>() : b.CreateVector(offsets);
}

Offset<Vec<Offset<flatbuffers::String>>> texts(FlatBufferBuilder& b, const std::vector<std::string>& values) {
  return values.empty() ? Offset<Vec<Offset<flatbuffers::String>>>() : b.CreateVectorOfStrings(values);
}

Offset<Vec<Offset<wire::FieldFacts>>> field_facts(FlatBufferBuilder& b,
                                                  const std::vector<FieldFacts>& values) {
  std::vector<Offset<wire::FieldFacts>> offsets;
  for (const FieldFacts& f : values) {
    const auto name = text(b, f.name);
    offsets.push_back(wire::CreateFieldFacts(b, name, wire::FieldOn(f.on), f.components, f.whole));
  }
  return offsets.empty() ? Offset<Vec<Offset<wire::FieldFacts>>>() : b.CreateVector(offsets);
}

Offset<wire::Restart> restart(FlatBufferBuilder& b, const std::optional<Restart>& value) {
  if (!value) return {};
  const auto by = text(b, value->by), blade = text(b, value->blade);
  const auto others = texts(b, value->others);
  return wire::CreateRestart(b, wire::RestartKind(value->kind), wire::Role(value->role), by, value->source,
                             blade, others);
}

Offset<Vec<Offset<wire::BladeStats>>> blade_stats(FlatBufferBuilder& b,
                                                  const std::vector<BladeStats>& values) {
  std::vector<Offset<wire::BladeStats>> offsets;
  for (const BladeStats& s : values) {
    const auto name = text(b, s.name);
    offsets.push_back(
        wire::CreateBladeStats(b, s.source, name, s.poses, s.rejected, s.strokes, s.cut_faces, s.in_stroke));
  }
  return offsets.empty() ? Offset<Vec<Offset<wire::BladeStats>>>() : b.CreateVector(offsets);
}

// One overload a message; each returns the offset of its table.
struct Encoder {
  FlatBufferBuilder& b;

  auto operator()(const Hello& m) {
    const auto name = text(b, m.client_name), version = text(b, m.client_version), token = text(b, m.token);
    const auto interest = box(b, m.box);
    const auto source = text(b, m.source_name);
    const auto blade = edge(b, m.blade);
    const auto fields = texts(b, m.fields);
    return wire::CreateHello(b, m.protocol_version, wire::Role(m.role), wire::View(m.view), name, version,
                             token, m.resume_session, m.resume_revision, m.max_rate_hz, interest, source,
                             m.take_over, m.blade_rate_hz, blade, m.resume_hash, m.load_rate_hz, fields)
        .Union();
  }
  auto operator()(const Welcome& m) {
    const auto mesh_name = text(b, m.mesh.name), mesh_hash = text(b, m.mesh.content_hash);
    const auto mesh_box = box(b, m.mesh.box);
    const auto mesh = wire::CreateMeshFacts(b, mesh_name, mesh_hash, m.mesh.vertices, m.mesh.tets,
                                            m.mesh.boundary_faces, m.mesh.mean_edge_length_m, mesh_box);
    const auto name = text(b, m.server_name), version = text(b, m.server_version), policy = text(b, m.policy);
    const wire::Vec3 heel = to_wire(m.blade_heel), tip = to_wire(m.blade_tip);
    Offset<wire::SurfaceFacts> surface;
    if (m.surface) {
      const auto path = text(b, m.surface->path), hash = text(b, m.surface->content_hash);
      surface = wire::CreateSurfaceFacts(b, m.surface->triangles, path, hash);
    }
    const auto fields = field_facts(b, m.fields);
    const auto began = restart(b, m.restart);
    return wire::CreateWelcome(b, m.protocol_version, m.session, wire::Role(m.role), wire::View(m.view),
                               m.resumed, m.revision, m.state_hash, mesh, &heel, &tip, m.source,
                               m.engage_button, m.max_speed_m_s, m.frame_rate_hz, m.max_message_bytes, name,
                               version, m.server_monotonic_ns, m.server_unix_ns, policy,
                               wire::Recording(m.recording), surface, fields, began)
        .Union();
  }
  auto operator()(const Subscribe& m) {
    const auto interest = box(b, m.box);
    const auto fields = texts(b, m.fields);
    return wire::CreateSubscribe(b, wire::View(m.view), m.max_rate_hz, interest, fields).Union();
  }
  auto operator()(const Resync& m) {
    const auto reason = text(b, m.reason);
    return wire::CreateResync(b, m.revision, m.hash, reason).Union();
  }
  auto operator()(const Ping& m) { return wire::CreatePing(b, m.nonce, m.sent_ns).Union(); }
  auto operator()(const Pong& m) {
    return wire::CreatePong(b, m.nonce, m.ping_sent_ns, m.received_ns).Union();
  }
  auto operator()(const Error& m) {
    const auto what = text(b, m.text);
    return wire::CreateError(b, wire::ErrorCode(m.code), what, m.fatal, m.in_reply_to).Union();
  }
  auto operator()(const Bye& m) {
    const auto what = text(b, m.text);
    return wire::CreateBye(b, wire::ByeReason(m.reason), what).Union();
  }
  auto operator()(const PoseBatch& m) {
    // The wire's struct is this struct, byte for byte (asserted above).
    const auto* poses = reinterpret_cast<const wire::PoseSample*>(m.poses.data());
    return wire::CreatePoseBatch(b, b.CreateVectorOfStructs(poses, m.poses.size())).Union();
  }
  auto operator()(const PoseReport& m) {
    return wire::CreatePoseReport(b, m.through_sequence, m.accepted, m.not_finite, m.not_unit,
                                  m.time_not_rising, m.queue_full, m.too_fast, m.last_source_ns,
                                  m.backlog_segments, m.recorded, m.recorded_source_ns,
                                  wire::Recording(m.recording))
        .Union();
  }
  auto operator()(const StrokeControl& m) {
    return wire::CreateStrokeControl(b, wire::StrokeAction(m.action), m.source_ns).Union();
  }
  auto operator()(const Force& m) {
    Offset<wire::LocalContact> contact;
    if (m.contact) {
      const wire::Vec3 point = to_wire(m.contact->point), normal = to_wire(m.contact->normal);
      const wire::Vec3 arm = to_wire(m.contact->arm.value_or(Vec3{}));
      contact = wire::CreateLocalContact(b, &point, &normal, m.contact->stiffness_n_per_m,
                                         m.contact->damping_n_s_per_m, m.contact->cutting_resistance_n,
                                         m.contact->friction_n_s_per_m, m.contact->valid_for_ns,
                                         m.contact->penetrated, m.contact->arm ? &arm : nullptr);
    }
    const wire::Vec3 force = to_wire(m.force_n), torque = to_wire(m.torque_n_m.value_or(Vec3{}));
    return wire::CreateForce(b, m.source, m.source_ns, &force, m.engaged_length_m, contact, m.saturated,
                             m.ramping, m.latched_off, m.torque_n_m ? &torque : nullptr)
        .Union();
  }
  auto operator()(const Delta& m) {
    const auto step_list = steps(b, m.steps);
    const auto moved_ids = array(b, m.moved_ids);
    const auto moved_positions = array(b, m.moved_positions);
    const auto added_positions = array(b, m.added_positions);
    const auto provenance_a = array(b, m.provenance_a), provenance_b = array(b, m.provenance_b);
    const auto provenance_t = array(b, m.provenance_t);
    const auto tet_table = tets(b, m.tets);
    const auto removed = array(b, m.removed_tets);
    const auto upserted_faces = array(b, m.boundary_upserted), removed_faces = array(b, m.boundary_removed);
    const auto piece_ids = array(b, m.piece_ids), piece_sizes = array(b, m.piece_sizes);
    const auto piece_tets = array(b, m.piece_tets);
    const auto added_ids = array(b, m.added_ids), removed_vertices = array(b, m.removed_vertices);
    const auto rest_ids = array(b, m.rest_ids);
    const auto rest_positions = array(b, m.rest_positions);
    const auto piece_names = array(b, m.piece_names);
    const auto blend_ids = array(b, m.blend_ids), blend_vertices = array(b, m.blend_vertices);
    const auto blend_weights = array(b, m.blend_weights);
    const auto round_added = array(b, m.round_added), round_blends = array(b, m.round_blends);
    const auto tet_elders = array(b, m.tet_elders);
    return wire::CreateDelta(b, m.base_revision, m.revision, step_list, moved_ids, moved_positions,
                             m.first_added, added_positions, provenance_a, provenance_b, provenance_t,
                             tet_table, removed, upserted_faces, removed_faces, piece_ids, piece_sizes,
                             piece_tets, m.vertex_count, m.live_tets, m.state_hash, m.first_new_tet,
                             added_ids, removed_vertices, m.part_hash, rest_ids, rest_positions, piece_names,
                             blend_ids, blend_vertices, blend_weights, round_added, round_blends, tet_elders)
        .Union();
  }
  auto operator()(const SurfaceDelta& m) {
    const auto step_list = steps(b, m.steps);
    const auto vertices = surface_vertices(b, m.vertices);
    const auto removed_vertices = array(b, m.removed_vertices);
    const auto triangle_table = triangles(b, m.triangles);
    const auto removed = array(b, m.removed_triangles);
    const auto rest = surface_vertices(b, m.rest);
    return wire::CreateSurfaceDelta(b, m.base_revision, m.revision, step_list, vertices, removed_vertices,
                                    triangle_table, removed, m.surface_hash, m.state_hash, m.live_tets, rest)
        .Union();
  }
  auto operator()(const SnapshotBegin& m) {
    const auto interest = box(b, m.box);
    const auto piece_ids = array(b, m.piece_ids), piece_names = array(b, m.piece_names);
    const auto fields = array(b, m.fields);
    return wire::CreateSnapshotBegin(b, wire::View(m.view), m.revision, wire::SnapshotCause(m.cause),
                                     m.chunks, m.vertex_count, m.tet_count, m.triangle_count, interest,
                                     piece_ids, piece_names, fields)
        .Union();
  }
  auto operator()(const SnapshotChunk& m) {
    const auto positions = array(b, m.positions);
    const auto tet_table = tets(b, m.tets);
    const auto pieces = array(b, m.tet_pieces);
    const auto vertices = surface_vertices(b, m.surface_vertices);
    const auto triangle_table = triangles(b, m.triangles);
    const auto vertex_ids = array(b, m.vertex_ids);
    const auto rest_positions = array(b, m.rest_positions);
    const auto surface_rest = surface_vertices(b, m.surface_rest);
    return wire::CreateSnapshotChunk(b, m.index, m.first_vertex, positions, tet_table, pieces, vertices,
                                     triangle_table, vertex_ids, rest_positions, surface_rest)
        .Union();
  }
  auto operator()(const SnapshotEnd& m) {
    return wire::CreateSnapshotEnd(b, m.revision, m.state_hash, m.surface_hash, m.part_hash).Union();
  }
  auto operator()(const Positions& m) {
    const auto ids = array(b, m.ids);
    const auto f32 = array(b, m.f32);
    const auto f64 = array(b, m.f64);
    return wire::CreatePositions(b, m.frame, m.revision, m.source_ns, ids, m.first, f32, f64).Union();
  }
  auto operator()(const Stats& m) {
    const auto json = text(b, m.json);
    const auto blades = blade_stats(b, m.blades);
    return wire::CreateStats(b, json, m.revision, m.live_tets, m.pieces, m.sessions, m.backlog_segments,
                             m.frames, m.late_frames, m.poses_accepted, m.poses_rejected, m.frame_work_p99_us,
                             m.pose_to_delta_p99_us, wire::Recording(m.recording), m.undoable, blades)
        .Union();
  }
  auto operator()(const Undo& m) { return wire::CreateUndo(b, m.others).Union(); }
  auto operator()(const Reset&) { return wire::CreateReset(b).Union(); }
  auto operator()(const ReplayControl& m) {
    const auto capture = text(b, m.capture);
    return wire::CreateReplayControl(b, wire::ReplayAction(m.action), capture, m.speed, m.revision).Union();
  }
  auto operator()(const BladePose& m) {
    const wire::Vec3 heel = to_wire(m.heel), tip = to_wire(m.tip),
                     force = to_wire(m.force_n.value_or(Vec3{}));
    return wire::CreateBladePose(b, m.source, m.cutting, &heel, &tip, m.arrival_ns,
                                 m.force_n ? &force : nullptr)
        .Union();
  }
  auto operator()(const PositionsReport& m) {
    const auto held = array(b, m.held);
    return wire::CreatePositionsReport(b, m.frame, m.revision, m.moved, m.passed_over, held, m.taken,
                                       m.skipped)
        .Union();
  }
  auto operator()(const SurfaceAsset& m) {
    std::vector<Offset<wire::Material>> materials;
    for (const Material& material : m.materials) {
      const auto name = text(b, material.name);
      const auto diffuse = array(b, std::span<const float>(material.diffuse));
      const auto texture = text(b, material.texture);
      materials.push_back(wire::CreateMaterial(b, name, diffuse, texture));
    }
    const auto material_list =
        materials.empty() ? Offset<Vec<Offset<wire::Material>>>() : b.CreateVector(materials);
    const auto positions = array(b, m.positions);
    const auto triangles = array(b, m.triangles);
    const auto uvs = array(b, m.uvs), normals = array(b, m.normals);
    const auto colours = array(b, m.colours);
    const auto indices = array(b, m.material_indices);
    return wire::CreateSurfaceAsset(b, positions, triangles, uvs, normals, colours, indices, material_list)
        .Union();
  }
  auto operator()(const BladeLoad& m) {
    const auto ids = array(b, m.ids);
    const auto forces = array(b, m.forces);
    const wire::Vec3 heel = to_wire(m.heel), tip = to_wire(m.tip), tool = to_wire(m.tool);
    const wire::Vec3 force = to_wire(m.force_n), torque = to_wire(m.torque_n_m), center = to_wire(m.center);
    return wire::CreateBladeLoad(b, m.source, m.revision, m.source_ns, m.server_ns,
                                 wire::BladeContact(m.contact), m.engaged, &heel, &tip, &tool, &force,
                                 &torque, &center, m.engaged_length_m, ids, forces, m.number, m.skipped)
        .Union();
  }
  auto operator()(const BladeModel& m) {
    const auto stiffness = array(b, m.stiffness);
    const wire::Vec3 point = to_wire(m.point), normal = to_wire(m.normal);
    return wire::CreateBladeModel(b, m.source, m.server_ns, &point, &normal, stiffness, m.damping_n_s_per_m,
                                  m.resistance_n, m.valid_for_ns)
        .Union();
  }
  auto operator()(const FieldValues& m) {
    const auto f32 = array(b, m.f32);
    const auto i32 = array(b, m.i32);
    return wire::CreateFieldValues(b, m.field, m.first, f32, i32, m.revision, m.last).Union();
  }
  auto operator()(const ReplayState& m) {
    const auto capture = text(b, m.capture), what = text(b, m.text);
    const auto times = array(b, std::span(m.revision_ms));
    const auto sources = array(b, std::span(m.revision_sources));
    const auto strokes = array(b, std::span(m.revision_strokes));
    return wire::CreateReplayState(b, capture, m.playing, m.speed, m.revision, m.last_revision, what, times,
                                   sources, strokes)
        .Union();
  }
};

std::size_t bytes_of(const TetArrays& t) {
  return t.ids.size() * (4 + 16 + 4 + 1 + 1);
}
std::size_t bytes_of(const TriangleArrays& t) {
  return t.ids.size() * (4 + 12 + 1 + 4 + 4) + t.origins.size_bytes();
}
std::size_t bytes_of(const SurfaceVertexArrays& v) {
  return v.ids.size() * (4 + 12);
}

// About how many bytes a message has apart from its arrays.
constexpr std::size_t kSmall = 1024;

// About how long the message gets: what the builder should allocate at once.
std::size_t expected_bytes(const Body& body) {
  return std::visit(
      [](const auto& m) -> std::size_t {
        using T = std::decay_t<decltype(m)>;
        if constexpr (std::is_same_v<T, PoseBatch>) return kSmall + m.poses.size_bytes();
        if constexpr (std::is_same_v<T, Stats>) return kSmall + m.json.size();
        if constexpr (std::is_same_v<T, Positions>) {
          return kSmall + m.ids.size_bytes() + m.f32.size_bytes() + m.f64.size_bytes();
        }
        if constexpr (std::is_same_v<T, Delta>) {
          return kSmall + m.steps.size() * 320 + m.moved_ids.size_bytes() + m.moved_positions.size_bytes() +
                 m.added_positions.size_bytes() + m.provenance_a.size_bytes() + m.provenance_b.size_bytes() +
                 m.provenance_t.size_bytes() + bytes_of(m.tets) + m.removed_tets.size_bytes() +
                 m.boundary_upserted.size_bytes() + m.boundary_removed.size_bytes() +
                 m.piece_ids.size_bytes() + m.piece_sizes.size_bytes() + m.piece_tets.size_bytes() +
                 m.piece_names.size_bytes() + m.added_ids.size_bytes() + m.removed_vertices.size_bytes() +
                 m.rest_ids.size_bytes() + m.rest_positions.size_bytes() + m.blend_ids.size_bytes() +
                 m.blend_vertices.size_bytes() + m.blend_weights.size_bytes() +
                 2 * m.round_added.size_bytes() + m.tet_elders.size_bytes();
        }
        if constexpr (std::is_same_v<T, SurfaceDelta>) {
          return kSmall + m.steps.size() * 320 + bytes_of(m.vertices) + m.removed_vertices.size_bytes() +
                 bytes_of(m.triangles) + m.removed_triangles.size_bytes() + bytes_of(m.rest);
        }
        if constexpr (std::is_same_v<T, SnapshotBegin>) return kSmall + 2 * m.piece_ids.size_bytes();
        if constexpr (std::is_same_v<T, SnapshotChunk>) {
          return kSmall + m.positions.size_bytes() + bytes_of(m.tets) + m.tet_pieces.size_bytes() +
                 bytes_of(m.surface_vertices) + bytes_of(m.triangles) + m.vertex_ids.size_bytes() +
                 m.rest_positions.size_bytes() + bytes_of(m.surface_rest);
        }
        if constexpr (std::is_same_v<T, SurfaceAsset>) {
          return kSmall + m.positions.size_bytes() + m.triangles.size_bytes() + m.uvs.size_bytes() +
                 m.normals.size_bytes() + m.colours.size_bytes() + m.material_indices.size_bytes();
        }
        if constexpr (std::is_same_v<T, FieldValues>) return kSmall + m.f32.size_bytes() + m.i32.size_bytes();
        if constexpr (std::is_same_v<T, PositionsReport>) return kSmall + m.held.size_bytes();
        if constexpr (std::is_same_v<T, ReplayState>) return kSmall + 12 * m.revision_ms.size();
        if constexpr (std::is_same_v<T, BladeLoad>)
          return kSmall + m.ids.size_bytes() + m.forces.size_bytes();
        return kSmall;
      },
      body);
}

}  // namespace

Frame encode(const Body& body, Envelope envelope) {
  const std::size_t expected = expected_bytes(body);
  const auto check = [&](std::size_t bytes) {
    if (bytes > kMaxMessageBytes) {
      throw std::length_error(std::string(name_of(body)) + " of " + std::to_string(bytes) +
                              " bytes: a message has at most " + std::to_string(kMaxMessageBytes));
    }
  };
  check(expected - kSmall);
  FlatBufferBuilder builder(expected);
  const auto offset = std::visit(Encoder{builder}, body);
  const auto type = static_cast<wire::Body>(body.index() + 1);
  wire::FinishMessageBuffer(builder,
                            wire::CreateMessage(builder, envelope.sequence, envelope.sent_ns, type, offset));
  const std::size_t size = builder.GetSize();
  check(size);
  std::vector<std::byte> bytes(kPrefixBytes + size);
  const auto prefix = static_cast<std::uint32_t>(size);
  std::memcpy(bytes.data(), &prefix, kPrefixBytes);
  std::memcpy(bytes.data() + kPrefixBytes, builder.GetBufferPointer(), size);
  return Frame(std::move(bytes));
}

// ---- Framing ----

FrameReader::Status FrameReader::read(std::span<const std::byte>& input) {
  if (failed_) return Status::Failed;
  if (complete_) {
    complete_ = false;
    prefix_have_ = size_ = have_ = 0;
  }
  if (prefix_have_ < kPrefixBytes) {
    const std::size_t n = std::min(kPrefixBytes - prefix_have_, input.size());
    std::copy_n(input.begin(), n, prefix_ + prefix_have_);
    prefix_have_ += n;
    input = input.subspan(n);
    if (prefix_have_ < kPrefixBytes) return Status::NeedMore;
    std::uint32_t size = 0;
    std::memcpy(&size, prefix_, kPrefixBytes);
    if (size < kMinMessageBytes || size > max_bytes_) {
      failed_ = true;
      if (std::memcmp(prefix_, "HTTP", kPrefixBytes) == 0)
        error_ =
            "the port speaks HTTP, not the binary protocol: use the other port, or ws:// before this one";
      else
        error_ = "length prefix: " + std::to_string(size) + " bytes, accepted are " +
                 std::to_string(kMinMessageBytes) + " to " + std::to_string(max_bytes_);
      return Status::Failed;
    }
    size_ = size;
  }
  const std::size_t n = std::min(size_ - have_, input.size());
  const std::size_t words = (have_ + n + 7) / 8;
  if (buffer_.size() < words) {
    // Twice what has arrived, never more than the message: a prefix alone must not cause a large allocation.
    buffer_.resize(std::min((size_ + 7) / 8, 2 * words));
  }
  if (n > 0) std::memcpy(reinterpret_cast<std::byte*>(buffer_.data()) + have_, input.data(), n);
  have_ += n;
  input = input.subspan(n);
  complete_ = have_ == size_;
  return complete_ ? Status::Complete : Status::NeedMore;
}

std::span<const std::byte> FrameReader::body() const {
  return {reinterpret_cast<const std::byte*>(buffer_.data()), complete_ ? size_ : 0};
}

const char* name_of(const Body& body) {
  return wire::EnumNameBody(static_cast<wire::Body>(body.index() + 1));
}

const char* name_of(ErrorCode code) {
  const char* name = wire::EnumNameErrorCode(static_cast<wire::ErrorCode>(code));
  return *name ? name : "?";
}

const char* name_of(Recording recording) {
  constexpr const char* kNames[] = {"off", "on", "stopped"};
  return kNames[static_cast<std::size_t>(recording)];
}

}  // namespace incise::protocol
