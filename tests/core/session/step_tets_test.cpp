// What a step of a host simulation looks at: all tetrahedra (StepTets), first in 32 bits (TargetPositions).

#include "server/core/session/step_tets.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <vector>

#include "server/core/mesh/measure.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/core/session/piece_tracker.hpp"
#include "server/core/session/target_positions.hpp"
#include "tests/core/session/moving_body.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using testing::at;
using testing::body;
using testing::config;
using testing::kCell;
using testing::Random;
using testing::run_all;

// What a step looks at is what the mesh has, whatever was cut since the last one.
TEST(StepTets, FollowCuts) {
  CutSession session(body(), config());
  const TetMesh& mesh = session.mesh();
  const PieceTracker pieces(mesh);
  StepTets tets(mesh, pieces.clusters());
  for (int i = 0; i <= 60; ++i) {
    session.push(0, at(1 + 8 * i, Vec3{-0.04 + 0.17 * i / 50, 0.03, 0.01 * (i % 3)}, i < 60));
    for (const Delta& delta : run_all(session)) tets.follow(delta);
    if (i % 4 != 0) continue;
    for (WorkBudget budget{3}; !tets.catch_up(budget); budget = {3}) {
    }
    std::size_t alive = 0;
    for (std::size_t slot = 0; slot < tets.size(); ++slot) alive += tets.alive_64(slot) >> (slot % 64) & 1;
    ASSERT_EQ(alive, mesh.live_tets());
    std::vector<TetId> boundary, seen;
    for (TetId t = 0; t < mesh.tet_slots(); ++t) {
      const std::uint32_t slot = tets.slot_of(t);
      ASSERT_EQ(slot != kNone && (tets.alive_64(slot) >> (slot % 64) & 1) != 0, mesh.alive(t)) << t;
      if (!mesh.alive(t)) continue;
      ASSERT_EQ(tets.vertices(slot), mesh.vertices(t)) << t;
      if (mesh.on_boundary(t)) boundary.push_back(t);
    }
    std::size_t next = 0;
    const auto see = [&](TetId t, const std::array<VertexId, 4>& vertices) {
      seen.push_back(t);
      EXPECT_EQ(vertices, mesh.vertices(t)) << t;
    };
    for (WorkBudget budget{3}; !tets.visit_boundary(next, budget, see); budget = {3}) {
    }
    ASSERT_EQ(seen, boundary) << i;
  }
  EXPECT_GT(measure(mesh).cut_faces, 100u);
}

// In whatever order a file has tetrahedra and vertices, those that are looked at together share vertices: 64 have some 250 corners, and
// in a file's order nearly as many vertices.
TEST(StepTets, StandNearTheirNeighbours) {
  constexpr std::uint64_t kSeed = 12;
  Random random(kSeed);
  MeshData data = testing::shaken_box(20, 20, 20, 1, 0.1, kCell);
  for (std::size_t i = data.tets.size() - 1; i > 0; --i)
    std::swap(data.tets[i], data.tets[random.below(static_cast<std::uint32_t>(i + 1))]);
  const TetMesh mesh(data);
  const PieceTracker pieces(mesh);
  StepTets tets(mesh, pieces.clusters());
  for (WorkBudget budget{3}; !tets.catch_up(budget); budget = {3}) {
  }
  ASSERT_EQ(tets.size(), mesh.tet_slots());
  std::size_t met = 0;
  for (std::size_t first = 0; first < tets.size(); first += 64) {
    std::vector<VertexId> vertices;
    for (std::size_t slot = first; slot < std::min(first + 64, tets.size()); ++slot)
      vertices.insert(vertices.end(), tets.vertices(slot).begin(), tets.vertices(slot).end());
    std::ranges::sort(vertices);
    vertices.erase(std::unique(vertices.begin(), vertices.end()), vertices.end());
    met += vertices.size();
  }
  EXPECT_LT(met, tets.size()) << "seed " << kSeed;
}

// The quick look never calls a tetrahedron thick that is not, and hardly ever leaves a thick one to exact arithmetic.
TEST(TargetPositions, WhatIsSurelyThickIsThick) {
  constexpr std::uint64_t kSeed = 11;
  Random random(kSeed);
  for (const double distance : {0.0, 1.0, 1e4}) {
    const Vec3 away = distance * random.direction();
    TargetPositions positions;
    positions.push_back(away);
    std::vector<std::array<VertexId, 4>> tets;
    for (int i = 0; i < 4000; ++i) {
      // About as thick as the limit, or a thousand times thinner, or turned inside out; some far from the first vertex.
      const Vec3 at = away + (i % 3 == 0 ? 100 : 1) * kCell * random.direction();
      const double height = kCell * (i % 4 == 0 ? -0.1 : i % 4 == 1 ? 1e-4 : random.uniform(0.05, 0.15));
      const Vec3 corners[4] = {at, at + Vec3{kCell, 0, 0}, at + Vec3{0, kCell, 0}, at + Vec3{0, 0, height}};
      std::array<VertexId, 4> tet{};
      for (int k = 0; k < 4; ++k) {
        tet[k] = static_cast<VertexId>(positions.size());
        positions.push_back(corners[k]);
      }
      tets.push_back(tet);
    }
    positions.set(0, away + Vec3{kCell, kCell, kCell});
    const double thick = 0.064 * kCell * kCell * kCell;
    positions.begin_looking(thick, 8 * kCell);
    int are = 0, seen = 0;
    for (std::size_t i = 0; i < tets.size(); ++i) {
      const auto& v = tets[i];
      const Vec3& a = positions[v[0]];
      const double volumes = dot(cross(positions[v[1]] - a, positions[v[2]] - a), positions[v[3]] - a);
      const std::size_t first = i / 40 * 40;
      const std::uint64_t thick_40 = positions.surely_thick(&tets[first], 40);
      ASSERT_EQ(
          positions.surely_thick(&tets[first], 40, tets.size() - first - 40, TargetPositions::look_anywhere),
          thick_40);
      ASSERT_EQ(positions.surely_thick(&tets[first], 39), thick_40 & 0xffffffff) << "too few at the end";
      const bool surely = (thick_40 >> (i - first) & 1) != 0;
      if (surely) {
        EXPECT_GE(volumes, thick) << "seed " << kSeed;
      }
      are += volumes >= thick;
      seen += surely;
    }
    EXPECT_GT(are, 1000);
    EXPECT_GT(seen, 3 * are / 4) << distance;
  }
  // Longer edges than it can vouch for.
  TargetPositions positions;
  for (const Vec3& p : {Vec3{}, Vec3{1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}}) positions.push_back(p);
  const std::vector<std::array<VertexId, 4>> same(8, {0, 1, 2, 3});
  positions.begin_looking(1e-3, 1.7);
  EXPECT_EQ(positions.surely_thick(same.data(), 8), 0u);
  positions.begin_looking(1e-3, 1.8);
  EXPECT_EQ(positions.surely_thick(same.data(), 8), 0xffu);
}

}  // namespace
}  // namespace incise::core
