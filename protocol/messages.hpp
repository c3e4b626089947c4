#pragma once

// The messages of incise.fbs as plain structs, for senders and receivers in C++. Arrays are spans: a sender
// points them at what it has, a receiver finds them pointing into the message's bytes. The schema and
// PROTOCOL.md say what each field means; comments here add only what C++ users need.
//
// Flat arrays: positions hold x y z for each vertex, tetrahedra four ids, triangles three.

#include <array>
#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <variant>
#include <vector>

namespace incise::protocol {

inline constexpr std::uint32_t kProtocolVersion = 2;
// Says pieces in another way, and only in view Volume: a server speaks it with clients that do not want that.
inline constexpr std::uint32_t kOldProtocolVersion = 1;
inline constexpr std::uint32_t kNoId = 0xffffffffu;

struct Vec3 {
  double x = 0, y = 0, z = 0;
  friend bool operator==(const Vec3&, const Vec3&) = default;
};

struct Quat {
  double w = 1, x = 0, y = 0, z = 0;
  friend bool operator==(const Quat&, const Quat&) = default;
};

// world_from_tool at one moment of the source's clock.
struct PoseSample {
  std::int64_t source_ns = 0;
  Vec3 position;     // metres
  Quat orientation;  // unit
  std::uint32_t buttons = 0;
  std::uint32_t reserved = 0;
  friend bool operator==(const PoseSample&, const PoseSample&) = default;
};
static_assert(sizeof(PoseSample) == 72, "the schema's struct, byte for byte");

struct Box {
  Vec3 min, max;
  friend bool operator==(const Box&, const Box&) = default;
};

// A blade in the tool's frame, metres.
struct BladeEdge {
  Vec3 heel, tip;
  friend bool operator==(const BladeEdge&, const BladeEdge&) = default;
};

enum class Role : std::uint8_t { Viewer, Operator, Simulator, Admin };
enum class View : std::uint8_t { None, Surface, Volume };
enum class Recording : std::uint8_t { Off, On, Stopped };

enum class FieldOn : std::uint8_t { Vertices, Tets };
struct FieldFacts {
  std::string name;
  FieldOn on = FieldOn::Vertices;
  std::uint32_t components = 1;
  bool whole = false;
  friend bool operator==(const FieldFacts&, const FieldFacts&) = default;
};

struct Hello {
  std::uint32_t protocol_version = kProtocolVersion;
  Role role = Role::Viewer;
  View view = View::None;
  std::string client_name, client_version;
  std::string token;
  std::uint64_t resume_session = 0;
  std::uint64_t resume_revision = 0;
  float max_rate_hz = 0;
  std::optional<Box> box;
  std::string source_name;
  bool take_over = false;
  float blade_rate_hz = 0;
  std::optional<BladeEdge> blade;
  std::uint64_t resume_hash = 0;  // Welcome's or a delta's state_hash at resume_revision; 0: not known
  float load_rate_hz = 0;
  std::vector<std::string> fields;
};

struct MeshFacts {
  std::string name, content_hash;
  std::uint32_t vertices = 0, tets = 0, boundary_faces = 0;
  double mean_edge_length_m = 0;
  Box box;
};

struct SurfaceFacts {
  std::uint32_t triangles = 0;
  std::string path, content_hash;
};

enum class RestartKind : std::uint8_t { None, Reset, Undo };

struct Restart {
  RestartKind kind = RestartKind::None;
  Role role = Role::Viewer;
  std::string by;
  std::uint32_t source = 0;
  std::string blade;
  std::vector<std::string> others = {};
  friend bool operator==(const Restart&, const Restart&) = default;
};

struct Welcome {
  std::uint32_t protocol_version = kProtocolVersion;
  std::uint64_t session = 0;
  Role role = Role::Viewer;
  View view = View::None;
  bool resumed = false;
  std::uint64_t revision = 0;
  std::uint64_t state_hash = 0;
  MeshFacts mesh;
  Vec3 blade_heel, blade_tip;
  std::uint32_t source = 0;
  std::int32_t engage_button = -1;
  double max_speed_m_s = 0;
  double frame_rate_hz = 0;
  std::uint32_t max_message_bytes = 0;
  std::string server_name, server_version;
  std::int64_t server_monotonic_ns = 0;
  std::int64_t server_unix_ns = 0;
  std::string policy;
  Recording recording = Recording::Off;
  std::optional<SurfaceFacts> surface;
  std::vector<FieldFacts> fields;
  std::optional<Restart> restart;
};

struct Subscribe {
  View view = View::None;
  float max_rate_hz = 0;
  std::optional<Box> box;
  std::vector<std::string> fields = {};
};

struct Resync {
  std::uint64_t revision = 0;
  std::uint64_t hash = 0;
  std::string reason;
};

struct Ping {
  std::uint64_t nonce = 0;
  std::int64_t sent_ns = 0;
};

struct Pong {
  std::uint64_t nonce = 0;
  std::int64_t ping_sent_ns = 0;
  std::int64_t received_ns = 0;
};

enum class ErrorCode : std::uint16_t {
  Unknown,
  BadFrame,
  TooLong,
  BadVersion,
  BadState,
  Unauthorized,
  Forbidden,
  BladeTaken,
  UnknownSource,
  TooManySessions,
  RateExceeded,
  NotAvailable,
  BadRequest,
  Internal,
  NotRecorded,
};

struct Error {
  ErrorCode code = ErrorCode::Unknown;
  std::string text;
  bool fatal = false;
  std::uint64_t in_reply_to = 0;
};

enum class ByeReason : std::uint8_t {
  Unknown,
  Done,
  ServerStops,
  TooSlow,
  Idle,
  HandshakeTimeout,
  HandedOver,
  Refused,
};

struct Bye {
  ByeReason reason = ByeReason::Unknown;
  std::string text;
};

struct PoseBatch {
  std::span<const PoseSample> poses;
};

struct PoseReport {
  std::uint64_t through_sequence = 0;
  std::uint64_t accepted = 0, not_finite = 0, not_unit = 0, time_not_rising = 0, queue_full = 0, too_fast = 0;
  std::int64_t last_source_ns = 0;
  std::uint32_t backlog_segments = 0;
  std::uint64_t recorded = 0;
  std::int64_t recorded_source_ns = 0;
  Recording recording = Recording::Off;
};

enum class StrokeAction : std::uint8_t { Engage, End, HandOver };

struct StrokeControl {
  StrokeAction action = StrokeAction::Engage;
  std::int64_t source_ns = 0;
};

struct LocalContact {
  Vec3 point;
  Vec3 normal{0, 0, 1};
  double stiffness_n_per_m = 0;
  double damping_n_s_per_m = 0;
  double cutting_resistance_n = 0;
  double friction_n_s_per_m = 0;
  std::int64_t valid_for_ns = 0;
  bool penetrated = false;
  std::optional<Vec3> arm;
};

struct Force {
  std::uint32_t source = 0;
  std::int64_t source_ns = 0;
  Vec3 force_n;
  double engaged_length_m = 0;
  std::optional<LocalContact> contact;
  bool saturated = false;
  bool ramping = false;
  bool latched_off = false;
  std::optional<Vec3> torque_n_m;
};

struct TetArrays {
  std::span<const std::uint32_t> ids;
  std::span<const std::uint32_t> vertices;
  std::span<const std::int32_t> regions;
  std::span<const std::uint8_t> cut_masks;
  std::span<const std::uint8_t> boundary_masks;
};

struct TriangleArrays {
  std::span<const std::uint32_t> ids;  // half-faces
  std::span<const std::uint32_t> vertices;
  std::span<const std::uint8_t> flags;
  std::span<const std::uint32_t> pieces;
  std::span<const std::int32_t> regions;
  std::span<const std::uint32_t> origins = {};  // empty: none has one
};
inline constexpr std::uint8_t kTriangleCut = 1;  // TriangleArrays::flags: a cut face

struct SurfaceVertexArrays {
  std::span<const std::uint32_t> ids;
  std::span<const float> positions;
};

struct Step {
  std::uint64_t revision = 0;
  std::uint32_t source = 0, stroke = 0, batch = 0;
  bool stroke_ended = false;
  Vec3 from_heel, from_tip, to_heel, to_tip;
  std::int64_t from_source_ns = 0, to_source_ns = 0;
  std::int64_t arrival_ns = 0, drain_ns = 0, cut_ns = 0;
  std::uint32_t cut_faces = 0;
  double cut_area_m2 = 0;
  std::uint32_t snaps = 0, splits = 0;
  double min_dihedral_deg = 180;
  double max_deviation_h = 0;
  std::uint64_t state_hash = 0;
  friend bool operator==(const Step&, const Step&) = default;
};

struct Delta {
  std::uint64_t base_revision = 0, revision = 0;
  std::vector<Step> steps;
  std::span<const std::uint32_t> moved_ids;
  std::span<const double> moved_positions;
  std::uint32_t first_added = 0;
  std::span<const double> added_positions;
  std::span<const std::uint32_t> provenance_a, provenance_b;
  std::span<const double> provenance_t;
  TetArrays tets;
  std::span<const std::uint32_t> removed_tets;
  std::span<const std::uint32_t> boundary_upserted, boundary_removed;
  std::span<const std::uint32_t> piece_ids, piece_sizes, piece_tets, piece_names;
  std::uint32_t vertex_count = 0;
  std::uint32_t live_tets = 0;
  std::uint64_t state_hash = 0;
  std::uint32_t first_new_tet = 0;
  std::span<const std::uint32_t> added_ids, removed_vertices;
  std::uint64_t part_hash = 0;
  std::span<const std::uint32_t> rest_ids;
  std::span<const double> rest_positions;
  std::span<const std::uint32_t> blend_ids, blend_vertices;
  std::span<const double> blend_weights;
  std::span<const std::uint32_t> round_added, round_blends;
  std::span<const std::uint32_t> tet_elders;
};

struct SurfaceDelta {
  std::uint64_t base_revision = 0, revision = 0;
  std::vector<Step> steps;
  SurfaceVertexArrays vertices;
  std::span<const std::uint32_t> removed_vertices;
  TriangleArrays triangles;
  std::span<const std::uint32_t> removed_triangles;
  std::uint64_t surface_hash = 0;
  std::uint64_t state_hash = 0;
  std::uint32_t live_tets = 0;
  SurfaceVertexArrays rest = {};
};

enum class SnapshotCause : std::uint8_t { Join, ResumeGone, Resync, TooSlow, Reset, Subscribe };

struct SnapshotBegin {
  View view = View::Volume;
  std::uint64_t revision = 0;
  SnapshotCause cause = SnapshotCause::Join;
  std::uint32_t chunks = 0;
  std::uint32_t vertex_count = 0, tet_count = 0, triangle_count = 0;
  std::optional<Box> box;
  std::span<const std::uint32_t> piece_ids, piece_names, fields;
};

struct SnapshotChunk {
  std::uint32_t index = 0;
  std::uint32_t first_vertex = 0;
  std::span<const double> positions;
  TetArrays tets;
  std::span<const std::uint32_t> tet_pieces;
  SurfaceVertexArrays surface_vertices;
  TriangleArrays triangles;
  std::span<const std::uint32_t> vertex_ids;
  std::span<const double> rest_positions;
  SurfaceVertexArrays surface_rest;
};

struct SnapshotEnd {
  std::uint64_t revision = 0;
  std::uint64_t state_hash = 0;
  std::uint64_t surface_hash = 0;
  std::uint64_t part_hash = 0;
};

struct Positions {
  std::uint64_t frame = 0;
  std::uint64_t revision = 0;
  std::int64_t source_ns = 0;
  std::span<const std::uint32_t> ids;
  std::uint32_t first = 0;
  std::span<const float> f32;
  std::span<const double> f64;
};

struct BladeStats {
  std::uint32_t source = 0;
  std::string name;
  std::uint64_t poses = 0, rejected = 0;
  std::uint32_t strokes = 0;
  std::uint64_t cut_faces = 0;
  bool in_stroke = false;
};

struct Stats {
  std::string json;
  std::uint64_t revision = 0;
  std::uint32_t live_tets = 0, pieces = 0, sessions = 0, backlog_segments = 0;
  std::uint64_t frames = 0, late_frames = 0, poses_accepted = 0, poses_rejected = 0;
  float frame_work_p99_us = 0, pose_to_delta_p99_us = 0;
  Recording recording = Recording::Off;
  std::uint32_t undoable = 0;
  std::vector<BladeStats> blades;
};

struct Reset {};

// An operator's or admin's: back to the state before the last stroke that cut something.
struct Undo {
  bool others = false;
};

enum class ReplayAction : std::uint8_t { Open, Play, Pause, Step, Seek, Close };

struct ReplayControl {
  ReplayAction action = ReplayAction::Open;
  std::string capture;
  float speed = 1;
  std::uint64_t revision = 0;
};

struct ReplayState {
  std::string capture;
  bool playing = false;
  float speed = 1;
  std::uint64_t revision = 0, last_revision = 0;
  std::string text;
  std::vector<std::uint32_t> revision_ms, revision_sources, revision_strokes;  // one entry each, or none
};

struct BladePose {
  std::uint32_t source = 0;
  bool cutting = false;
  Vec3 heel, tip;
  std::int64_t arrival_ns = 0;
  std::optional<Vec3> force_n;
};

struct PositionsReport {
  std::uint64_t frame = 0, revision = 0;
  std::uint32_t moved = 0, passed_over = 0;
  std::span<const std::uint32_t> held;
  std::uint64_t taken = 0, skipped = 0;
};

struct Material {
  std::string name;
  std::array<float, 3> diffuse{0.8f, 0.8f, 0.8f};
  std::string texture;
  friend bool operator==(const Material&, const Material&) = default;
};

struct SurfaceAsset {
  std::span<const double> positions;
  std::span<const std::uint32_t> triangles;
  std::span<const float> uvs, normals;
  std::span<const std::uint8_t> colours;
  std::span<const std::uint32_t> material_indices;
  std::vector<Material> materials;
};

enum class BladeContact : std::uint8_t { None, Presses, Inside };

struct BladeLoad {
  std::uint32_t source = 0;
  std::uint64_t revision = 0;
  std::int64_t source_ns = 0, server_ns = 0;
  BladeContact contact = BladeContact::None;
  bool engaged = false;
  Vec3 heel, tip, tool;
  Vec3 force_n, torque_n_m, center;
  double engaged_length_m = 0;
  std::span<const std::uint32_t> ids;
  std::span<const double> forces;
  std::uint64_t number = 0, skipped = 0;
};

struct BladeModel {
  std::uint32_t source = 0;
  std::int64_t server_ns = 0;
  Vec3 point, normal{0, 0, 1};  // as they came: not checked
  std::span<const double> stiffness;
  double damping_n_s_per_m = 0, resistance_n = 0;
  std::int64_t valid_for_ns = 0;
};

struct FieldValues {
  std::uint32_t field = 0, first = 0;
  std::span<const float> f32;
  std::span<const std::int32_t> i32;
  std::uint64_t revision = 0;
  bool last = false;
};

// In the order of the schema's union (whose 0 is "none"): index() + 1 is the type on the wire.
using Body = std::variant<Hello, Welcome, Subscribe, Resync, Ping, Pong, Error, Bye, PoseBatch, PoseReport,
                          StrokeControl, Force, Delta, SurfaceDelta, SnapshotBegin, SnapshotChunk,
                          SnapshotEnd, Positions, Stats, Reset, ReplayControl, ReplayState, BladePose,
                          PositionsReport, SurfaceAsset, Undo, BladeLoad, BladeModel, FieldValues>;

// The message's name as in the schema, e.g. "PoseBatch".
const char* name_of(const Body& body);
// The code's name as in the schema, e.g. "BadFrame"; "?" for an unknown number.
const char* name_of(ErrorCode code);
// "off", "on" or "stopped".
const char* name_of(Recording recording);

}  // namespace incise::protocol
