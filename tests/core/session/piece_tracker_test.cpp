#include "server/core/session/piece_tracker.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>
#include <string>
#include <vector>

#include "server/core/mesh/measure.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using namespace incise::core::testing;

// A body and what cuts it off, step by step, each judged by a walk through the mesh: of the parts of a piece the largest keeps the
// id, and the deltas name each piece but 0 by a tetrahedron that it has.
class Body {
 public:
  explicit Body(const MeshData& data, std::int64_t budget = INT64_MAX)
      : mesh_(data), tracker_(mesh_), budget_(budget) {}

  // Opens the faces across the plane x = at, y = at or z = at (axis 0, 1, 2) whose middle is between `from` and `to` along the
  // axis after it. The mesh is a box of unit cubes.
  void open_plane(int axis, double at, double from = -1, double to = 1e9) {
    std::vector<HalfFace> faces;
    for (TetId t = 0; t < mesh_.tet_slots(); ++t) {
      if (!mesh_.alive(t)) continue;
      for (int f = 0; f < 4; ++f) {
        const HalfFace h = half_face(t, f), o = mesh_.opposite(h);
        if (o == kNone || o < h) continue;
        bool on = true;
        double middle = 0;
        for (const VertexId v : mesh_.face_vertices(h)) {
          on = on && coordinate(v, axis) == at;
          middle += coordinate(v, (axis + 1) % 3) / 3;
        }
        if (on && middle > from && middle < to) faces.push_back(h);
      }
    }
    mesh_.open_faces(faces);
  }
  void split_an_edge_of(TetId t) { mesh_.split_edge(t, mesh_.vertices(t)[0], mesh_.vertices(t)[1], 0.5); }
  void remove(TetId t) { mesh_.remove_tet(t); }

  void commit() {
    const std::vector<std::uint32_t> before = labels_;
    const std::uint32_t pieces_before = tracker_.pieces();
    Delta delta;
    tracker_.begin();
    for (int calls = 0;; ++calls) {
      ASSERT_LT(calls, 1000000);
      WorkBudget budget{budget_};
      if (tracker_.advance(budget, delta)) break;
    }
    mesh_.commit(delta);
    labels_.assign(mesh_.tet_slots(), kNone);
    for (TetId t = 0; t < mesh_.tet_slots(); ++t) {
      if (mesh_.alive(t)) labels_[t] = tracker_.piece(t);
    }
    expect_parts(before, pieces_before);
    expect_named(pieces_before, delta);
  }

  const TetMesh& mesh() const { return mesh_; }
  const std::vector<std::uint32_t>& labels() const { return labels_; }
  std::uint32_t pieces() const { return tracker_.pieces(); }
  // By piece.
  std::map<std::uint32_t, std::uint32_t> sizes() const {
    std::map<std::uint32_t, std::uint32_t> sizes;
    for (const std::uint32_t label : labels_) sizes[label] += label != kNone ? 1 : 0;
    sizes.erase(kNone);
    return sizes;
  }

 private:
  double coordinate(VertexId v, int axis) const {
    const Vec3& p = mesh_.position(v);
    return axis == 0 ? p.x : axis == 1 ? p.y : p.z;
  }

  void expect_parts(const std::vector<std::uint32_t>& before, std::uint32_t pieces_before) const {
    std::uint32_t count = 0;
    const auto parts = label_pieces(mesh_, &count);
    std::vector<std::uint32_t> size(count, 0), label(count, kNone), was(count, 0);
    for (TetId t = 0; t < mesh_.tet_slots(); ++t) {
      if (!mesh_.alive(t)) continue;
      const std::uint32_t part = parts[t];
      if (label[part] == kNone) label[part] = labels_[t];
      ASSERT_EQ(label[part], labels_[t]) << "tetrahedron " << t << " and its part";
      ++size[part];
      if (t < before.size()) was[part] = before[t];
    }
    EXPECT_EQ(std::set<std::uint32_t>(label.begin(), label.end()).size(), count) << "a label twice";
    std::map<std::uint32_t, std::vector<std::uint32_t>> parts_of;
    for (std::uint32_t part = 0; part < count; ++part) parts_of[was[part]].push_back(part);
    std::uint32_t fresh = 0;
    for (const auto& [piece, of_it] : parts_of) {
      std::uint32_t largest = 0, kept = 0;
      for (const std::uint32_t part : of_it) {
        largest = std::max(largest, size[part]);
        if (label[part] == piece) kept = size[part];
        EXPECT_TRUE(label[part] == piece || label[part] >= pieces_before) << "the id of another piece";
        fresh += label[part] != piece ? 1 : 0;
      }
      EXPECT_EQ(kept, largest) << "of piece " << piece << " in " << of_it.size() << " parts";
    }
    EXPECT_EQ(tracker_.pieces(), pieces_before + fresh);
  }

