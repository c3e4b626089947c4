#include "protocol/volume_part.hpp"

#include <gtest/gtest.h>

#include <bit>
#include <functional>
#include <map>

#include "tests/protocol/samples.hpp"
#include "tests/protocol/walk.hpp"

namespace incise::protocol {
namespace {

struct VolumeView {
  using Part = VolumePart;
  void load(Replica replica) {
    mesh = std::move(replica);
    index.load(mesh);
  }
  MeshChange step(const Delta& delta) {
    MeshChange change(mesh, delta);
    for (const std::uint32_t t : apply_at_server(mesh, index, delta)) change.tets.push_back(t);
    return change;
  }
  void load_part(Part& part, const Box& box) const { part.load_part(mesh, box); }
  VolumePartWriter writer(const Part& part, const Box& box) const {
    return {part, box, SnapshotCause::Join, 7};
  }
  OwnedDelta follow_part(Part& part, const MeshChange& change, const Box& box) const {
    return part.follow_part(mesh, index, change, box);
  }
  static const std::vector<std::uint32_t>& tets_set(const OwnedDelta& d) { return d.tet_ids; }

  // What PROTOCOL.md says a box holds, found the plain way.
  void expect_part(const Part& part, const Box& box) const {
    std::map<std::uint32_t, VolumePart::Tet> tets;
    std::map<std::uint32_t, Vec3> vertices;
    mesh.for_each_tet([&](std::uint32_t t) {
      const auto all = [&](auto&& f) {
        for (const std::uint32_t v : mesh.vertices(t))
          if (!f(mesh.position(v))) return false;
        return true;
      };
      const bool apart = all([&](const Vec3& p) { return p.x < box.min.x; }) ||
                         all([&](const Vec3& p) { return p.x > box.max.x; }) ||
                         all([&](const Vec3& p) { return p.y < box.min.y; }) ||
                         all([&](const Vec3& p) { return p.y > box.max.y; }) ||
                         all([&](const Vec3& p) { return p.z < box.min.z; }) ||
                         all([&](const Vec3& p) { return p.z > box.max.z; });
      if (apart) return;
      tets[t] = {mesh.vertices(t), mesh.region(t), mesh.cut_mask(t), mesh.boundary_mask(t), mesh.piece(t)};
      for (const std::uint32_t v : mesh.vertices(t)) vertices[v] = mesh.position(v);
    });
    std::map<std::uint32_t, VolumePart::Tet> held_tets;
    for (const auto& [id, tet] : part.tets()) held_tets[id] = tet;
    EXPECT_EQ(held_tets, tets);
    std::map<std::uint32_t, Vec3> held;
    for (const auto& [id, vertex] : part.vertices()) held[id] = vertex.position;
    EXPECT_EQ(held, vertices);
    EXPECT_EQ(part.part_hash(), part.compute_part_hash());
    EXPECT_EQ(part.revision(), mesh.revision());
  }

