// Which vertices a deformation holds back, and what a step says of them.

#include <gtest/gtest.h>

#include <cmath>
#include <memory>

#include "server/core/mesh/measure.hpp"
#include "server/core/session/cut_session.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

std::vector<VertexId> held(CutSession& session, std::vector<VertexId> ids, std::vector<Vec3> positions) {
  auto made = std::make_shared<VertexPositions>();
  made->revision = session.revision();
  made->ids = std::move(ids);
  made->positions = std::move(positions);
  session.deform(made);
  static Delta delta;  // one for all steps, as the server's
  auto budget = WorkBudget::unlimited();
  EXPECT_EQ(session.advance(budget, delta), CutSession::Progress::kCommitted);
  return delta.deformation.held;
}

TEST(HeldVertices, AreNamedInOrderAndForTheirStepOnly) {
  CutSession session(testing::box(3, 3, 3, 0.01), {});
  const VertexId last = session.mesh().vertex_slots() - 1;
  // The first one would turn its tetrahedra inside out, which is found after the other, which is no place.
  EXPECT_EQ(held(session, {0, last}, {{0.1, 0.1, 0.1}, {NAN, 0, 0}}), (std::vector<VertexId>{0, last}));
  EXPECT_EQ(held(session, {last}, {session.mesh().position(last) + Vec3{1e-4, 0, 0}}),
            std::vector<VertexId>{});
  EXPECT_EQ(held(session, {last}, {session.mesh().position(last) + Vec3{1e-4, 0, 0}}),
            std::vector<VertexId>{});
}

TEST(HeldVertices, APlaceLiesWithinTenKilometres) {
  // A body far out, whose corner may go as far as the limit.
  MeshData data = testing::box(1, 1, 1, 1);
  for (Vec3& p : data.positions) p.x += kFarthest_m - 2;
  CutSession session(data, {});
  VertexId corner = 0;
  for (VertexId v = 0; v < session.mesh().vertex_slots(); ++v) {
    const Vec3& p = session.mesh().position(v);
    if (p.x > kFarthest_m - 1.5 && p.y == 0 && p.z == 0) corner = v;
  }
  EXPECT_EQ(held(session, {corner}, {{kFarthest_m - 0.5, 0, 0}}), std::vector<VertexId>{});
  EXPECT_EQ(held(session, {corner}, {{kFarthest_m + 0.5, 0, 0}}), std::vector<VertexId>{corner});
}

// ---- What is an island ----

// So many tetrahedra around an edge, each joined to the next by a face.
MeshData fan(std::uint32_t count) {
  MeshData data;
  data.positions = {{0, 0, 0}, {0, 0, 1}};
  for (std::uint32_t i = 0; i <= count; ++i)
    data.positions.push_back({std::cos(0.5 * i), std::sin(0.5 * i), 0.5});
  for (std::uint32_t i = 0; i < count; ++i) data.tets.push_back({0, 1, 2 + i, 3 + i});
  return data;
}

TEST(Islands, HaveEightTetrahedraAtMost) {
  for (const std::uint32_t count : {kLargestIsland, kLargestIsland + 1}) {
    const CutReport report = measure(TetMesh(fan(count)));
    EXPECT_EQ(report.pieces, 1u);
    EXPECT_EQ(report.inverted, 0u);
    EXPECT_EQ(report.islands, count == kLargestIsland ? 1u : 0u);
  }
}

}  // namespace
}  // namespace incise::core
