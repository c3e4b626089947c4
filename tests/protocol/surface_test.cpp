#include "protocol/surface.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <functional>
#include <map>
#include <random>

#include "protocol/coalesce.hpp"
#include "protocol/framing.hpp"
#include "tests/protocol/model.hpp"
#include "tests/protocol/samples.hpp"

namespace incise::protocol {
namespace {

OwnedSurfaceDelta follow(SurfaceReplica& surface, const Replica& mesh, const Delta& delta) {
  OwnedSurfaceDelta d;
  d.base_revision = delta.base_revision;
  d.revision = delta.revision;
  d.steps = delta.steps;
  d.change = surface.follow(mesh, delta);
  d.surface_hash = surface.surface_hash();
  d.state_hash = delta.state_hash;
  d.live_tets = delta.live_tets;
  return d;
}

ApplyResult send_snapshot(const SurfaceReplica& from, SurfaceReplica& to, std::size_t elements) {
  SurfaceSnapshotWriter writer(from, SnapshotCause::Join, elements);
  ApplyResult result = to.begin(writer.begin());
  while (result && writer.next()) {
    const Frame frame = encode(writer.chunk());
    const DecodeResult decoded = decode(frame.body());
    EXPECT_TRUE(decoded) << decoded.error;
    result = to.chunk(std::get<SnapshotChunk>(decoded.message->body));
  }
  return result ? to.end(writer.end(0)) : result;
}

TEST(Surface, FollowingDeltasIsTheSameAsLoadingAnew) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937_64 random(seed);
  Model model = box_model(3, 2, 2);
  Replica mesh = model.replica();
  SurfaceReplica server, client, late;
  server.load(mesh);
  ApplyResult result = send_snapshot(server, client, 5);
  ASSERT_TRUE(result) << result.text;
  EXPECT_EQ(client.triangles().size(), mesh.boundary_faces());

