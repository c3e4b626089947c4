#include "protocol/surface.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <functional>
#include <map>

#include "protocol/coalesce.hpp"
#include "protocol/volume_part.hpp"
#include "tests/protocol/samples.hpp"
#include "tests/protocol/walk.hpp"

namespace incise::protocol {
namespace {

OwnedSurfaceDelta follow(SurfaceReplica& surface, Replica& mesh, TetIndex& index, const Delta& delta) {
  OwnedSurfaceDelta d;
  d.base_revision = delta.base_revision;
  d.revision = delta.revision;
  d.steps = delta.steps;
  d.change = surface.follow(mesh, delta, apply_at_server(mesh, index, delta));
  d.surface_hash = surface.surface_hash();
  d.state_hash = delta.state_hash;
  d.live_tets = delta.live_tets;
  return d;
}

ApplyResult send(const SurfaceReplica& from, SurfaceReplica& to, std::size_t elements) {
  return send_snapshot(SurfaceSnapshotWriter(from, SnapshotCause::Join, elements), to, std::uint64_t{0});
}

TEST(Surface, FollowingDeltasIsTheSameAsLoadingAnew) {
  Walk walk(3, 2, 2);
  Replica mesh = walk.model.replica();
  TetIndex index;
  index.load(mesh);
  SurfaceReplica server, client, late;
  server.load(mesh);
  ApplyResult result = send(server, client, 5);
  ASSERT_TRUE(result) << result.text;
  EXPECT_EQ(client.triangles().size(), mesh.boundary_faces());

  std::vector<OwnedSurfaceDelta> owned;
  for (int i = 0; i < 300; ++i) {
    const OwnedDelta delta = walk.step();
    owned.push_back(follow(server, mesh, index, delta.view()));
    if (i == 100) {
      ASSERT_TRUE(send(server, late, 1000));
    } else if (i > 100) {
      ASSERT_TRUE(late.apply(owned.back().view()));
    }
    Message kept;
    result = client.apply(through_bytes(owned.back().view(), kept));
    ASSERT_TRUE(result) << result.text;
    SurfaceReplica fresh;
    fresh.load(mesh);
    ASSERT_EQ(server.canonical_bytes(), fresh.canonical_bytes()) << "revision " << walk.model.revision;
    ASSERT_EQ(client.surface_hash(), client.compute_surface_hash());
  }
  EXPECT_EQ(client.canonical_bytes(), server.canonical_bytes());
  EXPECT_EQ(late.canonical_bytes(), server.canonical_bytes());

  // All 300 in one.
  SurfaceReplica at_once;
  Replica start = box_model(3, 2, 2).replica();
  at_once.load(start);
  std::vector<SurfaceDelta> views;
  for (const OwnedSurfaceDelta& d : owned) views.push_back(d.view());
  result = at_once.apply(coalesce(std::span<const SurfaceDelta>(views)).view());
  ASSERT_TRUE(result) << result.text;
  EXPECT_EQ(at_once.canonical_bytes(), server.canonical_bytes());
}

}  // namespace

// What PROTOCOL.md says a box holds, found the plain way.
static void expect_part(const SurfaceReplica& part, const SurfaceReplica& whole, const Box& box) {
  IdMap<SurfaceReplica::Triangle> triangles;
  std::map<std::uint32_t, std::array<float, 3>> vertices;
  for (const auto& [id, triangle] : whole.triangles()) {
    std::array<std::array<float, 3>, 3> p;
    for (std::size_t i = 0; i < 3; ++i) p[i] = whole.vertices().at(triangle.vertices[i]).position;
    const auto apart = [&](std::size_t k, double low, double high) {
      const auto all = [&](auto&& f) { return f(p[0][k]) && f(p[1][k]) && f(p[2][k]); };
      return all([&](double x) { return x < low; }) || all([&](double x) { return x > high; });
    };
    if (apart(0, box.min.x, box.max.x) || apart(1, box.min.y, box.max.y) || apart(2, box.min.z, box.max.z))
      continue;
    triangles[id] = triangle;
    for (std::size_t i = 0; i < 3; ++i) vertices[triangle.vertices[i]] = p[i];
  }
  EXPECT_TRUE(part.triangles() == triangles);
  std::map<std::uint32_t, std::array<float, 3>> held;
  for (const auto& [id, vertex] : part.vertices()) held[id] = vertex.position;
  EXPECT_EQ(held, vertices);
  EXPECT_EQ(part.surface_hash(), part.compute_surface_hash());
  EXPECT_EQ(part.revision(), whole.revision());
}

namespace {

struct SurfaceView {
  using Part = SurfaceReplica;
  void load(Replica replica) {
    mesh = std::move(replica);
    whole.load(mesh);
    index.load(mesh);
  }
  MeshChange step(const Delta& delta) {
    MeshChange change(mesh, delta);
    const std::vector<std::uint32_t> in_other_pieces = apply_at_server(mesh, index, delta);
    change.tets.insert(change.tets.end(), in_other_pieces.begin(), in_other_pieces.end());
    whole.follow(mesh, delta, in_other_pieces);
    return change;
  }
  void load_part(Part& part, const Box& box) const { part.load_part(whole, box); }
  SurfaceSnapshotWriter writer(const Part& part, const Box&) const { return {part, SnapshotCause::Join, 7}; }
  OwnedSurfaceDelta follow_part(Part& part, const MeshChange& change, const Box& box) {
    OwnedSurfaceDelta out;
    out.base_revision = change.base_revision;
    out.revision = change.revision;
    out.steps = change.steps;
    out.change = part.follow_part(whole, index, change, box);
    out.surface_hash = part.surface_hash();
    return out;
  }
  void expect_part(const Part& part, const Box& box) const { protocol::expect_part(part, whole, box); }
  static std::vector<std::uint32_t> tets_set(const OwnedSurfaceDelta& d) {
    std::vector<std::uint32_t> tets;
    for (const std::uint32_t id : d.change.triangle_ids) tets.push_back(id / 4);
    return tets;
  }

