#include "tests/protocol/samples.hpp"

#include "protocol/surface.hpp"
#include "protocol/volume_part.hpp"
#include "tests/protocol/walk.hpp"

namespace incise::protocol::samples {
namespace {

// A copy that lives as long as the program, for spans to point into.
template <class T>
const T& keep(T value) {
  static std::vector<std::unique_ptr<T>> all;
  all.push_back(std::make_unique<T>(std::move(value)));
  return *all.back();
}
template <class T>
std::span<const T> array(std::initializer_list<T> values) {
  return keep(std::vector<T>(values));
}

TetArrays kept(const TetArrays& t) {
  return {keep(std::vector(t.ids.begin(), t.ids.end())),
          keep(std::vector(t.vertices.begin(), t.vertices.end())),
          keep(std::vector(t.regions.begin(), t.regions.end())),
          keep(std::vector(t.cut_masks.begin(), t.cut_masks.end())),
          keep(std::vector(t.boundary_masks.begin(), t.boundary_masks.end()))};
}

Step step(std::uint64_t revision) {
  Step s;
  s.revision = revision;
  s.source = 2;
  s.stroke = 3;
  s.batch = static_cast<std::uint32_t>(revision);
  s.stroke_ended = revision == 2;
  s.from_heel = {0.0, -0.02, 0.005};
  s.from_tip = {0.0, 0.02, 0.005};
  s.to_heel = {0.01, -0.02, 0.005};
  s.to_tip = {0.01, 0.02, 0.0055};
  s.from_source_ns = 1'000'000'000;
  s.to_source_ns = 1'004'000'000;
  s.arrival_ns = 77'000'000'001;
  s.drain_ns = 77'000'000'500;
  s.cut_ns = 77'000'300'000;
  s.cut_faces = 1;
  s.cut_area_m2 = 8.660254037844386e-05;
  s.snaps = 4;
  s.splits = 5;
  s.min_dihedral_deg = 54.735610317245346;
  s.max_deviation_h = 0.0078125;
  s.state_hash = two_tets(revision).hash();
  return s;
}

const OwnedDelta& delta_to(std::uint64_t revision) {
  OwnedDelta d = difference(two_tets(revision - 1), two_tets(revision));
  d.steps = {step(revision)};
  return keep(std::move(d));
}

const Replica& replica_at(std::uint64_t revision) {
  Replica replica = two_tets(0).replica();
  for (std::uint64_t r = 1; r <= revision; ++r) {
    const ApplyResult applied = replica.apply(delta_to(r).view());
    EXPECT_TRUE(applied) << applied.text;
  }
  return keep(std::move(replica));
}

Welcome welcome() {
  Welcome m;
  m.session = 0x1122334455667788;
  m.role = Role::Operator;
  m.view = View::Volume;
  m.resumed = true;
  m.revision = 2;
  m.state_hash = two_tets(2).hash();
  m.mesh = {"two tetrahedra", "crc32c:0a1b2c3d", 5, 2, 6, 0.01276, {{0, 0, 0}, {0.01, 0.01, 0.01}}};
  m.blade_heel = {0, 0, 0};
  m.blade_tip = {0, 0, -0.05};
  m.source = 2;
  m.engage_button = 0;
  m.max_speed_m_s = 2.5;
  m.frame_rate_hz = 1000;
  m.max_message_bytes = 1u << 20;
  m.server_name = "incised";
  m.server_version = "0.1.0";
  m.server_monotonic_ns = 77'000'000'000;
  m.server_unix_ns = 1'795'000'000'000'000'000;
  m.policy = "conforming";
  return m;
}

Delta coalesced_delta() {
  const std::vector<Delta> both{delta_to(1).view(), delta_to(2).view()};
  OwnedDelta d = coalesce(std::span<const Delta>(both));
  // What only a part has, too.
  for (std::size_t i = 0; i < d.provenance_t.size(); ++i)
    d.added_ids.push_back(d.first_added + static_cast<std::uint32_t>(i));
  d.removed_vertices = {1, 4};
  d.part_hash = 0x1032547698badcfe;
  Delta joined = keep(std::move(d)).view();
  joined.rest_ids = array<std::uint32_t>({0, 8});
  joined.rest_positions = array<double>({-0.0011, 0, 0.0001, 0.0044, 0, 0});
  return joined;
}

SurfaceDelta surface_delta(SurfaceReplica& surface, std::uint64_t revision) {
  OwnedSurfaceDelta d;
  d.base_revision = revision - 1;
  d.revision = revision;
  d.steps = {step(revision)};
  const std::vector<std::uint32_t> cut_off(revision == 1, 1);  // the second tetrahedron
  d.change = surface.follow(replica_at(revision), delta_to(revision).view(), cut_off);
  d.surface_hash = surface.surface_hash();
  d.state_hash = replica_at(revision).state_hash();
  d.live_tets = replica_at(revision).live_tets();
  return keep(std::move(d)).view();
}

SnapshotChunk whole_chunk() {
  const OwnedDelta& d = delta_to(2);
  SurfaceReplica surface;
  surface.load(replica_at(1));
  SurfaceSnapshotWriter writer(surface, SnapshotCause::Join, 1000);
  writer.next();
  SnapshotChunk m;
  m.index = 3;
  m.first_vertex = 2;
  m.positions = replica_at(1).positions();
  std::vector<std::uint32_t> ids(m.positions.size() / 3);
  for (std::size_t i = 0; i < ids.size(); ++i) ids[i] = static_cast<std::uint32_t>(3 * i);
  m.vertex_ids = keep(std::move(ids));
  m.tets = d.view().tets;
  m.tet_pieces = keep(std::vector<std::uint32_t>(d.tet_ids.size(), 9));
  m.surface_vertices = {keep(std::vector(writer.chunk().surface_vertices.ids.begin(),
                                         writer.chunk().surface_vertices.ids.end())),
                        keep(std::vector(writer.chunk().surface_vertices.positions.begin(),
                                         writer.chunk().surface_vertices.positions.end()))};
  m.triangles = {array<std::uint32_t>({0, 7}), array<std::uint32_t>({1, 2, 3, 5, 6, 7}),
                 array<std::uint8_t>({1, 0}), array<std::uint32_t>({0, 1}), array<std::int32_t>({7, -2})};
  m.rest_positions = keep(std::vector<double>(m.positions.size(), 0.125));
  return m;
}

// A square of two triangles, which the texture covers unevenly, and a third beyond a seam, of another material.
SurfaceAsset surface_asset() {
  SurfaceAsset m;
  m.positions = array<double>({0, 0, 0, 0.01, 0, 0, 0.01, 0.01, 0, 0, 0.01, 0, 0.02, 0, -0.005});
  m.triangles = array<std::uint32_t>({0, 1, 2, 3, 0, 2, 1, 4, 2});
  m.uvs = array<float>({0, 0, 0.5f, 0, 0.5f, 0.5f, 0, 0.25f, 0, 0, 0.5f, 0.5f, 0.75f, 0, 1, 0, 0.75f, 1});
  m.normals = array<float>(
      {0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1, 0.5f, 0, 0.5f, 0.5f, 0, 0.5f, 0.5f, 0, 0.5f});
  m.colours =
      array<std::uint8_t>({255, 0,   0, 255, 0,   255, 0, 255, 0, 0, 255, 255, 1,  2,  3,  4,  255, 0,
                           0,   255, 0, 0,   255, 255, 5, 6,   7, 8, 9,   10,  11, 12, 13, 14, 15,  16});
  m.material_indices = array<std::uint32_t>({1, 1, 0});
  m.materials = {{"capsule", {0.5f, 0.25f, 0.125f}, ""}, {"liver", {1, 1, 1}, "1.png"}};
  return m;
}

std::vector<std::pair<std::string, Body>> make_messages() {
  const Box box{{-1, -2, -3}, {1, 2, 3.5}};
  Hello hello;
  hello.role = Role::Operator;
  hello.view = View::Volume;
  hello.client_name = "sample client";
  hello.client_version = "1.2.3";
  hello.token = "not a secret";
  hello.resume_session = 0x1122334455667788;
  hello.resume_revision = 1;
  hello.max_rate_hz = 60;
  hello.box = box;
  hello.source_name = "right hand";
  hello.take_over = true;
  hello.blade_rate_hz = 60;
  hello.blade = BladeEdge{{0, 0, 0.01}, {0.001, 0, -0.05}};

  Force force{2, 1'004'000'000, {0.5, -0.25, 3.125}, 0.0125, {}, true, true, true, {}};
  force.contact = LocalContact{{0.01, 0.02, 0.03}, {0, 0, 1}, 800, 2.5, 0.75, 0.125, 20'000'000, true, {}};

  BladeLoad load;
  load.source = 2;
  load.revision = 2;
  load.source_ns = 1'004'000'000;
  load.server_ns = 77'002'000'000;
  load.contact = BladeContact::Inside;
  load.engaged = true;
  load.heel = {0.01, 0.02, 0.11};
  load.tip = {0.01, 0.02, -0.01};
  load.tool = {0.01, 0.02, 0.12};
  load.force_n = {0.5, -0.25, 3};
  load.torque_n_m = {-0.015, -0.03, 0};
  load.center = {0.01, 0.02, 0.0};
  load.engaged_length_m = 0.0125;
  load.ids = array<std::uint32_t>({0, 4});
  load.forces = array<double>({-0.25, 0.125, -1, -0.25, 0.125, -2});
  load.number = 12;
  load.skipped = 3;

  BladeModel model;
  model.source = 2;
  model.server_ns = 77'002'000'000;
  model.point = {0.01, 0.02, 0.125};
  model.normal = {0, 0, 1};
  model.stiffness = array<double>({100, 0, 0, 0, 100, 0, 0, 0, 400});
  model.damping_n_s_per_m = 0.5;
  model.resistance_n = 2;
  model.valid_for_ns = 50'000'000;

  SurfaceReplica surface;
  surface.load(replica_at(0));

  Positions positions;
  positions.frame = 900;
  positions.revision = 2;
  positions.source_ns = 5;
  positions.ids = array<std::uint32_t>({0, 4, 5});
  positions.first = 0;
  positions.f64 = array<double>({0, 0, -0.001, 0.01, 0.01, 0.009, 0.01, 0, -0.002});

  Stats stats;
  stats.json = R"({"frames":{"p99_us":412.5}})";
  stats.revision = 2;
  stats.live_tets = 3;
  stats.pieces = 2;
  stats.sessions = 4;
  stats.backlog_segments = 1;
  stats.frames = 60000;
  stats.late_frames = 3;
  stats.poses_accepted = 59990;
  stats.poses_rejected = 10;
  stats.frame_work_p99_us = 412.5f;
  stats.pose_to_delta_p99_us = 1530.25f;

  const PoseBatch poses{array<PoseSample>({
      {1'000'000'000, {0.1, 0.2, 0.3}, {1, 0, 0, 0}, 0, 0},
      {1'001'000'000, {0.1001, 0.2, 0.3}, {0.5, -0.5, 0.5, -0.5}, 1, 0},
  })};

  return {
      {"Hello", hello},
      {"Welcome", welcome()},
      {"Subscribe", Subscribe{View::Surface, 30, box}},
      {"Resync", Resync{2, 0xdeadbeefcafef00d, "the hash differs"}},
      {"Ping", Ping{42, 1000}},
      {"Pong", Pong{42, 1000, 2000}},
      {"Error", Error{ErrorCode::BladeTaken, "the blade 'right hand' is held by session 3", true, 1}},
      {"Bye", Bye{ByeReason::TooSlow, "64 MB behind"}},
      {"PoseBatch", poses},
      {"PoseReport", PoseReport{17, 100, 1, 2, 3, 4, 5, 1'001'000'000, 6}},
      {"StrokeControl", StrokeControl{StrokeAction::End, 1'001'000'000}},
      {"Force", force},
      {"Delta", coalesced_delta()},
      {"SurfaceDelta", surface_delta(surface, 1)},
      {"SnapshotBegin", SnapshotBegin{View::Surface,
                                      2,
                                      SnapshotCause::Resync,
                                      4,
                                      8,
                                      3,
                                      12,
                                      box,
                                      array<std::uint32_t>({1, 4}),
                                      array<std::uint32_t>({1, 2}),
                                      {}}},
      {"SnapshotChunk", whole_chunk()},
      {"SnapshotEnd", SnapshotEnd{2, two_tets(2).hash(), 0x0123456789abcdef, 0xfedcba9876543210}},
      {"Positions", positions},
      {"Stats", stats},
      {"Reset", Reset{}},
      {"ReplayControl", ReplayControl{ReplayAction::Seek, "liver-1.incise", 0.5f, 77}},
      {"ReplayState", ReplayState{"liver-1.incise", true, 0.5f, 77, 900, "playing", {}, {}, {}}},
      {"BladePose",
       BladePose{2, true, {0.01, 0.02, 0.11}, {0.01, 0.02, -0.01}, 77'001'000'000, std::nullopt}},
      {"PositionsReport", PositionsReport{900, 3, 4, 1, array<std::uint32_t>({2, 6}), 77, 5}},
      {"SurfaceAsset", surface_asset()},
      {"Undo", Undo{}},
      {"BladeLoad", load},
      {"BladeModel", model},
      {"FieldValues", FieldValues{1, 3, array<float>({36.5f, -0.25f, 1e-6f, 0, 37, 2}), {}, 2, true}},
  };
}

}  // namespace

Model two_tets(std::uint64_t revision) {
  Model m;
  m.positions = {{0, 0, 0}, {0.01, 0, 0}, {0, 0.01, 0}, {0, 0, 0.01}, {0.01, 0.01, 0.01}};
  m.tets[0] = {{0, 1, 2, 3}, 7, 0, 0b1110, 0};
  m.tets[1] = {{1, 2, 3, 4}, -2, 0, 0b0111, 0};
  m.next_tet = 2;
  if (revision >= 1) {
    m.revision = 1;
    for (std::uint32_t v = 1; v <= 3; ++v) {
      m.origins[4 + v] = {v, v, 0};
      m.positions.push_back(m.positions[v]);
    }
    m.tets[0] = {{0, 1, 2, 3}, 7, 0b0001, 0b1111, 0};
    m.tets[1] = {{5, 6, 7, 4}, -2, 0b1000, 0b1111, 1};
    m.names[1] = 1;
    m.next_piece = 2;
  }
  if (revision >= 2) {
    m.revision = 2;
    m.positions[0] = {-0.001, 0, 0};
    m.origins[8] = {0, 1, 0.5};
    m.positions.push_back({0.0045, 0, 0});
    m.tets[0] = {{0, 8, 2, 3}, 7, 0, 0b1110, 0};
    m.tets[2] = {{8, 1, 2, 3}, 7, 0b0001, 0b1101, 0};
    m.next_tet = 3;
  }
  return m;
}

const std::vector<std::pair<std::string, Body>>& messages() {
  static const auto all = make_messages();
  return all;
}

const std::vector<std::pair<std::string, Body>>& extended_messages() {
  static const auto all = [] {
    Welcome hail = welcome();
    hail.recording = Recording::On;
    Hello back = std::get<Hello>(messages()[0].second);
    back.resume_hash = 0x8877665544332211;
    Stats stats;
    stats.json = "{}";
    Force torque = std::get<Force>(messages()[11].second);
    torque.torque_n_m = Vec3{0.01, -0.02, 0.03};
    torque.contact->arm = Vec3{0.001, 0.002, -0.05};
    BladePose felt{2, false, {0.01, 0.02, 0.11}, {0.01, 0.02, -0.01}, 77'001'000'000, Vec3{0.5, -0.25, 2}};
    Hello loads = std::get<Hello>(messages()[0].second);
    loads.role = Role::Simulator;
    loads.load_rate_hz = 250;
    stats.recording = Recording::Stopped;
    Welcome filled = hail;
    filled.surface = SurfaceFacts{3600, "/surface", std::string(64, 'c')};
    SurfaceReplica surface;
    surface.load(replica_at(0));
    SurfaceDelta delta = surface_delta(surface, 1);
    std::vector<std::uint32_t> origins;
    for (std::size_t i = 0; i < delta.triangles.ids.size(); ++i)
      origins.push_back(delta.triangles.flags[i] == kTriangleCut ? kNoId
                                                                 : static_cast<std::uint32_t>(100 + i));
    delta.triangles.origins = keep(std::move(origins));
    delta.rest = {array<std::uint32_t>({1, 5}), array<float>({0.01f, 0, 0.001f, 0.01f, 0.002f, 0})};
    SnapshotChunk chunk = whole_chunk();
    chunk.triangles.origins = array<std::uint32_t>({kNoId, 3599});
    chunk.surface_rest = {array<std::uint32_t>({2}), array<float>({0.25f, 0.5f, 0.75f})};
    Delta blended = coalesced_delta();
    blended.blend_ids = array<std::uint32_t>({2, 7, 1, 8});
    blended.blend_vertices = array<std::uint32_t>({2, 0, 1, 3, 4, 1, 2, 3, 1, 0, 2, 3, 5, 4, 6, 7});
    blended.blend_weights = array<double>(
        {0.5, 0.25, 0.125, 0.125, 1.25, -0.125, 0, -0.125, 0.75, 0.25, 0, 0, 0.5, 0.5, 0.25, -0.25});
    blended.round_added = array<std::uint32_t>({3, 1});
    blended.round_blends = array<std::uint32_t>({2, 2});
    blended.tet_elders = array<std::uint32_t>({0});
    const std::vector<FieldFacts> fields = {{"temperature", FieldOn::Vertices, 1, false},
                                            {"fibres", FieldOn::Tets, 3, false},
                                            {"label", FieldOn::Tets, 1, true}};
    Hello wanting = std::get<Hello>(messages()[0].second);
    wanting.fields = {"temperature", "*"};
    Welcome carrying = hail;
    carrying.fields = fields;
    Welcome undone = hail;
    undone.restart = Restart{RestartKind::Undo, Role::Admin, "ward 3", 2, "right hand"};
    Welcome both = hail;
    both.restart = Restart{RestartKind::Undo, Role::Operator, "left", 1, "left", {"right", "assistant"}};
    Stats hands = stats;
    hands.blades = {{0, "left hand", 4000, 3, 2, 310, true}, {2, "right hand", 12, 0, 0, 0, false}};
    return std::vector<std::pair<std::string, Body>>{
        {"WelcomeRecording", hail},
        {"PoseReportRecorded",
         PoseReport{17, 100, 1, 2, 3, 4, 5, 1'001'000'000, 6, 90, 991'000'000, Recording::Stopped}},
        {"ErrorNotRecorded",
         Error{ErrorCode::NotRecorded, "poses are cut, but not recorded: No space left on device", false, 0}},
        {"StatsRecording", stats},
        {"HelloResumeHash", back},
        {"WelcomeSurface", filled},
        {"SurfaceDeltaOrigins", delta},
        {"SnapshotChunkOrigins", chunk},
        {"ForceTorque", torque},
        {"HelloLoadRate", loads},
        {"DeltaBlends", blended},
        {"HelloFields", wanting},
        {"WelcomeFields", carrying},
        {"SubscribeFields", Subscribe{View::Volume, 0, std::nullopt, {"label"}}},
        {"SnapshotBeginFields", SnapshotBegin{View::Volume,
                                              2,
                                              SnapshotCause::Join,
                                              1,
                                              8,
                                              3,
                                              12,
                                              std::nullopt,
                                              {},
                                              {},
                                              array<std::uint32_t>({0, 2})}},
        {"FieldValuesWhole", FieldValues{2, 0, {}, array<std::int32_t>({1, -2, 3}), 0, false}},
        {"ReplayTimeline",
         ReplayState{"liver-1.incise", false, 1, 0, 4, "", {20, 40, 40, 90}, {0, 0, 2, 0}, {1, 1, 2, 0}}},
        {"BladePoseForce", felt},
        {"WelcomeRestart", undone},
        {"StatsBlades", hands},
        {"UndoOthers", Undo{true}},
        {"WelcomeRestartOthers", both},
    };
  }();
  return all;
}

std::vector<Body> volume_stream() {
  Welcome hail = welcome();
  hail.role = Role::Viewer;
  hail.resumed = false;
  hail.revision = 0;
  hail.state_hash = two_tets(0).hash();
  SnapshotWriter writer(replica_at(0), SnapshotCause::Join, 1000);
  std::vector<Body> out{hail, writer.begin()};
  while (writer.next()) {
    SnapshotChunk part = writer.chunk();
    part.tets = kept(part.tets);
    part.tet_pieces = keep(std::vector(part.tet_pieces.begin(), part.tet_pieces.end()));
    out.push_back(part);
  }
  out.push_back(writer.end());
  out.push_back(delta_to(1).view());
  out.push_back(delta_to(2).view());
  out.push_back(Bye{ByeReason::ServerStops, "the server stops"});
  return out;
}

std::vector<Body> surface_stream() {
  Welcome hail = welcome();
  hail.role = Role::Viewer;
  hail.view = View::Surface;
  hail.resumed = false;
  hail.revision = 0;
  hail.state_hash = two_tets(0).hash();
  SurfaceReplica surface;
  surface.load(replica_at(0));
  SurfaceSnapshotWriter writer(surface, SnapshotCause::Join, 1000);
  std::vector<Body> out{hail, writer.begin()};
  while (writer.next()) {
    SnapshotChunk part = writer.chunk();
    const auto& v = part.surface_vertices;
    const auto& t = part.triangles;
    part.surface_vertices = {keep(std::vector(v.ids.begin(), v.ids.end())),
                             keep(std::vector(v.positions.begin(), v.positions.end()))};
    part.triangles = {keep(std::vector(t.ids.begin(), t.ids.end())),
                      keep(std::vector(t.vertices.begin(), t.vertices.end())),
                      keep(std::vector(t.flags.begin(), t.flags.end())),
                      keep(std::vector(t.pieces.begin(), t.pieces.end())),
                      keep(std::vector(t.regions.begin(), t.regions.end()))};
    out.push_back(part);
  }
  out.push_back(writer.end(two_tets(0).hash()));
  out.push_back(surface_delta(surface, 1));
  out.push_back(surface_delta(surface, 2));
  out.push_back(Bye{ByeReason::ServerStops, "the server stops"});
  return out;
}

std::vector<Body> volume_part_stream() {
  Welcome hail = welcome();
  hail.role = Role::Viewer;
  hail.view = View::Volume;
  hail.resumed = false;
  hail.revision = 0;
  hail.state_hash = two_tets(0).hash();
  // Around vertex 4: the second tetrahedron alone.
  Replica whole = two_tets(0).replica();
  TetIndex index;
  index.load(whole);
  const Vec3 at = whole.position(4);
  const Box box{{at.x - 1e-3, at.y - 1e-3, at.z - 1e-3}, {at.x + 1e-3, at.y + 1e-3, at.z + 1e-3}};
  VolumePart part;
  part.load_part(whole, box);
  VolumePartWriter writer(part, box, SnapshotCause::Join, 1000);
  std::vector<Body> out{hail, writer.begin()};
  while (writer.next()) {
    SnapshotChunk chunk = writer.chunk();
    chunk.vertex_ids = keep(std::vector(chunk.vertex_ids.begin(), chunk.vertex_ids.end()));
    chunk.positions = keep(std::vector(chunk.positions.begin(), chunk.positions.end()));
    chunk.tets = kept(chunk.tets);
    chunk.tet_pieces = keep(std::vector(chunk.tet_pieces.begin(), chunk.tet_pieces.end()));
    out.push_back(chunk);
  }
  out.push_back(writer.end(two_tets(0).hash()));
  for (std::uint64_t r = 1; r <= 2; ++r) {
    const Delta delta = delta_to(r).view();
    MeshChange change(whole, delta);
    for (const std::uint32_t t : apply_at_server(whole, index, delta)) change.tets.push_back(t);
    out.push_back(keep(part.follow_part(whole, index, change, box)).view());
  }
  out.push_back(Bye{ByeReason::ServerStops, "the server stops"});
  return out;
}

CaptureHeader capture_header() {
  return {"meshes/two_tets.node",    "crc32c:0a1b2c3d", 0x1122334455667788,
          1'795'000'000'000'000'000, "incised 0.1.0",   R"({"frame_hz":1000})"};
}

std::vector<CaptureRecord> capture_records() {
  return {
      PoseRecord{2, {1'000'000'000, {0.1, 0.2, 0.3}, {0.5, -0.5, 0.5, -0.5}, 1, 0}, 77'000'000'001},
      StrokeRecord{2, StrokeAction::End, 1'001'000'000, 77'001'000'001},
      BatchMark{1, two_tets(1).hash(), 2, 3, 1, true, 77001},
      NoteRecord{R"({"late_frames":0})"},
      GapRecord{12, 1068, 77'002'000'000, 77'003'000'000, "No space left on device"},
      CheckpointRecord{0x0f1e2d3c4b5a6978},
      PositionsRecord{900, 1, 5, 77'004'000'000, 0, {0, 4}, {0, 0, -0.001, 0.01, 0.01, 0.009}},
      ResetRecord{0x99aabbccddeeff00, 77'005'000'000},
      BladeRecord{2, 77'006'000'000, {{0, 0, 0.01}, {0.001, 0, -0.05}}},
      UndoRecord{0x8899aabbccddeeff, 77'007'000'000, 2, 1'000'000'000, 77'000'000'001, 3},
      EndRecord{10},
  };
}

}  // namespace incise::protocol::samples
