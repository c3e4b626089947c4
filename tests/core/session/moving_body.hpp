#pragma once

#include <gtest/gtest.h>

#include <cstdint>
#include <functional>
#include <memory>
#include <utility>
#include <vector>

#include "server/core/session/cut_session.hpp"
#include "tests/core/test_meshes.hpp"

// What tests of bodies that a host simulation moves have in common.
namespace incise::core::testing {

inline constexpr double kCell = 0.01;

inline MeshData body() {
  return shaken_box(8, 6, 6, 1, 0.1, kCell);
}

inline CutConfig config(const Vec3& heel = {0, 0, -0.1}, const Vec3& tip = {0, 0, 0.2}) {
  CutConfig c;
  c.blade = {heel, tip};
  return c;
}

inline Pose at(std::int64_t t_ms, const Vec3& position, bool engaged = true) {
  return {t_ms * 1'000'000, position, {}, engaged ? 1u : 0u};
}

// All vertices of the mesh, where `where` puts them.
inline std::shared_ptr<VertexPositions> all(const CutSession& session,
                                            const std::function<Vec3(VertexId, const Vec3&)>& where) {
  auto made = std::make_shared<VertexPositions>();
  made->frame = 7;
  made->revision = session.revision();
  for (VertexId v = 0; v < session.mesh().vertex_slots(); ++v)
    made->positions.push_back(where(v, session.mesh().position(v)));
  return made;
}

inline std::shared_ptr<VertexPositions> some(std::uint64_t revision, std::vector<VertexId> ids,
                                             std::vector<Vec3> positions) {
  auto made = std::make_shared<VertexPositions>();
  made->revision = revision;
  made->ids = std::move(ids);
  made->positions = std::move(positions);
  return made;
}

// Deltas until nothing waits, `units` of work at a time.
inline std::vector<Delta> run_all(CutSession& session, std::int64_t units = INT64_MAX) {
  std::vector<Delta> deltas;
  for (;;) {
    WorkBudget budget{units};
    Delta delta;
    const auto progress = session.advance(budget, delta);
    if (progress == CutSession::Progress::kIdle) return deltas;
    if (progress == CutSession::Progress::kCommitted) deltas.push_back(std::move(delta));
  }
}

inline Delta deform(CutSession& session, std::shared_ptr<const VertexPositions> positions) {
  session.deform(std::move(positions));
  auto deltas = run_all(session);
  EXPECT_EQ(deltas.size(), 1u);
  return std::move(deltas.back());
}

}  // namespace incise::core::testing
