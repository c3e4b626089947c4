#include "server/core/cut/conforming/clear_edges.hpp"

#include <gtest/gtest.h>

#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

TEST(ClearEdges, an_edge_is_known_from_both_ends_until_one_of_them_moves_or_a_batch_begins) {
  const TetMesh mesh(testing::box(2, 2, 2));
  CutWorkspace workspace(mesh);
  ClearEdges edges(workspace);
  edges.begin(workspace.next_serial());
  EXPECT_FALSE(edges.has(3, 5));
  edges.add(5, 3);
  EXPECT_TRUE(edges.has(3, 5));
  EXPECT_TRUE(edges.has(5, 3));
  EXPECT_FALSE(edges.has(3, 4));
  ++workspace.vertices[5].moves;
  EXPECT_FALSE(edges.has(3, 5));
  edges.add(3, 5);
  EXPECT_TRUE(edges.has(3, 5));
  edges.begin(workspace.next_serial());
  EXPECT_FALSE(edges.has(3, 5));
}

}  // namespace
}  // namespace incise::core
