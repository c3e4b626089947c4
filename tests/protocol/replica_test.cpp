#include "protocol/replica.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <functional>
#include <map>
#include <random>
#include <set>

#include "protocol/carry.hpp"
#include "protocol/coalesce.hpp"
#include "protocol/state_hash.hpp"
#include "tests/protocol/samples.hpp"
#include "tests/protocol/walk.hpp"

namespace incise::protocol {
namespace {

// In chunks of `elements`.
ApplyResult send(const Replica& from, Replica& to, std::size_t elements) {
  return send_snapshot(SnapshotWriter(from, SnapshotCause::Join, elements), to);
}

TEST(Replica, AnEmptyOneHasHashZero) {
  const Replica replica;
  EXPECT_EQ(replica.state_hash(), 0u);
  EXPECT_EQ(replica.compute_state_hash(), 0u);
  EXPECT_EQ(replica.canonical_bytes().size(), 24u);
}

TEST(Replica, LoadsAMeshAndWalksItsBoundary) {
  const Model model = box_model(3, 2, 1);
  const Replica replica = model.replica();
  EXPECT_TRUE(holds(replica, model));
  EXPECT_EQ(replica.compute_state_hash(), replica.state_hash());
  // Two triangles for each of the 22 squares of the surface; outward normals enclose the volume.
  EXPECT_EQ(replica.boundary_faces(), 44u);
  std::size_t faces = 0;
  double six_volumes = 0;
  replica.for_each_boundary_face([&](std::uint32_t tet, int face) {
    ++faces;
    const auto v = replica.face_vertices(tet, face);
    const Vec3 a = replica.position(v[0]), b = replica.position(v[1]), c = replica.position(v[2]);
    six_volumes +=
        a.x * (b.y * c.z - b.z * c.y) + a.y * (b.z * c.x - b.x * c.z) + a.z * (b.x * c.y - b.y * c.x);
  });
  EXPECT_EQ(faces, 44u);
  EXPECT_NEAR(six_volumes / 6, 6e-6, 1e-18);
}

TEST(Replica, RandomDeltasKeepItInStepWithAPlainModel) {
  Walk walk(3, 3, 2);
  Replica replica = walk.model.replica();
  for (int i = 0; i < 400; ++i) {
    Message kept;
    const ApplyResult applied = replica.apply(through_bytes(walk.step().view(), kept));
    ASSERT_TRUE(applied) << applied.text;
    ASSERT_TRUE(holds(replica, walk.model)) << "revision " << walk.model.revision;
    ASSERT_EQ(replica.state_hash(), replica.compute_state_hash());
  }
  EXPECT_GT(replica.piece_names().size(), 1u);
}

// Where a step moves most vertices, those that stay are hashed; where it moves few, those that move.
TEST(Replica, TheHashFollowsHoweverManyVerticesMove) {
  const Model model = box_model(6, 5, 4);
  Replica replica = model.replica();
  const std::uint32_t count = replica.vertex_count();
  ASSERT_GT(count, 130u);
  std::uint64_t revision = replica.revision();
  for (const std::uint32_t stays : {1u, 2u, 3u, 7u, 64u, 1000u}) {
    std::vector<std::uint32_t> ids;
    std::vector<double> to;
    std::vector<double> expected(replica.positions().begin(), replica.positions().end());
    for (std::uint32_t v = 0; v < count; ++v) {
      if (v % stays == stays / 2 && stays > 1) continue;
      ids.push_back(v);
      for (std::size_t k = 3 * std::size_t{v}; k < 3 * std::size_t{v} + 3; ++k)
        to.push_back(expected[k] += 1e-4 * static_cast<double>(stays));
    }
    Delta delta;
    delta.base_revision = revision;
    delta.revision = ++revision;
    delta.moved_ids = ids;
    delta.moved_positions = to;
    delta.first_added = delta.vertex_count = count;
    delta.live_tets = replica.live_tets();
    delta.first_new_tet = replica.tet_slots();
    delta.state_hash = replica.compute_state_hash();
    for (std::uint32_t v = 0; v < count; ++v) {
      const Vec3 p = replica.position(v);
      delta.state_hash ^= vertex_hash(v, p.x, p.y, p.z) ^
                          vertex_hash(v, expected[3 * v], expected[3 * v + 1], expected[3 * v + 2]);
    }
    const ApplyResult applied = replica.apply(delta);
    ASSERT_TRUE(applied) << applied.text;
    EXPECT_EQ(replica.state_hash(), replica.compute_state_hash()) << stays;
  }
}

// Larger ones, smaller ones, ones with a snapshot under way: a copy goes into what memory there is.
TEST(Replica, ACopyIsTheSameWhateverItIsCopiedOver) {
  Walk small(2, 1, 1), large(4, 3, 3);
  Replica a = small.model.replica(), b = large.model.replica();
  for (int i = 0; i < 40; ++i) {
    ASSERT_TRUE(a.apply(small.step().view()));
    ASSERT_TRUE(b.apply(large.step().view()));
  }
  Replica over = b;
  for (const Replica* from : {&a, &b, &a, &a, &b}) {
    ASSERT_TRUE(over.begin(SnapshotWriter(b, SnapshotCause::Join).begin()));
    over = *from;
    EXPECT_EQ(over.chunks_total(), 0u);
    EXPECT_EQ(over.canonical_bytes(), from->canonical_bytes());
    EXPECT_EQ(over.piece_names(), from->piece_names());
    EXPECT_TRUE(std::ranges::equal(over.pieces(), from->pieces()));
  }
  ASSERT_TRUE(over.apply(large.step().view()));
  EXPECT_TRUE(holds(over, large.model));
}

TEST(Replica, ASnapshotInAnyChunksPlusTheRestIsTheSameBytes) {
  Walk walk(3, 2, 2);
  Replica mirror = walk.model.replica();
  std::vector<Replica> joined(3);
  const std::size_t chunk_elements[] = {1, 7, kChunkElements};
  for (int i = 0; i < 60; ++i) {
    const OwnedDelta delta = walk.step();
    ASSERT_TRUE(mirror.apply(delta.view()));
    for (std::size_t k = 0; k < joined.size(); ++k) {
      if (i == static_cast<int>(10 * k + 5)) {
        const ApplyResult result = send(mirror, joined[k], chunk_elements[k]);
        ASSERT_TRUE(result) << result.text;
      } else if (i > static_cast<int>(10 * k + 5)) {
        const ApplyResult result = joined[k].apply(delta.view());
        ASSERT_TRUE(result) << result.text;
      }
    }
  }
  for (const Replica& replica : joined) EXPECT_EQ(replica.canonical_bytes(), mirror.canonical_bytes());
}

// ---- All or nothing ----

TEST(Replica, ABadDeltaChangesNothing) {
  const Model from = samples::two_tets(0), to = samples::two_tets(1);
  const OwnedDelta good = difference(from, to);
  struct Case {
    const char* what;
    ApplyError error;
    std::function<void(OwnedDelta&)> change;
  };
  const Case cases[] = {
      {"another base", ApplyError::WrongBase, [](OwnedDelta& d) { d.base_revision = 1, d.revision = 2; }},
      {"backwards", ApplyError::WrongBase, [](OwnedDelta& d) { d.revision = 0; }},
      {"moved vertex that does not exist", ApplyError::BadIndex,
       [](OwnedDelta& d) {
         d.moved_ids = {5}, d.moved_positions = {0, 0, 0};
       }},
      {"moved vertices out of order", ApplyError::BadIndex,
       [](OwnedDelta& d) {
         d.moved_ids = {2, 1}, d.moved_positions.assign(6, 0);
       }},
      {"moved vertex twice", ApplyError::BadIndex,
       [](OwnedDelta& d) {
         d.moved_ids = {2, 2}, d.moved_positions.assign(6, 0);
       }},
      {"moved without position", ApplyError::BadShape, [](OwnedDelta& d) { d.moved_ids = {2}; }},
      {"added at another id", ApplyError::BadIndex, [](OwnedDelta& d) { d.first_added = 4; }},
      {"another vertex count", ApplyError::BadIndex, [](OwnedDelta& d) { d.vertex_count = 9; }},
      {"provenance of itself", ApplyError::BadIndex, [](OwnedDelta& d) { d.provenance_a[1] = 6; }},
      {"provenance of itself, the other parent", ApplyError::BadIndex,
       [](OwnedDelta& d) { d.provenance_b[1] = 6; }},
      {"rest position of a vertex that does not exist", ApplyError::BadIndex,
       [](OwnedDelta& d) {
         d.rest_ids = {d.vertex_count}, d.rest_positions = {0, 0, 0};
       }},
      {"blend of a vertex that does not exist", ApplyError::BadIndex,
       [](OwnedDelta& d) {
         d.blend_ids = {d.vertex_count}, d.blend_vertices.assign(4, 0), d.blend_weights.assign(4, 0.25);
       }},
      {"blend of a vertex that was not there before", ApplyError::BadIndex,
       [](OwnedDelta& d) {
         d.blend_ids = {0}, d.blend_vertices = {0, 1, 2, d.first_added}, d.blend_weights.assign(4, 0.25);
       }},
      {"elders of too many", ApplyError::BadShape,
       [](OwnedDelta& d) { d.tet_elders.assign(d.tet_ids.size() + 1, 0); }},
      {"blend of too few", ApplyError::BadShape,
       [](OwnedDelta& d) {
         d.blend_ids = {0}, d.blend_vertices = {0, 1, 2}, d.blend_weights.assign(4, 0.25);
       }},
      {"blend without weights", ApplyError::BadShape,
       [](OwnedDelta& d) {
         d.blend_ids = {0}, d.blend_vertices = {0, 1, 2, 3};
       }},
      {"rounds that do not add up", ApplyError::BadIndex,
       [](OwnedDelta& d) {
         d.round_added = {1, 0}, d.round_blends = {0, 0};
       }},
      {"provenance shorter", ApplyError::BadShape, [](OwnedDelta& d) { d.provenance_b.pop_back(); }},
      {"tetrahedron with a vertex that does not exist", ApplyError::BadIndex,
       [](OwnedDelta& d) { d.tet_vertices[5] = 8; }},
      {"tetrahedron with a vertex twice", ApplyError::BadIndex,
       [](OwnedDelta& d) { d.tet_vertices[5] = d.tet_vertices[6]; }},
      {"first vertex again as the second", ApplyError::BadIndex,
       [](OwnedDelta& d) { d.tet_vertices[5] = d.tet_vertices[4]; }},
      {"first vertex again as the third", ApplyError::BadIndex,
       [](OwnedDelta& d) { d.tet_vertices[6] = d.tet_vertices[4]; }},
      {"first vertex again as the last", ApplyError::BadIndex,
       [](OwnedDelta& d) { d.tet_vertices[7] = d.tet_vertices[4]; }},
      {"second vertex again as the last", ApplyError::BadIndex,
       [](OwnedDelta& d) { d.tet_vertices[7] = d.tet_vertices[5]; }},
      {"third vertex again as the last", ApplyError::BadIndex,
       [](OwnedDelta& d) { d.tet_vertices[7] = d.tet_vertices[6]; }},
      {"tetrahedron arrays of different lengths", ApplyError::BadShape,
       [](OwnedDelta& d) { d.tet_regions.pop_back(); }},
      {"mask bit above 3", ApplyError::BadShape, [](OwnedDelta& d) { d.tet_cut_masks[0] = 16; }},
      {"changed tetrahedron that does not exist", ApplyError::BadIndex,
       [](OwnedDelta& d) { d.tet_ids[1] = 5, d.first_new_tet = 9; }},
      {"new ids among the used ones", ApplyError::BadIndex, [](OwnedDelta& d) { d.first_new_tet = 1; }},
      {"tetrahedra out of order", ApplyError::BadIndex,
       [](OwnedDelta& d) { std::swap(d.tet_ids[0], d.tet_ids[1]); }},
      {"id beyond the limit", ApplyError::LimitReached, [](OwnedDelta& d) { d.tet_ids[1] = kMaxTets - 1; }},
      {"removed that does not exist", ApplyError::BadIndex, [](OwnedDelta& d) { d.removed_tets = {2}; }},
      {"removed and changed", ApplyError::BadIndex, [](OwnedDelta& d) { d.removed_tets = {1}; }},
      {"another count of tetrahedra", ApplyError::BadShape, [](OwnedDelta& d) { d.live_tets = 3; }},
      {"boundary face that is not on the boundary", ApplyError::BadIndex,
       [](OwnedDelta& d) { d.tet_boundary_masks[0] = 0b1110, d.boundary_upserted = {0}; }},
      {"boundary face of no tetrahedron", ApplyError::BadIndex,
       [](OwnedDelta& d) { d.boundary_upserted = {400}; }},
      {"removed boundary face that is there", ApplyError::BadIndex,
       [](OwnedDelta& d) { d.boundary_removed = {1}; }},
      {"piece of nothing", ApplyError::BadIndex, [](OwnedDelta& d) { d.piece_names[0] = 2; }},
      {"piece without a tetrahedron", ApplyError::BadShape, [](OwnedDelta& d) { d.piece_names.clear(); }},
      {"another hash", ApplyError::HashMismatch, [](OwnedDelta& d) { d.state_hash ^= 1; }},
      {"another position", ApplyError::HashMismatch, [](OwnedDelta& d) { d.added_positions[3] += 1e-17; }},
      {"another region", ApplyError::HashMismatch, [](OwnedDelta& d) { d.tet_regions[0] = 8; }},
      {"another cut mask", ApplyError::HashMismatch, [](OwnedDelta& d) { d.tet_cut_masks[0] = 3; }},
      {"vertices in another order", ApplyError::HashMismatch,
       [](OwnedDelta& d) { std::swap(d.tet_vertices[4], d.tet_vertices[5]); }},
  };
  Replica replica = from.replica();
  const std::vector<std::byte> before = replica.canonical_bytes();
  for (const Case& c : cases) {
    OwnedDelta bad = good;
    c.change(bad);
    const ApplyResult result = replica.apply(bad.view());
    EXPECT_EQ(result.error, c.error) << c.what << ": " << result.text;
    EXPECT_FALSE(result.text.empty()) << c.what;
    EXPECT_EQ(replica.canonical_bytes(), before) << c.what;
    EXPECT_EQ(replica.compute_state_hash(), replica.state_hash()) << c.what;
  }
  // After all of that the good one still applies.
  const ApplyResult result = replica.apply(good.view());
  EXPECT_TRUE(result) << result.text;
  EXPECT_TRUE(holds(replica, to));
}

TEST(Replica, FlippedBitsInADeltaNeverLeaveAHalfAppliedState) {
  Walk walk(2, 2, 1);
  std::mt19937_64& random = walk.random;
  const Model before = walk.model;
  for (int i = 0; i < 3; ++i) mutate(walk.model, random);
  const Frame frame = encode(difference(before, walk.model).view());
  Replica replica = before.replica();
  const std::vector<std::byte> untouched = replica.canonical_bytes();
  int refused = 0, accepted = 0;
  for (int i = 0; i < 20000; ++i) {
    std::vector<std::byte> bytes(frame.body().begin(), frame.body().end());
    bytes[random() % bytes.size()] ^= static_cast<std::byte>(1u << random() % 8);
    const DecodeResult decoded = decode(bytes);
    const Delta* delta = decoded ? std::get_if<Delta>(&decoded.message->body) : nullptr;
    if (delta == nullptr) continue;
    if (replica.apply(*delta)) {
      // Something that the hash does not cover: a step, a piece, a boundary list.
      ++accepted;
      EXPECT_EQ(replica.state_hash(), replica.compute_state_hash());
      replica = before.replica();
    } else {
      ++refused;
      if (refused % 100 == 0) {
        ASSERT_EQ(replica.canonical_bytes(), untouched);
      }
    }
  }
  EXPECT_EQ(replica.canonical_bytes(), untouched);
  EXPECT_GT(refused, 1000);
  EXPECT_GT(accepted, 0);
}

TEST(Replica, ABadSnapshotLeavesTheStateBefore) {
  const Replica source = samples::two_tets(2).replica();
  Replica replica = box_model(1, 1, 1).replica();
  const std::vector<std::byte> before = replica.canonical_bytes();

  const auto attempt =
      [&](const char* what, ApplyError expected,
          const std::function<void(SnapshotBegin&, std::vector<SnapshotChunk>&, SnapshotEnd&)>& change) {
        SnapshotWriter writer(source, SnapshotCause::Join, 1000);
        SnapshotBegin begin = writer.begin();
        ASSERT_EQ(begin.chunks, 2u);
        ASSERT_TRUE(writer.next());
        std::vector<SnapshotChunk> chunks{writer.chunk()};
        ASSERT_TRUE(writer.next());
        chunks.push_back(writer.chunk());
        SnapshotEnd end = writer.end();
        change(begin, chunks, end);
        ApplyResult result = replica.begin(begin);
        for (const SnapshotChunk& chunk : chunks) {
          if (result) result = replica.chunk(chunk);
        }
        if (result) result = replica.end(end);
        EXPECT_EQ(result.error, expected) << what << ": " << result.text;
        if (expected != ApplyError::None) {
          EXPECT_EQ(replica.canonical_bytes(), before) << what;
        }
        EXPECT_EQ(replica.chunks_total(), 0u) << what;
      };
  attempt("another view", ApplyError::BadShape, [](auto& b, auto&, auto&) { b.view = View::Surface; });
  attempt("chunk missing", ApplyError::OutOfOrder, [](auto&, auto& c, auto&) { c.pop_back(); });
  attempt("chunk first", ApplyError::OutOfOrder, [](auto&, auto& c, auto&) { std::swap(c[0], c[1]); });
  attempt("chunk twice", ApplyError::OutOfOrder, [](auto&, auto& c, auto&) { c.insert(c.begin(), c[0]); });
  attempt("one chunk more", ApplyError::OutOfOrder, [](auto&, auto& c, auto&) {
    c.push_back({});
    c.back().index = 2;
  });
  attempt("vertices from elsewhere", ApplyError::OutOfOrder,
          [](auto&, auto& c, auto&) { c[0].first_vertex = 1; });
  attempt("fewer vertices", ApplyError::BadShape,
          [](auto&, auto& c, auto&) { c[0].positions = c[0].positions.first(24); });
  attempt("more vertices than announced", ApplyError::BadShape,
          [](auto& b, auto&, auto&) { b.vertex_count = 8; });
  attempt("vertex that is not announced", ApplyError::BadIndex, [](auto& b, auto& c, auto&) {
    b.vertex_count = 8;
    c[0].positions = c[0].positions.first(24);
  });
  attempt("fewer tetrahedra than announced", ApplyError::BadShape,
          [](auto& b, auto&, auto&) { b.tet_count = 4; });
  attempt("more tetrahedra than announced", ApplyError::BadShape,
          [](auto& b, auto&, auto&) { b.tet_count = 2; });
  attempt("piece without a tetrahedron", ApplyError::BadShape,
          [](auto& b, auto&, auto&) { b.piece_names = {}; });
  attempt("too large", ApplyError::LimitReached,
          [](auto& b, auto&, auto&) { b.tet_count = kDefaultReplicaTets + 1; });
  attempt("another hash", ApplyError::HashMismatch, [](auto&, auto&, auto& e) { e.state_hash ^= 1; });
  attempt("another revision at the end", ApplyError::OutOfOrder,
          [](auto&, auto&, auto& e) { e.revision = 3; });
  const std::vector<double> few(3), all(27);
  attempt("rest positions of some vertices", ApplyError::BadShape,
          [&](auto&, auto& c, auto&) { c[0].rest_positions = few; });
  attempt("rest positions beside tetrahedra", ApplyError::BadShape, [&](auto&, auto& c, auto&) {
    c[0].rest_positions = std::span(all).first(c[0].positions.size());
    c[1].rest_positions = few;
  });
  EXPECT_EQ(replica.chunk({}).error, ApplyError::OutOfOrder);
  EXPECT_EQ(replica.end({}).error, ApplyError::OutOfOrder);
  attempt("nothing", ApplyError::None, [](auto&, auto&, auto&) {});
  EXPECT_EQ(replica.state_hash(), source.state_hash());
}

// What a snapshot announces bounds what is kept of it: each chunk that goes beyond is refused, not only the end.
TEST(Replica, AChunkBeyondWhatWasAnnouncedIsRefusedAtOnce) {
  const Replica source = samples::two_tets(2).replica();
  for (const bool vertices : {true, false}) {
    Replica replica;
    SnapshotWriter writer(source, SnapshotCause::Join, 1000);
    SnapshotBegin begin = writer.begin();
    --(vertices ? begin.vertex_count : begin.tet_count);
    ASSERT_TRUE(replica.begin(begin));
    ASSERT_TRUE(writer.next());
    EXPECT_EQ(replica.chunk(writer.chunk()).error, vertices ? ApplyError::BadShape : ApplyError::None);
    if (vertices) continue;
    ASSERT_TRUE(writer.next());
    EXPECT_EQ(replica.chunk(writer.chunk()).error, ApplyError::BadShape);
  }
}

TEST(Replica, TakesASnapshotOfAsMuchAsItMayHold) {
  const Replica source = samples::two_tets(2).replica();
  const std::uint32_t vertices = source.vertex_count(), slots = source.tet_slots();
  Replica enough(vertices, slots);
  EXPECT_TRUE(send(source, enough, 1000));
  Replica few_vertices(vertices - 1, slots), few_tets(vertices, slots - 1);
  EXPECT_EQ(send(source, few_vertices, 1000).error, ApplyError::LimitReached);
  EXPECT_EQ(send(source, few_tets, 1000).error, ApplyError::LimitReached);
}

TEST(Replica, ARestPositionOfAnAddedVertexLiesBetweenItsParents) {
  Model before = samples::two_tets(1), after = samples::two_tets(2);
  after.origins.begin()->second.t = 0.25;
  for (auto& [v, origin] : after.origins)
    if (v >= before.positions.size()) origin.t = 0.25;
  OwnedDelta delta = difference(before, after);
  delta.steps.at(0).stroke = 0;  // a deformation, which makes a body tell rest from place
  Replica replica = before.replica();
  ASSERT_TRUE(replica.apply(delta.view()));
  const auto v = before.positions.size();
  const auto& [a, b, t] = after.origins.at(static_cast<std::uint32_t>(v));
  ASSERT_EQ(t, 0.25);
  for (std::size_t k = 0; k < 3; ++k) {
    EXPECT_DOUBLE_EQ(replica.rest_positions()[3 * v + k],
                     0.75 * before.positions[a][k] + 0.25 * before.positions[b][k]);
  }
}

TEST(Replica, LoadRefusesWhatIsNoMesh) {
  const Model model = box_model(1, 1, 1);
  Replica replica = model.replica();
  const std::vector<std::byte> before = replica.canonical_bytes();
  const std::vector<double> positions(12, 0.5);
  const std::vector<std::uint32_t> ids{0}, vertices{0, 1, 2, 3}, wrong{0, 1, 2, 4};
  const std::vector<std::int32_t> regions{0};
  const std::vector<std::uint8_t> masks{0};
  EXPECT_EQ(replica.load(positions, {ids, wrong, regions, masks, masks}, 0).error, ApplyError::BadIndex);
  EXPECT_EQ(replica.load(positions, {ids, vertices, regions, masks, {}}, 0).error, ApplyError::BadShape);
  EXPECT_EQ(replica.load(std::span(positions).first(11), {}, 0).error, ApplyError::BadShape);
  EXPECT_EQ(Replica(3, 10).load(positions, {}, 0).error, ApplyError::LimitReached);
  EXPECT_EQ(replica.canonical_bytes(), before);
}

// ---- Fields ----

// Gives some vertices of the step, old ones and added ones, other material.
void add_blends(OwnedDelta& step, std::mt19937_64& random) {
  const std::uint32_t before = step.first_added;
  for (std::uint32_t v = 0; v < step.vertex_count; ++v) {
    if (random() % 4 != 0) continue;
    step.blend_ids.push_back(v);
    double rest = 1;
    for (int k = 0; k < 4; ++k) {
      const double weight = k == 3 ? rest : static_cast<double>(random() % 1025) / 1024 - 0.25;
      rest -= weight;
      step.blend_vertices.push_back(static_cast<std::uint32_t>(random() % before));
      step.blend_weights.push_back(weight);
    }
  }
}

// Gives each new tetrahedron an elder, one of those that `before` has.
void add_elders(OwnedDelta& step, const Model& before, std::mt19937_64& random) {
  for (const std::uint32_t t : step.tet_ids) {
    if (t < step.first_new_tet) continue;
    step.tet_elders.push_back(
        std::next(before.tets.begin(), static_cast<long>(random() % before.tets.size()))->first);
  }
}

// The rule of PROTOCOL.md for a delta of one step, written plainly.
std::vector<double> carried(const OwnedDelta& d, const std::vector<double>& before) {
  std::vector<double> after = before;
  after.resize(d.vertex_count);
  std::set<std::uint32_t> blended(d.blend_ids.begin(), d.blend_ids.end());
  for (std::size_t i = 0; i < d.blend_ids.size(); ++i) {
    after[d.blend_ids[i]] = 0;
    for (std::size_t k = 4 * i; k < 4 * i + 4; ++k)
      after[d.blend_ids[i]] += d.blend_weights[k] * before[d.blend_vertices[k]];
  }
  for (std::uint32_t i = 0; i < d.provenance_t.size(); ++i) {
    const double t = d.provenance_t[i];
    if (!blended.contains(d.first_added + i))
      after[d.first_added + i] = (1 - t) * after[d.provenance_a[i]] + t * after[d.provenance_b[i]];
  }
  return after;
}

TEST(Carry, EveryVertexGetsTheFieldOfItsMaterial) {
  for (int trial = 0; trial < 40; ++trial) {
    Walk walk(2, 2, 1);
    std::vector<double> field(walk.model.positions.size());
    for (double& x : field) x = static_cast<double>(walk.random() % 1000);
    std::vector<float> pairs;
    for (const double x : field) pairs.insert(pairs.end(), {static_cast<float>(x), 7});
    double largest = 1000;
    for (int i = 0; i < 5; ++i) {
      OwnedDelta step = walk.step();
      add_blends(step, walk.random);
      const std::vector<double> expected = carried(step, field);
      carry(step.view(), 1, field);
      ASSERT_EQ(field, expected);
      carry(step.view(), 2, pairs);
      for (const double x : field) largest = std::max(largest, std::abs(x));
      for (std::size_t v = 0; v < field.size(); ++v) {
        ASSERT_NEAR(pairs[2 * v], field[v], 1e-5 * largest);
        ASSERT_NEAR(pairs[2 * v + 1], 7, 1e-2);
      }
    }
  }
}

TEST(Carry, AnIntegerIsThatOfTheNearestVertex) {
  Walk walk(1, 1, 1);
  OwnedDelta step;
  step.first_added = 4, step.vertex_count = 7;
  step.added_positions.assign(9, 0);
  step.provenance_a = {0, 1, 4}, step.provenance_b = {1, 2, 5}, step.provenance_t = {0.5, 0.75, 0.25};
  step.blend_ids = {0}, step.blend_vertices = {0, 1, 2, 3}, step.blend_weights = {0.2, 0.3, -0.1, 0.6};
  std::vector<std::int32_t> labels{10, 11, 12, 13};
  carry(step.view(), 1, labels);
  EXPECT_EQ(labels, (std::vector<std::int32_t>{13, 11, 12, 13, 13, 12, 13}));
}

TEST(Carry, ANewTetrahedronHasWhatItsElderHas) {
  const OwnedDelta good = [] {
    OwnedDelta d = difference(samples::two_tets(1), samples::two_tets(2));  // adds tetrahedron 2
    d.tet_elders = {1};
    return d;
  }();
  std::vector<float> pairs{1, 2, 3, 4};
  carry_tets(good.view(), 2, pairs);
  EXPECT_EQ(pairs, (std::vector<float>{1, 2, 3, 4, 3, 4}));
  EXPECT_TRUE(samples::two_tets(1).replica().apply(good.view()));
  for (const std::vector<std::uint32_t>& elders : {std::vector<std::uint32_t>{2}, {7}, {0, 1}}) {
    OwnedDelta bad = good;
    bad.tet_elders = elders;
    std::vector<float> values{1, 2};
    EXPECT_THROW(carry_tets(bad.view(), 1, values), std::invalid_argument);
    EXPECT_EQ(values, (std::vector<float>{1, 2}));
    EXPECT_EQ(samples::two_tets(1).replica().apply(bad.view()).error,
              elders.size() == 1 ? ApplyError::BadIndex : ApplyError::BadShape);
  }
  std::vector<float> odd{1, 2, 3};
  EXPECT_THROW(carry_tets(good.view(), 2, odd), std::invalid_argument);
}

TEST(Carry, RefusesWhatDoesNotFitAndChangesNothing) {
  OwnedDelta good;
  good.first_added = 4, good.vertex_count = 6;
  good.added_positions.assign(6, 0);
  good.provenance_a = {0, 4}, good.provenance_b = {1, 1}, good.provenance_t = {0.5, 0.5};
  good.blend_ids = {1, 4}, good.blend_vertices = {0, 1, 2, 3, 0, 1, 2, 3}, good.blend_weights.assign(8, 0.25);
  std::vector<double> values{1, 2, 3, 4};
  carry(good.view(), 1, values);
  const std::vector<std::function<void(OwnedDelta&)>> faults{
      [](OwnedDelta& d) { d.provenance_a[1] = 5; },
      [](OwnedDelta& d) { d.provenance_b.pop_back(); },
      [](OwnedDelta& d) { d.blend_ids[1] = 6; },
      [](OwnedDelta& d) { d.blend_ids[1] = 1; },
      [](OwnedDelta& d) { d.blend_ids.pop_back(); },
      [](OwnedDelta& d) { d.blend_vertices[7] = 4; },
      [](OwnedDelta& d) { d.blend_weights.pop_back(); },
      [](OwnedDelta& d) {
        d.round_added = {1, 1};
      },
      [](OwnedDelta& d) {
        d.round_added = {1, 1}, d.round_blends = {1, 2};
      },
      [](OwnedDelta& d) {
        d.round_added = {1, 0}, d.round_blends = {1, 1};
      },
      [](OwnedDelta& d) {
        d.round_added = {0, 2}, d.round_blends = {2, 0};
      },
      [](OwnedDelta& d) {
        d.round_added = {0xffffffff, 3}, d.round_blends = {1, 1};
      },
      [](OwnedDelta& d) { d.vertex_count = 7; },
      [](OwnedDelta& d) { d.vertex_count = 1; },
  };
  for (std::size_t i = 0; i < faults.size(); ++i) {
    OwnedDelta bad = good;
    faults[i](bad);
    std::vector<double> field{1, 2, 3, 4};
    EXPECT_THROW(carry(bad.view(), 1, field), std::invalid_argument) << i;
    EXPECT_EQ(field, (std::vector<double>{1, 2, 3, 4}));
  }
  std::vector<double> few{1, 2, 3};
  EXPECT_THROW(carry(good.view(), 1, few), std::invalid_argument);
  EXPECT_THROW(carry(good.view(), 0, few), std::invalid_argument);
}

// ---- Coalescing ----

TEST(Coalesce, OneDeltaEqualsThoseItReplaces) {
  for (int trial = 0; trial < 60; ++trial) {
    Walk walk(2, 2, 1);
    std::mt19937_64& random = walk.random;
    Replica one_by_one = walk.model.replica(), at_once = walk.model.replica();
    const bool with_elders = trial % 4 != 0;
    std::vector<double> of_tets(one_by_one.tet_slots());
    for (double& x : of_tets) x = static_cast<double>(random() % 1000);
    std::vector<OwnedDelta> owned;
    for (std::uint64_t n = 1 + random() % 12; n > 0; --n) {
      const Model before = walk.model;
      owned.push_back(walk.step());
      if (random() % 2 == 0) add_blends(owned.back(), random);
      if (with_elders) add_elders(owned.back(), before, random);
      ASSERT_TRUE(one_by_one.apply(owned.back().view()));
    }
    std::vector<Delta> deltas;
    for (const OwnedDelta& d : owned) deltas.push_back(d.view());
    const OwnedDelta sum = coalesce(std::span<const Delta>(deltas));
    EXPECT_EQ(sum.steps.size(), owned.size());
    Message kept;
    const ApplyResult applied = at_once.apply(through_bytes(sum.view(), kept));
    ASSERT_TRUE(applied) << applied.text;
    EXPECT_TRUE(holds(at_once, walk.model));
    EXPECT_EQ(at_once.canonical_bytes(), one_by_one.canonical_bytes());
    // What came and went in between is not spoken of.
    for (const std::uint32_t t : sum.removed_tets) EXPECT_LT(t, sum.first_new_tet);
    for (const std::uint32_t h : sum.boundary_removed) EXPECT_LT(h / 4, sum.first_new_tet);

    // So do fields.
    std::vector<double> stepwise(one_by_one.vertex_count() - sum.provenance_t.size()), direct;
    for (double& x : stepwise) x = static_cast<double>(random() % 1000);
    std::vector<std::int32_t> labels(stepwise.begin(), stepwise.end()), direct_labels = labels;
    direct = stepwise;
    for (const Delta& d : deltas) {
      carry(d, 1, stepwise);
      carry(d, 1, labels);
    }
    carry(sum.view(), 1, direct);
    carry(sum.view(), 1, direct_labels);
    EXPECT_EQ(direct, stepwise);
    EXPECT_EQ(direct_labels, labels);
    std::vector<double> of_tets_direct = of_tets;
    for (const Delta& d : deltas) carry_tets(d, 1, of_tets);
    carry_tets(sum.view(), 1, of_tets_direct);
    EXPECT_EQ(sum.tet_elders.empty(),
              !with_elders || sum.tet_ids.empty() || sum.tet_ids.back() < sum.first_new_tet);
    one_by_one.for_each_tet(
        [&](std::uint32_t t) { EXPECT_TRUE(!with_elders || of_tets_direct.at(t) == of_tets.at(t)) << t; });

    // It does not matter how they are put together.
    if (deltas.size() >= 2) {
      const std::size_t cut = 1 + random() % (deltas.size() - 1);
      const OwnedDelta left = coalesce(std::span<const Delta>(deltas).first(cut));
      const OwnedDelta right = coalesce(std::span<const Delta>(deltas).subspan(cut));
      const std::vector<Delta> halves{left.view(), right.view()};
      const OwnedDelta again = coalesce(std::span<const Delta>(halves));
      const Frame other = encode(again.view());
      const Frame frame = encode(sum.view());
      EXPECT_TRUE(std::ranges::equal(other.body(), frame.body()));
    }
  }
}

// Of steps that move a whole body, or a part of it, or a few vertices, the newest place of each vertex is what counts, in whichever order
// the large and the small ones come; and of boundary faces and tetrahedra, the last word.
TEST(Replica, TheNewestPlacesOfABodyThatDeforms) {
  constexpr std::uint64_t kSeed = 17;
  std::mt19937_64 random(kSeed);
  constexpr std::uint32_t kVertices = 700;
  for (int trial = 0; trial < 200; ++trial) {
    std::vector<OwnedDelta> owned;
    std::map<std::uint32_t, double> places;
    std::map<std::uint32_t, bool> faces;  // by half-face: upserted, not removed
    for (std::uint32_t n = 1 + static_cast<std::uint32_t>(random() % 8); n > 0; --n) {
      OwnedDelta& d = owned.emplace_back();
      d.base_revision = owned.size() - 1;
      d.revision = owned.size();
      d.steps.resize(1);
      d.vertex_count = d.first_added = kVertices;
      d.first_new_tet = 5000;
      const std::uint64_t one_in = std::array{1, 2, 100}[random() % 3];
      for (std::uint32_t v = 0; v < kVertices; ++v) {
        if (random() % one_in != 0) continue;
        const auto place = static_cast<double>(random() % 100'000);
        places[v] = place;
        d.moved_ids.push_back(v);
        d.moved_positions.insert(d.moved_positions.end(), {place, place + 1, place + 2});
        const std::uint32_t face = 7 * v;
        faces[face] = random() % 2 == 0;
        (faces[face] ? d.boundary_upserted : d.boundary_removed).push_back(face);
      }
    }
    std::vector<Delta> deltas;
    for (const OwnedDelta& d : owned) deltas.push_back(d.view());
    const OwnedDelta sum = coalesce(std::span<const Delta>(deltas));
    ASSERT_EQ(sum.moved_ids.size(), places.size()) << "seed " << kSeed << ", trial " << trial;
    std::size_t i = 0;
    for (const auto& [v, place] : places) {
      ASSERT_EQ(sum.moved_ids[i], v);
      for (std::size_t axis = 0; axis < 3; ++axis)
        ASSERT_EQ(sum.moved_positions[3 * i + axis], place + static_cast<double>(axis)) << v;
      ++i;
    }
    std::vector<std::uint32_t> upserted, removed;
    for (const auto& [face, is] : faces) (is ? upserted : removed).push_back(face);
    EXPECT_EQ(sum.boundary_upserted, upserted);
    EXPECT_EQ(sum.boundary_removed, removed);
  }
}

// Cuts, then a deformation, a cut in the deformed body, a deformation: rest positions are the same whichever of the deltas
// come as one, and in a snapshot.
TEST(Replica, RestPositionsBeginWithTheFirstDeformation) {
  const std::uint64_t seed = std::random_device{}();
  SCOPED_TRACE("seed " + std::to_string(seed));
  std::mt19937_64 random(seed);
  std::vector<Model> models{box_model(2, 2, 1)};
  std::vector<OwnedDelta> steps;
  std::vector<std::vector<double>> rests(1);
  for (const char kind : {'c', 'c', 'd', 'c', 'd', 'c'}) {
    Model next = models.back();
    if (kind == 'c') {
      mutate(next, random);
    } else {
      ++next.revision;
      for (auto& p : next.positions) p[0] += 0.001 * static_cast<double>(1 + random() % 8);
    }
    OwnedDelta step = difference(models.back(), next);
    step.steps.at(0).stroke = kind == 'c' ? 1 : 0;
    std::vector<double> rest = rests.back();
    if (kind == 'd' && rest.empty()) {
      for (const auto& p : models.back().positions) rest.insert(rest.end(), p.begin(), p.end());
    } else if (kind == 'c' && !rest.empty()) {
      rest.resize(3 * next.positions.size());
      step.rest_ids = step.moved_ids;
      for (std::size_t v = models.back().positions.size(); v < next.positions.size(); ++v)
        step.rest_ids.push_back(static_cast<std::uint32_t>(v));
      for (const std::uint32_t v : step.rest_ids) {
        for (std::size_t k = 0; k < 3; ++k) {
          rest[3 * v + k] = 0.01 * static_cast<double>(random() % 100);
          step.rest_positions.push_back(rest[3 * v + k]);
        }
      }
    }
    models.push_back(next);
    steps.push_back(step);
    rests.push_back(rest);
  }
  const auto rest_of = [](const Replica& replica) {
    return replica.deformed()
               ? std::vector<double>(replica.rest_positions().begin(), replica.rest_positions().end())
               : std::vector<double>();
  };
  for (std::size_t first = 0; first <= steps.size(); ++first) {
    for (std::size_t last = first; last <= steps.size(); ++last) {
      Replica replica = models[0].replica();
      std::vector<OwnedDelta> chain;
      for (std::size_t i = 0; i < steps.size(); ++i) {
        if (i < first || i >= last) {
          chain.push_back(steps[i]);
        } else if (i == first) {
          std::vector<Delta> some;
          for (std::size_t k = first; k < last; ++k) some.push_back(steps[k].view());
          chain.push_back(coalesce(std::span<const Delta>(some)));
        }
      }
      for (const OwnedDelta& delta : chain) {
        const Frame frame = encode(delta.view());
        const ApplyResult applied = replica.apply(std::get<Delta>(decode(frame.body()).message->body));
        ASSERT_TRUE(applied) << applied.text;
        EXPECT_EQ(rest_of(replica), rests[replica.revision()]) << first << " to " << last;
      }
      Replica late;
      ASSERT_TRUE(send(replica, late, 5));
      EXPECT_EQ(rest_of(late), rests.back());
    }
  }
  // Lists that do not fit are refused.
  Replica replica = models[3].replica();
  OwnedDelta wrong = steps[3];
  wrong.rest_ids.push_back(1u << 20);
  wrong.rest_positions.insert(wrong.rest_positions.end(), {0, 0, 0});
  EXPECT_EQ(replica.apply(wrong.view()).error, ApplyError::BadIndex);
  wrong.rest_positions.pop_back();
  EXPECT_EQ(replica.apply(wrong.view()).error, ApplyError::BadShape);
}

TEST(Coalesce, RefusesDeltasThatDoNotFollowOnEachOther) {
  const OwnedDelta a = difference(samples::two_tets(0), samples::two_tets(1));
  const OwnedDelta b = difference(samples::two_tets(1), samples::two_tets(2));
  const std::vector<Delta> wrong{b.view(), a.view()};
  EXPECT_THROW(coalesce(std::span<const Delta>(wrong)), std::invalid_argument);
  EXPECT_THROW(coalesce(std::span<const Delta>()), std::invalid_argument);
}

}  // namespace
}  // namespace incise::protocol