  Replica mesh;
  TetIndex index;
};

TEST(VolumePart, ThePartInABoxIsThatOfTheWhole) {
  follow_boxes(VolumeView());
}

TEST(VolumePart, ABoxAroundEverythingHoldsTheWholeState) {
  const Replica mesh = box_model(2, 1, 1).replica();
  VolumePart part;
  part.load_part(mesh, {{-1, -1, -1}, {1, 1, 1}});
  EXPECT_EQ(part.part_hash(), mesh.state_hash());
  EXPECT_EQ(part.tets().size(), mesh.live_tets());
}

// A body that moves as a whole costs a box what it holds and what lies at its faces, and a look at the mesh now and then.
TEST(VolumePart, ADeformationCostsWhatIsInTheBox) {
  Walk walk(16, 12, 10);
  VolumeView view;
  view.load(walk.model.replica());
  const Box corner{{0, 0, 0}, {0.03, 0.03, 0.03}}, all{{-1, -1, -1}, {1, 1, 1}};
  constexpr std::size_t kSteps = 48;
  for (const Box& box : {corner, all}) {
    VolumePart part;
    part.load_part(view.mesh, box);
    std::size_t looked_at = 0;
    for (std::size_t i = 0; i < kSteps; ++i) {
      const OwnedDelta delta = walk.sway(1e-5);
      const MeshChange change = view.step(delta.view());
      part.follow_part(view.mesh, view.index, change, box);
      looked_at += part.looked_at();
    }
    view.expect_part(part, box);
    EXPECT_LT(looked_at, kSteps * (part.vertices().size() + view.mesh.live_tets() / 6));
  }
}

// The tetrahedron next to the box enters whole, in its piece, with its faces, when a vertex of it moves; an added vertex
// tells where it comes from though the part has not got that.
TEST(VolumePart, DeltasTellWhatCameInAndWhatWent) {
  VolumeView view;
  view.load(samples::two_tets(1).replica());
  const Box box{{-1, -1, -1}, {1, 1, 1}};
  VolumePart part;
  part.load_part(view.mesh, box);
  const OwnedDelta split = difference(samples::two_tets(1), samples::two_tets(2));
  const MeshChange change = view.step(split.view());
  const OwnedDelta sent = part.follow_part(view.mesh, view.index, change, box);
  EXPECT_EQ(sent.added_ids, (std::vector<std::uint32_t>{split.first_added}));
  EXPECT_EQ(sent.provenance_a, split.provenance_a);
  EXPECT_EQ(sent.moved_ids, split.moved_ids);
  EXPECT_EQ(sent.tet_ids, split.tet_ids);
  EXPECT_EQ(sent.boundary_removed, split.boundary_removed);
  EXPECT_EQ(sent.part_hash, view.mesh.state_hash());
}

// A boundary face that becomes a cut face is another one, though its vertices are the same.
TEST(VolumePart, AFaceThatBecomesACutFaceIsNamed) {
  Model before = samples::two_tets(0), after = before;
  ++after.revision;
  Model::Tet& tet = after.tets.begin()->second;
  const int face = std::countr_zero(tet.boundary_mask);
  tet.cut_mask = static_cast<std::uint8_t>(1u << face);
  VolumeView view;
  view.load(before.replica());
  VolumePart part;
  const Box box{{-1, -1, -1}, {1, 1, 1}};
  part.load_part(view.mesh, box);
  const OwnedDelta delta = difference(before, after);
  const MeshChange change = view.step(delta.view());
  const OwnedDelta sent = part.follow_part(view.mesh, view.index, change, box);
  EXPECT_EQ(sent.boundary_upserted, (std::vector<std::uint32_t>{static_cast<std::uint32_t>(face)}));
  EXPECT_TRUE(sent.boundary_removed.empty());
}

// A ring of changes is bounded by their bytes, so all that a change holds counts.
TEST(MeshChange, ItsBytesGrowWithWhatItHolds) {
  Walk walk(2, 2, 1);
  const Replica mesh = walk.model.replica();
  OwnedDelta delta = walk.cut();
  const auto bytes = [&] { return MeshChange(mesh, delta.view()).bytes(); };
  const auto grow = [&](auto& list, std::size_t by) {
    const std::size_t before = bytes();
    list.resize(list.size() + 100);
    EXPECT_EQ(bytes(), before + 100 * by);
  };
  grow(delta.removed_tets, 4);
  grow(delta.steps, sizeof(Step));
  const std::size_t before = bytes();
  for (auto* list : {&delta.provenance_a, &delta.provenance_b}) list->resize(list->size() + 100);
  delta.provenance_t.resize(delta.provenance_t.size() + 100);
  delta.vertex_count += 100;
  EXPECT_EQ(bytes(), before + 1600);
}

TEST(MeshChange, StepsInARowAddUp) {
  MeshChange all, next;
  all.base_revision = 3;
  all.revision = 4;
  all.tets = {1};
  all.cut_moved = {5};
  all.deformed = true;
  all.travel_m = 0.5;
  next.base_revision = 4;
  next.revision = 5;
  next.tets = {2, 3};
  next.deformed = true;
  next.travel_m = 0.25;
  next.vertex_count = 8;
  next.live_tets = 9;
  next.state_hash = 10;
  all.append(next);
  next.deformed = false;
  next.travel_m = 0;
  next.revision = 6;
  all.append(next);
  EXPECT_EQ(all.base_revision, 3u);
  EXPECT_EQ(all.revision, 6u);
  EXPECT_EQ(all.tets, (std::vector<std::uint32_t>{1, 2, 3, 2, 3}));
  EXPECT_EQ(all.cut_moved, (std::vector<std::uint32_t>{5}));
  EXPECT_TRUE(all.deformed);
  EXPECT_EQ(all.travel_m, 0.75) << "a vertex may move on in the same direction";
  EXPECT_EQ(all.vertex_count, 8u);
  EXPECT_EQ(all.live_tets, 9u);
  EXPECT_EQ(all.state_hash, 10u);
}

TEST(VolumePart, ABadDeltaChangesNothing) {
  VolumeView view;
  view.load(samples::two_tets(0).replica());
  const Box box{{-1, -1, -1}, {1, 1, 1}};
  VolumePart server, client;
  server.load_part(view.mesh, box);
  ASSERT_TRUE(send_snapshot(view.writer(server, box), client, std::uint64_t{0}));
  const OwnedDelta cut = difference(samples::two_tets(0), samples::two_tets(1));
  const MeshChange change = view.step(cut.view());
  const OwnedDelta good = server.follow_part(view.mesh, view.index, change, box);
  const std::vector<std::byte> before = client.canonical_bytes();

  struct Case {
    const char* what;
    ApplyError error;
    std::function<void(OwnedDelta&)> change;
  };
  const Case cases[] = {
      {"another base", ApplyError::WrongBase, [](auto& d) { d.base_revision = 3, d.revision = 4; }},
      {"positions missing", ApplyError::BadShape, [](auto& d) { d.added_positions.pop_back(); }},
      {"added vertices without names", ApplyError::BadShape, [](auto& d) { d.added_ids.clear(); }},
      {"regions missing", ApplyError::BadShape, [](auto& d) { d.tet_regions.pop_back(); }},
      {"out of order", ApplyError::BadIndex, [](auto& d) { std::swap(d.added_ids[0], d.added_ids[1]); }},
      {"added vertex that exists", ApplyError::BadIndex, [](auto& d) { d.added_ids[0] = 0; }},
      {"vertex that is not there", ApplyError::BadIndex, [](auto& d) { d.tet_vertices[1] = 99; }},
      {"vertex twice", ApplyError::BadIndex, [](auto& d) { d.tet_vertices[1] = d.tet_vertices[0]; }},
      {"vertex removed that is used", ApplyError::BadIndex, [](auto& d) { d.removed_vertices = {0}; }},
      {"vertex removed that another tetrahedron uses", ApplyError::BadIndex,
       [](auto& d) {
         d.tet_ids = {1}, d.tet_vertices.erase(d.tet_vertices.begin(), d.tet_vertices.begin() + 4);
         d.tet_regions.resize(1), d.tet_cut_masks.resize(1), d.tet_boundary_masks.resize(1);
         d.removed_vertices = {0};
       }},
      {"vertex removed and set", ApplyError::BadIndex, [](auto& d) { d.removed_vertices = {5}; }},
      {"tetrahedron removed and set", ApplyError::BadIndex, [](auto& d) { d.removed_tets = {d.tet_ids[0]}; }},
      {"piece of what is not there", ApplyError::BadIndex, [](auto& d) { d.piece_tets[0] = 77; }},
      {"piece of what goes", ApplyError::BadIndex,
       [](auto& d) {
         const std::uint32_t gone = d.tet_ids[1];
         d.tet_ids.resize(1), d.tet_vertices.resize(4), d.tet_regions.resize(1);
         d.tet_cut_masks.resize(1), d.tet_boundary_masks.resize(1);
         d.removed_tets = {gone}, d.piece_tets[0] = gone;
       }},
      {"pieces that do not add up", ApplyError::BadShape, [](auto& d) { d.piece_sizes[0] += 1; }},
      {"another hash", ApplyError::HashMismatch, [](auto& d) { d.part_hash ^= 1; }},
      {"another position", ApplyError::HashMismatch, [](auto& d) { d.added_positions[1] += 1; }},
      {"another mask", ApplyError::HashMismatch, [](auto& d) { d.tet_cut_masks[0] ^= 2; }},
  };
  for (const Case& c : cases) {
    OwnedDelta bad = good;
    c.change(bad);
    const ApplyResult result = client.apply(bad.view());
    EXPECT_EQ(result.error, c.error) << c.what << ": " << result.text;
    EXPECT_EQ(client.canonical_bytes(), before) << c.what;
  }
  EXPECT_TRUE(client.apply(good.view()));
  EXPECT_EQ(client.canonical_bytes(), server.canonical_bytes());
}

TEST(VolumePart, ABadSnapshotLeavesTheStateBefore) {
  const Box box{{-1, -1, -1}, {1, 1, 1}};
  VolumePart source, client;
  source.load_part(box_model(2, 1, 1).replica(), box);
  client.load_part(samples::two_tets(0).replica(), box);
  const std::vector<std::byte> before = client.canonical_bytes();
  VolumePartWriter writer(source, box, SnapshotCause::Join, 1000);
  SnapshotBegin whole = writer.begin();
  whole.box.reset();
  EXPECT_EQ(client.begin(whole).error, ApplyError::BadShape);
  EXPECT_EQ(client.chunk({}).error, ApplyError::OutOfOrder);
  ASSERT_TRUE(client.begin(writer.begin()));
  ASSERT_TRUE(writer.next());
  ASSERT_TRUE(client.chunk(writer.chunk()));
  EXPECT_EQ(client.chunk(writer.chunk()).error, ApplyError::OutOfOrder);  // the same again
  ASSERT_TRUE(client.begin(writer.begin()));
  EXPECT_EQ(client.end(writer.end(0)).error, ApplyError::OutOfOrder);
  EXPECT_EQ(client.canonical_bytes(), before);
}

}  // namespace
}  // namespace incise::protocol