  Replica mesh;
  SurfaceReplica whole;
  TetIndex index;
};

TEST(Surface, ThePartInABoxIsThatOfTheWhole) {
  follow_boxes(SurfaceView());
}

TEST(Surface, HasTheCutFaceOfBothSides) {
  Replica mesh = samples::two_tets(0).replica();
  SurfaceReplica surface;
  surface.load(mesh);
  EXPECT_EQ(surface.triangles().size(), 6u);
  EXPECT_EQ(surface.vertices().size(), 5u);
  const OwnedDelta cut = difference(samples::two_tets(0), samples::two_tets(1));
  TetIndex index;
  index.load(mesh);
  const SurfaceChange change = follow(surface, mesh, index, cut.view()).change;
  EXPECT_EQ(surface.triangles().size(), 8u);
  EXPECT_EQ(surface.vertices().size(), 8u);
  // Face 0 of tetrahedron 0 and face 3 of tetrahedron 1 are new; the rest of tetrahedron 1 has other
  // vertices.
  EXPECT_EQ(change.triangle_ids, (std::vector<std::uint32_t>{0, 4, 5, 6, 7}));
  EXPECT_EQ(change.triangle_flags, (std::vector<std::uint8_t>{1, 0, 0, 0, 1}));
  EXPECT_EQ(change.triangle_pieces, (std::vector<std::uint32_t>{0, 1, 1, 1, 1}));
  EXPECT_EQ(change.vertex_ids, (std::vector<std::uint32_t>{5, 6, 7}));
  EXPECT_EQ(
      (std::vector<std::uint32_t>{change.triangle_vertices.begin(), change.triangle_vertices.begin() + 3}),
      (std::vector<std::uint32_t>{1, 2, 3}));
}

TEST(Surface, ABadDeltaChangesNothing) {
  Replica mesh = samples::two_tets(0).replica();
  SurfaceReplica server, client;
  server.load(mesh);
  ASSERT_TRUE(send(server, client, 1000));
  const OwnedDelta cut = difference(samples::two_tets(0), samples::two_tets(1));
  TetIndex index;
  index.load(mesh);
  const OwnedSurfaceDelta good = follow(server, mesh, index, cut.view());
  const std::vector<std::byte> before = client.canonical_bytes();

  struct Case {
    const char* what;
    ApplyError error;
    std::function<void(OwnedSurfaceDelta&)> change;
  };
  const Case cases[] = {
      {"another base", ApplyError::WrongBase, [](auto& d) { d.base_revision = 3, d.revision = 4; }},
      {"positions missing", ApplyError::BadShape, [](auto& d) { d.change.vertex_positions.pop_back(); }},
      {"flags missing", ApplyError::BadShape, [](auto& d) { d.change.triangle_flags.pop_back(); }},
      {"out of order", ApplyError::BadIndex,
       [](auto& d) { std::swap(d.change.triangle_ids[0], d.change.triangle_ids[1]); }},
      {"vertex that is not there", ApplyError::BadIndex, [](auto& d) { d.change.triangle_vertices[4] = 99; }},
      {"vertex twice", ApplyError::BadIndex,
       [](auto& d) { d.change.triangle_vertices[4] = d.change.triangle_vertices[3]; }},
      {"vertex twice, first and last", ApplyError::BadIndex,
       [](auto& d) { d.change.triangle_vertices[5] = d.change.triangle_vertices[3]; }},
      {"vertex twice, the latter two", ApplyError::BadIndex,
       [](auto& d) { d.change.triangle_vertices[5] = d.change.triangle_vertices[4]; }},
      {"vertex removed and set", ApplyError::BadIndex, [](auto& d) { d.change.removed_vertices = {5}; }},
      {"triangle removed and set", ApplyError::BadIndex, [](auto& d) { d.change.removed_triangles = {0}; }},
      {"vertex removed that is used", ApplyError::BadIndex, [](auto& d) { d.change.removed_vertices = {0}; }},
      {"another hash", ApplyError::HashMismatch, [](auto& d) { d.surface_hash ^= 1; }},
      {"another position", ApplyError::HashMismatch, [](auto& d) { d.change.vertex_positions[1] += 1; }},
      {"another flag", ApplyError::HashMismatch, [](auto& d) { d.change.triangle_flags[0] ^= 1; }},
      {"triangle missing", ApplyError::HashMismatch, [](auto& d) { d.change.removed_triangles = {1}; }},
  };
  for (const Case& c : cases) {
    OwnedSurfaceDelta bad = good;
    c.change(bad);
    const ApplyResult result = client.apply(bad.view());
    EXPECT_EQ(result.error, c.error) << c.what << ": " << result.text;
    EXPECT_EQ(client.canonical_bytes(), before) << c.what;
  }
  EXPECT_TRUE(client.apply(good.view()));
  EXPECT_EQ(client.canonical_bytes(), server.canonical_bytes());
}

TEST(Surface, ABadSnapshotLeavesTheStateBefore) {
  SurfaceReplica source, client;
  const Replica mesh = box_model(2, 1, 1).replica();
  source.load(mesh);
  client.load(samples::two_tets(0).replica());
  const std::vector<std::byte> before = client.canonical_bytes();
  SurfaceSnapshotWriter writer(source, SnapshotCause::Join, 1000);
  SnapshotBegin volume = writer.begin();
  volume.view = View::Volume;
  EXPECT_EQ(client.begin(volume).error, ApplyError::BadShape);
  EXPECT_EQ(client.chunk({}).error, ApplyError::OutOfOrder);
  ASSERT_TRUE(client.begin(writer.begin()));
  ASSERT_TRUE(writer.next());
  ASSERT_TRUE(client.chunk(writer.chunk()));
  EXPECT_EQ(client.chunks_done(), 1u);
  EXPECT_EQ(client.chunk(writer.chunk()).error, ApplyError::OutOfOrder);  // the same again
  ASSERT_TRUE(client.begin(writer.begin()));
  EXPECT_EQ(client.end(writer.end(0)).error, ApplyError::OutOfOrder);
  EXPECT_EQ(client.canonical_bytes(), before);
}

}  // namespace
}  // namespace incise::protocol
