#include "server/core/cut/conforming/seen_edges.hpp"

#include <gtest/gtest.h>

#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using Seen = SeenEdges::Seen;

TEST(SeenEdges, an_edge_is_known_from_both_ends_until_one_of_them_moves_or_a_batch_begins) {
  const TetMesh mesh(testing::box(2, 2, 2));
  CutWorkspace workspace(mesh);
  SeenEdges edges(workspace);
  edges.begin_batch(workspace.next_serial());
  edges.begin_round(workspace.next_serial());
  EXPECT_EQ(edges.look_up(3, 5), Seen::kNot);
  edges.add(5, 3, true);
  EXPECT_EQ(edges.look_up(3, 5), Seen::kClear);
  EXPECT_EQ(edges.look_up(5, 3), Seen::kClear);
  EXPECT_EQ(edges.look_up(3, 4), Seen::kNot);
  ++workspace.vertices[5].moves;
  EXPECT_EQ(edges.look_up(3, 5), Seen::kNot);
  edges.add(3, 5, true);
  EXPECT_EQ(edges.look_up(3, 5), Seen::kClear);
  edges.begin_batch(workspace.next_serial());
  EXPECT_EQ(edges.look_up(3, 5), Seen::kNot);
}

TEST(SeenEdges, one_that_is_crossed_is_known_for_a_round_and_a_clear_one_for_all) {
  const TetMesh mesh(testing::box(2, 2, 2));
  CutWorkspace workspace(mesh);
  SeenEdges edges(workspace);
  edges.begin_batch(workspace.next_serial());
  edges.begin_round(workspace.next_serial());
  edges.add(3, 5, false);
  edges.add(4, 6, true);
  EXPECT_EQ(edges.look_up(5, 3), Seen::kCrossed);
  edges.begin_round(workspace.next_serial());
  EXPECT_EQ(edges.look_up(5, 3), Seen::kNot);
  EXPECT_EQ(edges.look_up(4, 6), Seen::kClear);
}

}  // namespace
}  // namespace incise::core