  // New pieces are named, others when they have lost their tetrahedron, and only then.
  void expect_named(std::uint32_t pieces_before, const Delta& delta) {
    const auto sizes = this->sizes();
    std::uint32_t last = 0;
    for (const Delta::Piece& piece : delta.pieces) {
      EXPECT_GT(piece.id, last) << "ids ascend, and 0 has no name";
      last = piece.id;
      ASSERT_TRUE(mesh_.alive(piece.tet));
      EXPECT_EQ(labels_[piece.tet], piece.id);
      EXPECT_EQ(piece.tets, sizes.at(piece.id));
      const auto known = names_.find(piece.id);
      EXPECT_EQ(known == names_.end(), piece.id >= pieces_before);
      if (known != names_.end()) {
        EXPECT_TRUE(!mesh_.alive(known->second) || labels_[known->second] != piece.id)
            << "named without need";
      }
      names_[piece.id] = piece.tet;
    }
    for (const auto& [id, tets] : sizes) {
      if (id == 0) continue;
      ASSERT_TRUE(names_.contains(id)) << id;
      EXPECT_TRUE(mesh_.alive(names_.at(id)) && labels_[names_.at(id)] == id) << id;
    }
  }

  TetMesh mesh_;
  PieceTracker tracker_;
  std::int64_t budget_;
  std::vector<std::uint32_t> labels_ = std::vector<std::uint32_t>(mesh_.tet_slots(), 0);
  std::map<std::uint32_t, TetId> names_;  // by piece
};

TEST(PieceTracker, TheSmallerSideGetsANewId) {
  for (const double at : {2.0, 9.0}) {
    Body body(box(11, 3, 3));
    body.open_plane(0, at);
    body.commit();
    const std::uint32_t small = 6 * 9 * 2;
    EXPECT_EQ(body.sizes(), (std::map<std::uint32_t, std::uint32_t>{{0, 6 * 99 - small}, {1, small}}));
  }
}

TEST(PieceTracker, APartialCutMakesNoPiece) {
  Body body(box(11, 4, 4));
  body.open_plane(0, 5, -1, 3);
  body.commit();
  EXPECT_EQ(body.pieces(), 1u);
  body.open_plane(0, 5);
  body.commit();
  EXPECT_EQ(body.pieces(), 2u);
}

// Three parts in one step, in all orders of their sizes: the largest keeps the id, wherever it lies and whenever its search ends.
TEST(PieceTracker, OfThreePartsInOneStepTheLargestKeepsItsId) {
  for (const int a : {1, 2, 5, 9, 14, 20}) {
    for (const int b : {1, 3, 6, 10, 15, 21}) {
      for (const int c : {1, 4, 7, 11, 16, 22}) {
        SCOPED_TRACE(::testing::Message() << "parts " << a << ", " << b << ", " << c);
        Body body(box(a + b + c, 3, 2));
        body.open_plane(0, a);
        body.open_plane(0, a + b);
        body.commit();
        ASSERT_EQ(body.sizes().size(), 3u);
      }
    }
  }
}

// A part with many cut faces is searched from many sides and ends before a smaller one with few: what is left is then visited to its
// end, and does not keep the id for being last.
TEST(PieceTracker, ThePartThatIsVisitedLastIsNotTakenForTheLargest) {
  for (int height = 1; height <= 12; ++height) {
    SCOPED_TRACE(height);
    // A plate above a column of about its size: the plate's foot is the cut, all of it; then a thin slice off the column's end.
    Body body(box(8, 8, 2 * height));
    body.open_plane(2, height);
    body.open_plane(2, 2 * height - 1);
    body.open_plane(0, 1);
    body.commit();
    body.open_plane(0, 4);
    body.open_plane(1, 3);
    body.commit();
  }
}

