#include "server/core/cut/conforming/seen_edges.hpp"

#include <gtest/gtest.h>

#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using Seen = SeenEdges::Seen;

// In the first round of a batch.
class SeenEdgesTest : public ::testing::Test {
 protected:
  SeenEdgesTest() {
    edges_.begin_batch(workspace_.next_serial());
    edges_.begin_round(workspace_.next_serial());
  }

  const TetMesh mesh_{testing::box(2, 2, 2)};
  CutWorkspace workspace_{mesh_};
  SeenEdges edges_{workspace_};
};

TEST_F(SeenEdgesTest, an_edge_is_known_from_both_ends_until_one_of_them_moves_or_a_batch_begins) {
  EXPECT_EQ(edges_.look_up(3, 5), Seen::kNot);
  edges_.add(5, 3, true);
  EXPECT_EQ(edges_.look_up(3, 5), Seen::kClear);
  EXPECT_EQ(edges_.look_up(5, 3), Seen::kClear);
  EXPECT_EQ(edges_.look_up(3, 4), Seen::kNot);
  ++workspace_.vertices[5].moves;
  EXPECT_EQ(edges_.look_up(3, 5), Seen::kNot);
  edges_.add(3, 5, true);
  EXPECT_EQ(edges_.look_up(3, 5), Seen::kClear);
  edges_.begin_batch(workspace_.next_serial());
  EXPECT_EQ(edges_.look_up(3, 5), Seen::kNot);
}

TEST_F(SeenEdgesTest, one_that_is_crossed_is_known_for_a_round_and_a_clear_one_for_all) {
  edges_.add(3, 5, false);
  edges_.add(4, 6, true);
  EXPECT_EQ(edges_.look_up(5, 3), Seen::kCrossed);
  edges_.begin_round(workspace_.next_serial());
  EXPECT_EQ(edges_.look_up(5, 3), Seen::kNot);
  EXPECT_EQ(edges_.look_up(4, 6), Seen::kClear);
}

}  // namespace
}  // namespace incise::core
