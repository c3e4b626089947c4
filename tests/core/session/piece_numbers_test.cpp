#include "server/core/session/piece_numbers.hpp"

#include <gtest/gtest.h>

#include <map>
#include <set>

#include "server/core/mesh/measure.hpp"
#include "server/core/session/cut_session.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

constexpr double kCell = 0.01;

// A box of 3 x 3 x 3 cubes, and behind it, in y, one of 8 x 3 x 3: two parts.
MeshData two_boxes() {
  MeshData mesh = testing::box(3, 3, 3, kCell);
  const MeshData large = testing::box(8, 3, 3, kCell, {0, 10 * kCell, 0});
  const auto first = static_cast<VertexId>(mesh.positions.size());
  mesh.positions.insert(mesh.positions.end(), large.positions.begin(), large.positions.end());
  for (auto tet : large.tets) {
    for (VertexId& v : tet) v += first;
    mesh.tets.push_back(tet);
  }
  return mesh;
}

// A stroke along y through the large box, from `t_ns` on.
void cut_at(CutSession& session, double x, std::int64_t t_ns) {
  for (int i = 0; i <= 40; ++i) {
    const Pose pose{t_ns + 4'000'000 * i, {x, (5 + 0.5 * i) * kCell, 0}, {}, i < 40 ? 1u : 0u};
    EXPECT_TRUE(accepted(session.push(0, pose)));
  }
  session.end_stroke(0);
  WorkBudget budget = WorkBudget::unlimited();
  Delta delta;
  while (session.advance(budget, delta) != CutSession::Progress::kIdle) {
  }
}

// How many tetrahedra each number has. Checks that every part that hangs together has a number of its own.
std::map<std::uint32_t, std::uint32_t> sizes(const TetMesh& mesh, const std::vector<std::uint32_t>& numbers) {
  std::uint32_t parts = 0;
  const std::vector<std::uint32_t> part = label_pieces(mesh, &parts);
  std::map<std::uint32_t, std::uint32_t> sizes;
  std::set<std::pair<std::uint32_t, std::uint32_t>> pairs;
  EXPECT_EQ(numbers.size(), mesh.tet_slots());
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    EXPECT_EQ(numbers[t] != kNone, mesh.alive(t));
    if (!mesh.alive(t)) continue;
    ++sizes[numbers[t]];
    pairs.insert({part[t], numbers[t]});
  }
  EXPECT_EQ(pairs.size(), parts);
  EXPECT_EQ(sizes.size(), parts);
  return sizes;
}

TEST(PieceNumbers, TheLargestOfThePartsOfAPieceKeepsItsId) {
  const TetMesh mesh(two_boxes());
  const std::map<std::uint32_t, std::uint32_t> expected{{0, 6 * 72}, {1, 6 * 27}};
  EXPECT_EQ(sizes(mesh, piece_numbers(mesh)), expected);
  EXPECT_EQ(piece_numbers(CutSession(two_boxes(), {})), piece_numbers(mesh));
  // As large as each other: the first one.
  const TetMesh twins(
      MeshData{{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, {5, 0, 0}, {6, 0, 0}, {5, 1, 0}, {5, 0, 1}},
               {{0, 1, 2, 3}, {4, 5, 6, 7}},
               {}});
  EXPECT_EQ(piece_numbers(twins), (std::vector<std::uint32_t>{0, 1}));
}

TEST(PieceNumbers, AreTheIdsOfTheSession) {
  CutConfig config;
  config.blade = {{0, 0, -0.02}, {0, 0, 0.08}};
  CutSession session(two_boxes(), config);
  std::uint32_t cuts = 0;
  for (const double x : {2.47, 5.53}) {
    cut_at(session, x * kCell, cuts * 1'000'000'000);
    ++cuts;
    const std::vector<std::uint32_t> numbers = piece_numbers(session);
    EXPECT_EQ(sizes(session.mesh(), numbers).size(), cuts + 2);
    const TetId small = 0;  // in the part that no cut touches
    EXPECT_EQ(session.piece(small), 0u);
    EXPECT_EQ(numbers[small], cuts + 1) << "behind the highest id";
    for (TetId t = 0; t < session.mesh().tet_slots(); ++t) {
      if (session.mesh().alive(t) && numbers[t] != numbers[small]) {
        ASSERT_EQ(numbers[t], session.piece(t)) << t;
      }
    }
    EXPECT_EQ(session.pieces().size(), cuts);
    for (const Delta::Piece& piece : session.pieces()) EXPECT_EQ(numbers[piece.tet], piece.id);
  }
}

TEST(PieceNumbers, AMeshWithoutTetrahedraHasNone) {
  TetMesh mesh(testing::one_tet());
  mesh.remove_tet(0);
  EXPECT_EQ(piece_numbers(mesh), std::vector<std::uint32_t>{kNone});
}

}  // namespace
}  // namespace incise::core