  std::vector<OwnedSurfaceDelta> owned;
  for (int i = 0; i < 300; ++i) {
    const Model before = model;
    mutate(model, random);
    const OwnedDelta delta = difference(before, model);
    ASSERT_TRUE(mesh.apply(delta.view()));
    owned.push_back(follow(server, mesh, delta.view()));
    if (i == 100) {
      ASSERT_TRUE(send_snapshot(server, late, 1000));
    } else if (i > 100) {
      ASSERT_TRUE(late.apply(owned.back().view()));
    }
    const Frame frame = encode(owned.back().view());
    const DecodeResult decoded = decode(frame.body());
    ASSERT_TRUE(decoded) << decoded.error;
    result = client.apply(std::get<SurfaceDelta>(decoded.message->body));
    ASSERT_TRUE(result) << result.text;
    SurfaceReplica anew;
    anew.load(mesh);
    ASSERT_EQ(server.canonical_bytes(), anew.canonical_bytes()) << "revision " << model.revision;
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

// What PROTOCOL.md says a box holds, found the plain way.
void expect_part(const SurfaceReplica& part, const SurfaceReplica& whole, const Box& box) {
  std::map<std::uint32_t, SurfaceReplica::Triangle> triangles;
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
  EXPECT_EQ(part.triangles(), triangles);
  std::map<std::uint32_t, std::array<float, 3>> held;
  for (const auto& [id, vertex] : part.vertices()) held[id] = vertex.position;
  EXPECT_EQ(held, vertices);
  EXPECT_EQ(part.surface_hash(), part.compute_surface_hash());
  EXPECT_EQ(part.revision(), whole.revision());
}

// Boxes of any size and place, each followed by deltas over a number of steps of its own.
TEST(Surface, ThePartInABoxIsThatOfTheWhole) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937_64 random(seed);
  Model model = box_model(3, 2, 2);
  Replica mesh = model.replica();
  SurfaceReplica whole;
  whole.load(mesh);
  SurfaceIndex index;
  index.load(whole);
  Vec3 low{1e9, 1e9, 1e9}, high{-1e9, -1e9, -1e9};
  for (std::uint32_t v = 0; v < mesh.vertex_count(); ++v) {
    const Vec3 p = mesh.position(v);
    low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
    high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
  }
  struct Part {
    Box box;
    int every;
    SurfaceReplica server, client;
    std::vector<OwnedSurfaceDelta> since;
  };
  std::vector<Part> parts(12);
  int moved_in = 0;
  for (std::size_t i = 0; i < parts.size(); ++i) {
    const auto between = [&](double a, double b) {
      double x = std::uniform_real_distribution<double>(a, b)(random),
             y = std::uniform_real_distribution<double>(a, b)(random);
      return std::pair(std::min(x, y), std::max(x, y));
    };
    const auto [x0, x1] = between(low.x, high.x);
    const auto [y0, y1] = between(low.y, high.y);
    const auto [z0, z1] = between(low.z, high.z);
    parts[i].box = {{x0, y0, z0}, {x1, y1, z1}};
    if (i == 0) parts[i].box = {low, low};  // a corner: the bounds count
    parts[i].every = 1 + static_cast<int>(i % 5);
    parts[i].server.load_part(whole, parts[i].box);
    ASSERT_TRUE(send_snapshot(parts[i].server, parts[i].client, 7));
  }
  EXPECT_FALSE(parts[0].client.triangles().empty());
  for (int i = 0; i < 300; ++i) {
    const Model before = model;
    mutate(model, random);
    const OwnedDelta delta = difference(before, model);
    ASSERT_TRUE(mesh.apply(delta.view()));
    const OwnedSurfaceDelta step = follow(whole, mesh, delta.view());
    index.add(whole, step.change.triangles());
    for (Part& part : parts) {
      part.since.push_back(step);
      if ((i + 1) % part.every != 0) continue;
      std::vector<SurfaceDelta> views;
      for (const OwnedSurfaceDelta& d : part.since) views.push_back(d.view());
      const OwnedSurfaceDelta all = coalesce(std::span<const SurfaceDelta>(views));
      OwnedSurfaceDelta sent = all;
      sent.change = part.server.follow_part(whole, index, all.view(), part.box);
      sent.surface_hash = part.server.surface_hash();
      part.since.clear();
      for (const std::uint32_t id : sent.change.triangle_ids)
        moved_in += std::find(all.change.triangle_ids.begin(), all.change.triangle_ids.end(), id) ==
                    all.change.triangle_ids.end();
      const Frame frame = encode(sent.view());
      const DecodeResult decoded = decode(frame.body());
      ASSERT_TRUE(decoded) << decoded.error;
      const ApplyResult result = part.client.apply(std::get<SurfaceDelta>(decoded.message->body));
      ASSERT_TRUE(result) << result.text;
      expect_part(part.client, whole, part.box);
      ASSERT_EQ(part.client.canonical_bytes(), part.server.canonical_bytes());
      if (HasFailure()) return;
    }
  }
  // Some that did not change came in because a vertex of theirs moved.
  EXPECT_GT(moved_in, 0);
}

TEST(Surface, HasTheCutFaceOfBothSides) {
  Replica mesh = samples::two_tets(0).replica();
  SurfaceReplica surface;
  surface.load(mesh);
  EXPECT_EQ(surface.triangles().size(), 6u);
  EXPECT_EQ(surface.vertices().size(), 5u);
  const OwnedDelta cut = difference(samples::two_tets(0), samples::two_tets(1));
  ASSERT_TRUE(mesh.apply(cut.view()));
  const SurfaceChange change = surface.follow(mesh, cut.view());
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
  ASSERT_TRUE(send_snapshot(server, client, 1000));
  const OwnedDelta cut = difference(samples::two_tets(0), samples::two_tets(1));
  ASSERT_TRUE(mesh.apply(cut.view()));
  const OwnedSurfaceDelta good = follow(server, mesh, cut.view());
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