// Clusters whose tetrahedra have been split, without a cut: a later search still passes through them.
TEST(PieceTracker, ASearchPassesWhatEarlierStepsHaveSplit) {
  for (int from = 1; from <= 5; ++from) {
    SCOPED_TRACE(from);
    Body body(box(40, 3, 3));
    for (TetId t = 0, slots = body.mesh().tet_slots(); t < slots; ++t) {
      const double x = body.mesh().barycentre(t).x;
      if (x > from && x < from + 1) body.split_an_edge_of(t);
    }
    body.commit();
    body.open_plane(0, 7);
    body.commit();
    EXPECT_EQ(body.sizes().size(), 2u);
  }
}

TEST(PieceTracker, RandomCutsAgreeWithAWalkThroughTheMesh) {
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    SCOPED_TRACE(::testing::Message() << "seed " << seed);
    Random random(seed);
    const int n[3] = {3 + static_cast<int>(random.below(14)), 2 + static_cast<int>(random.below(7)),
                      2 + static_cast<int>(random.below(5))};
    const std::int64_t budget = seed % 3 == 0 ? 7 : INT64_MAX;
    Body body(box(n[0], n[1], n[2]), budget);
    for (int step = 0; step < 5; ++step) {
      const std::uint32_t cuts = 1 + random.below(4);
      for (std::uint32_t i = 0; i < cuts; ++i) {
        const int axis = static_cast<int>(random.below(3));
        const double at = 1 + random.below(static_cast<std::uint32_t>(n[axis] - 1));
        const double to =
            random.below(3) == 0 ? 1 + random.below(static_cast<std::uint32_t>(n[(axis + 1) % 3])) : 1e9;
        body.open_plane(axis, at, -1, to);
      }
      // What is split or taken out counts, too.
      for (int i = 0; i < 5; ++i) {
        const TetId t = random.below(body.mesh().tet_slots());
        if (!body.mesh().alive(t)) continue;
        if (random.below(4) == 0) {
          body.remove(t);
        } else {
          body.split_an_edge_of(t);
        }
      }
      body.commit();
      if (HasFatalFailure() || HasNonfatalFailure()) return;
    }
  }
}

// ---- Clusters that are restored

Archive archived(std::vector<std::uint32_t> listed) {
  Archive out;
  out.list(listed, 4, [&](std::uint32_t& entry) { out(entry); });
  return out;
}

// Whether clusters of a mesh of six tetrahedra, 0 to 5, in pieces 0 and 1 can be restored from such a list: how many clusters; each:
// size, piece, members; blocks, each: size, clusters.
bool restores(const std::vector<std::uint32_t>& listed) {
  const TetMesh mesh(box(1, 1, 1));
  TetClusters clusters(mesh);
  const auto bytes = archived(listed).take();
  Archive in(bytes);
  clusters.archive(in, 2);
  return !in.failed();
}

TEST(TetClusters, RestoredOnesAreTheLivingTetrahedraEachOnce) {
  constexpr std::uint32_t kLinked = 1u << 31;
  EXPECT_TRUE(restores({1, 6, 0, 0, 1, 2, 3, 4, 5}));
  EXPECT_TRUE(restores({2, 2, 1, 4, 1, 4, 0, 0, 5, 3, 2}));
  EXPECT_FALSE(restores({})) << "not even their number";
  EXPECT_FALSE(restores({0})) << "none is in a cluster";
  EXPECT_FALSE(restores({1, 5, 0, 0, 1, 2, 3, 4})) << "tetrahedron 5 is in none";
  EXPECT_FALSE(restores({2, 2, 0, 4, 1, 3, 0, 0, 5, 3})) << "tetrahedron 2 is in none";
  EXPECT_FALSE(restores({2, 2, 0, 4, 1, 5, 0, 0, 5, 3, 2, 4})) << "tetrahedron 4 is in both";
  EXPECT_FALSE(restores({2, 2, 0, 4, 1, 4, 0, 0, 5, 3, 4})) << "tetrahedron 4 is in both, and 2 in none";
  EXPECT_FALSE(restores({1, 7, 0, 0, 1, 2, 3, 4, 5, 6})) << "there is no tetrahedron 6";
  EXPECT_FALSE(restores({1, 7, 0, 0, 1, 2, 3, 4, 5})) << "it ends too early";
  EXPECT_FALSE(restores({2, 0, 0, 6, 0, 0, 1, 2, 3, 4, 5})) << "a cluster of nothing";
  EXPECT_FALSE(restores({1, 6, 2, 0, 1, 2, 3, 4, 5})) << "there is no piece 2";
  const std::vector<std::uint32_t> two{2, 2 | kLinked, 1, 4, 1, 4 | kLinked, 0, 0, 5, 3, 2};
  const auto with_blocks = [&](std::vector<std::uint32_t> blocks) {
    blocks.insert(blocks.begin(), two.begin(), two.end());
    return restores(blocks);
  };
  EXPECT_TRUE(with_blocks({1, 0, 1, 1}));
  EXPECT_FALSE(with_blocks({1, 0, 1, 0})) << "a cluster in two blocks";
  EXPECT_FALSE(with_blocks({1, 2})) << "there is no cluster 2";
  EXPECT_FALSE(with_blocks({2, 0, 1})) << "a block in two pieces";
  EXPECT_FALSE(with_blocks({2, 0})) << "it ends too early";
  EXPECT_FALSE(with_blocks({0})) << "a block of nothing";
  EXPECT_FALSE(restores({2, 2, 0, 4, 1, 4 | kLinked, 0, 0, 5, 3, 2, 1, 0}))
      << "a block of what steps have touched";
}

TEST(TetClusters, RestoredOnesKnowTheirMembersAndNeighbours) {
  const TetMesh mesh(box(20, 12, 10));
  TetClusters before(mesh), after(mesh);
  std::vector<TetClusters::Loose> loose;
  for (const TetId t : {400, 6000}) before.dissolve(t, loose);
  EXPECT_LE(loose.size(), 128u);
  for (const auto& tet : loose) {
    if (!before.has(tet.tet)) before.form(tet);
  }
  Archive out;
  before.archive(out, 1);
  const auto bytes = out.take();
  Archive in(bytes);
  after.archive(in, 1);
  ASSERT_FALSE(in.failed()) << in.error();
  EXPECT_TRUE(in.at_end());
  Archive once_more;
  after.archive(once_more, 1);
  EXPECT_EQ(once_more.take(), bytes);
  // Neighbours, each by a number of its tetrahedra: node ids are others.
  const auto beside = [](const TetClusters& clusters, TetId t) {
    std::vector<std::uint32_t> sizes;
    clusters.visit_beside(clusters.node_of(t),
                          [&](TetClusters::NodeId node) { sizes.push_back(clusters[node].tets); });
    return sizes;
  };
  std::set<std::uint32_t> sizes;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    ASSERT_EQ(after[after.node_of(t)].tets, before[before.node_of(t)].tets) << t;
    ASSERT_EQ(beside(after, t), beside(before, t)) << t;
    sizes.insert(before[before.node_of(t)].tets);
  }
  EXPECT_GT(*sizes.rbegin(), 500u) << "blocks that nothing has touched";
  EXPECT_LE(*sizes.begin(), 32u) << "clusters whose block was given up";
}

// Work units of finding out, by cut faces.
double work_of_halving(int n) {
  TetMesh mesh(box(n, n, n));
  PieceTracker tracker(mesh);
  std::vector<HalfFace> faces;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    for (int f = 0; f < 4; ++f) {
      const HalfFace h = half_face(t, f);
      if (mesh.opposite(h) == kNone || mesh.opposite(h) < h) continue;
      bool on = true;
      for (const VertexId v : mesh.face_vertices(h)) on = on && mesh.position(v).x == n / 2;
      if (on) faces.push_back(h);
    }
  }
  mesh.open_faces(faces);
  Delta delta;
  WorkBudget budget{INT64_MAX};
  tracker.begin();
  EXPECT_TRUE(tracker.advance(budget, delta));
  EXPECT_EQ(delta.pieces.size(), 1u);
  return static_cast<double>(INT64_MAX - budget.left) / static_cast<double>(faces.size());
}

TEST(PieceTracker, CuttingABodyInHalfCostsTheCutAndNotTheHalf) {
  // 8 times the tetrahedra, 4 times the cut.
  EXPECT_LE(work_of_halving(40), 1.15 * work_of_halving(20));
}

}  // namespace
}  // namespace incise::core
