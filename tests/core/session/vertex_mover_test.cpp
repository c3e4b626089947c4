#include "server/core/session/vertex_mover.hpp"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "server/core/mesh/measure.hpp"
#include "server/core/mesh/validate.hpp"
#include "server/core/session/cut_session.hpp"
#include "server/core/session/session_state.hpp"
#include "tests/core/session/moving_body.hpp"
#include "tests/core/test_meshes.hpp"

namespace incise::core {
namespace {

using testing::all;
using testing::at;
using testing::body;
using testing::config;
using testing::deform;
using testing::kCell;
using testing::PlainModel;
using testing::Random;
using testing::run_all;
using testing::some;

// ---- A step by itself

TEST(VertexMover, AStepIsARevisionWithMovedVertices) {
  CutSession session(body(), config());
  PlainModel model(session.mesh());
  session.deform(all(session, [](VertexId, const Vec3& p) { return p + Vec3{0.001, 0, 0.5 * p.x}; }));
  EXPECT_TRUE(session.deformation_waits());
  EXPECT_EQ(session.backlog_batches(), 1u);
  const auto deltas = run_all(session);
  ASSERT_EQ(deltas.size(), 1u);
  const Delta& delta = deltas[0];
  EXPECT_FALSE(session.deformation_waits());
  EXPECT_EQ(delta.revision, 1u);
  EXPECT_EQ(delta.stroke, 0u);
  EXPECT_EQ(delta.deformation.frame, 7u);
  EXPECT_EQ(delta.deformation.moved, session.mesh().vertex_slots());
  EXPECT_EQ(delta.deformation.passed_over, 0u);
  EXPECT_TRUE(delta.deformation.held.empty());
  EXPECT_EQ(delta.moved.size(), session.mesh().vertex_slots());
  EXPECT_TRUE(delta.moved_rest.empty());
  model.apply(delta);
  EXPECT_EQ(model.hash(), delta.state_hash);
  model.expect_equals(session.mesh());
  EXPECT_EQ(validate(session.mesh()), "");
  const MeshData rest = body();
  for (VertexId v = 0; v < session.mesh().vertex_slots(); ++v)
    ASSERT_EQ(session.mesh().rest_position(v), rest.positions[v]);

  // The same once more: nothing moves, and that is a revision, too.
  const Delta again = deform(session, all(session, [](VertexId, const Vec3& p) { return p; }));
  EXPECT_EQ(again.revision, 2u);
  EXPECT_TRUE(again.moved.empty());
  EXPECT_EQ(again.state_hash, delta.state_hash);
}

TEST(VertexMover, WhatIsNoPlaceOrNoVertexChangesNothing) {
  CutSession session(body(), config());
  const double nan = std::nan("");
  const std::uint64_t hash = session.mesh().state_hash();
  const std::uint32_t n = session.mesh().vertex_slots();
  const Delta delta = deform(
      session, some(0, {3, 4, 5, n, n + 9}, {{nan, 0, 0}, {0, INFINITY, 0}, {1e300, 0, 0}, {}, {0, 0, 1}}));
  EXPECT_EQ(delta.deformation.moved, 0u);
  EXPECT_EQ(delta.deformation.held, (std::vector<VertexId>{3, 4, 5}));
  EXPECT_EQ(delta.deformation.passed_over, 2u);
  EXPECT_EQ(delta.state_hash, hash);
  // Ids twice or out of order: the later ones count for nothing.
  const Vec3 near = session.mesh().position(8) + Vec3{0, 0, 1e-4};
  deform(session, some(0, {8, 8, 2}, {near, {1, 1, 1}, {2, 2, 2}}));
  EXPECT_EQ(session.mesh().position(8), near);
  EXPECT_EQ(validate(session.mesh()), "");
  const Delta none = deform(session, std::make_shared<VertexPositions>());
  EXPECT_EQ(none.deformation.passed_over, 0u) << "those of the step before do not count again";
  EXPECT_EQ(session.revision(), 3u);
}

// A vertex that is pushed out of its star goes half the way if that is inside, else it stays; others go.
TEST(VertexMover, TetrahedraNeverInvert) {
  CutSession session(testing::box(8, 8, 8, kCell), config());
  const auto vertex = [](int i, int j, int k) { return static_cast<VertexId>((k * 9 + j) * 9 + i); };
  const VertexId half = vertex(6, 6, 2), stays = vertex(2, 2, 2), goes = vertex(2, 2, 6);
  const Vec3 before = session.mesh().position(half);
  const Delta delta =
      deform(session, some(0, {stays, half, goes},
                           {session.mesh().position(stays) + Vec3{0.05, 0, 0}, before + Vec3{0.012, 0, 0},
                            session.mesh().position(goes) + Vec3{0.003, 0, 0}}));
  EXPECT_EQ(delta.deformation.held, (std::vector<VertexId>{stays, half}));
  EXPECT_EQ(delta.deformation.moved, 2u);
  EXPECT_EQ(session.mesh().position(half), lerp(before, before + Vec3{0.012, 0, 0}, 0.5));
  EXPECT_EQ(validate(session.mesh()), "");

  // Whatever is sent, of however many vertices: a scramble, a mirror image, a collapse to a point.
  constexpr std::uint64_t kSeed = 5;
  Random random(kSeed);
  for (int round = 0; round < 60; ++round) {
    const double size = std::pow(10.0, random.uniform(-5, 0));
    const int kind = round % 4;
    auto sent = all(session, [&](VertexId, const Vec3& p) {
      if (kind == 1) return Vec3{-p.x, p.y, p.z};
      if (kind == 2) return Vec3{0.01, 0.01, 0.01};
      return p + random.in_box({-size, -size, -size}, {size, size, size});
    });
    if (kind == 3) {
      sent->ids = {random.below(60), 60 + random.below(60)};
      sent->positions.resize(2);
    }
    deform(session, sent);
    ASSERT_EQ(validate(session.mesh()), "") << "seed " << kSeed << ", round " << round;
  }
}

// Towards a neighbour, the whole way but a ten thousandth would leave tetrahedra that stand the right way up, but flat.
TEST(VertexMover, TetrahedraNeverGetFlat) {
  const VertexId v = (4 * 9 + 4) * 9 + 4;
  for (const bool flat : {false, true}) {
    CutSession session(testing::box(8, 8, 8, kCell), config());
    const Vec3 before = session.mesh().position(v);
    const Vec3 wanted = before + Vec3{(flat ? 0.9999 : 0.99) * kCell, 0, 0};
    const Delta delta = deform(session, some(0, {v}, {wanted}));
    EXPECT_EQ(session.mesh().position(v), flat ? lerp(before, wanted, 0.5) : wanted);
    EXPECT_EQ(delta.deformation.held.size(), flat ? 1u : 0u);
    EXPECT_EQ(validate(session.mesh()), "");
  }
}

// The longest edge of all, m.
double longest_edge(const TetMesh& mesh) {
  double longest = 0;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    if (!mesh.alive(t)) continue;
    const auto& v = mesh.vertices(t);
    for (int i = 1; i < 4; ++i)
      for (int j = 0; j < i; ++j)
        longest = std::max(longest, length(mesh.position(v[i]) - mesh.position(v[j])));
  }
  return longest;
}

// A solver that has diverged, or one of another place: the body jumps by metres. Alone it goes there; where some of it has to stay (it was
// cut since, or a blade stands in it) the rest stays with it, and the grid does not fill with what would lie between.
TEST(VertexMover, TetrahedraAreNotStretchedByMetres) {
  for (const bool cut : {false, true}) {
    for (const bool blade_stands : {false, true}) {
      CutSession session(body(), config());
      const auto jump = [&] {
        return all(session, [](VertexId, const Vec3& p) { return p + Vec3{3, 2, 1}; });
      };
      auto positions = jump();
      if (cut) {
        for (int i = 0; i <= 50; ++i)
          session.push(0, at(1 + 8 * i, {-0.02 + 0.06 * i / 50, 0.03, 0}, blade_stands || i < 50));
        run_all(session);
        if (blade_stands) {
          for (int i = 51; i < 120; ++i) session.push(0, at(1 + 8 * i, {0.04, 0.03, 0}));
          run_all(session);
          positions = jump();
        }
      }
      const std::size_t entries = session.boundary().entries();
      const double before = longest_edge(session.mesh());
      const Delta delta = deform(session, positions);
      // What the simulation does not know goes along, what clings to a blade that stands does not.
      EXPECT_EQ(delta.deformation.held.empty(), !cut || !blade_stands);
      EXPECT_LE(longest_edge(session.mesh()), std::max(before, 16 * session.mesh().mean_edge_length()));
      EXPECT_LT(session.boundary().entries(), 2 * entries + 65536);
      EXPECT_EQ(validate(session.mesh()), "");
      session.end_stroke(0);
      run_all(session);
      // Known again, and free of the blade, it goes.
      const Vec3 corner = session.mesh().position(0);
      EXPECT_TRUE(deform(session, jump()).deformation.held.empty());
      EXPECT_EQ(session.mesh().position(0), (corner + Vec3{3, 2, 1}));
      EXPECT_EQ(validate(session.mesh()), "");
    }
  }
}

// One vertex that goes far away takes no tetrahedron with it beyond that, however long it goes on.
TEST(VertexMover, ASpikeEndsWhereItsTetrahedraAreStretched) {
  CutSession session(testing::box(8, 8, 8, kCell), config());
  const VertexId corner = 0;
  const double most = 16 * session.mesh().mean_edge_length();
  for (int i = 1; i <= 60; ++i)
    deform(session,
           some(session.revision(), {corner}, {session.mesh().position(corner) - Vec3{kCell, kCell, kCell}}));
  const double longest = longest_edge(session.mesh());
  EXPECT_LE(longest, most);
  EXPECT_GT(longest, 0.9 * most);
  // And back.
  const Delta back =
      deform(session, some(session.revision(), {corner}, {session.mesh().rest_position(corner)}));
  EXPECT_TRUE(back.deformation.held.empty());
  EXPECT_EQ(session.mesh().position(corner), session.mesh().rest_position(corner));
}

// What is flat already is strained with the body around it, unless it loses more than half.
TEST(VertexMover, WhatIsFlatHoldsNothingBack) {
  const VertexId v = (4 * 9 + 4) * 9 + 4;
  for (const double part : {0.8, 0.4}) {
    MeshData mesh = testing::box(8, 8, 8, kCell);
    mesh.positions[v].x += 0.9999 * kCell;
    CutSession session(mesh, config());
    const Delta delta = deform(session, all(session, [&](VertexId, const Vec3& p) {
                                 return Vec3{part * p.x, p.y, p.z};
                               }));
    EXPECT_EQ(delta.deformation.held.empty(), part > 0.5) << part;
    EXPECT_EQ(validate(session.mesh()), "");
  }
}

// At rest it is as flat as that, and thicker where the body is strained: it comes back with all the others.
TEST(VertexMover, WhatIsFlatAtRestComesBackToRest) {
  const VertexId v = (4 * 9 + 4) * 9 + 4;
  MeshData mesh = testing::box(8, 8, 8, kCell);
  mesh.positions[v].x += 0.9999 * kCell;
  CutSession session(mesh, config());
  const Vec3 there = session.mesh().position(v) - Vec3{0.5 * kCell, 0, 0};
  EXPECT_TRUE(deform(session, some(0, {v}, {there})).deformation.held.empty());
  EXPECT_EQ(session.mesh().position(v), there);
  const Delta delta =
      deform(session, all(session, [&](VertexId w, const Vec3&) { return session.mesh().rest_position(w); }));
  EXPECT_TRUE(delta.deformation.held.empty());
  EXPECT_EQ(session.mesh().position(v), mesh.positions[v]);
  EXPECT_EQ(validate(session.mesh()), "");
}

// ---- Among cuts

// A motion of the whole body that bends and sways it, up to a third of an edge a step.
Vec3 sway(const Vec3& rest, double t) {
  const double bend = 0.6 * std::sin(t) * rest.x * rest.x / 0.08;
  return {rest.x + 0.1 * std::sin(0.7 * t) * rest.y, rest.y + 0.01 * std::sin(1.3 * t) + 0.3 * bend,
          rest.z + bend + 0.1 * std::cos(t) * rest.x};
}

// The simulation that sends it: it knows where the material of each vertex is at rest.
std::shared_ptr<VertexPositions> swayed(const CutSession& session, double t) {
  return all(session, [&](VertexId v, const Vec3&) { return sway(session.mesh().rest_position(v), t); });
}

// What happens to a session: strokes, and a body that moves between any two poses.
std::vector<std::function<void(CutSession&)>> happenings(std::uint64_t seed) {
  std::vector<std::function<void(CutSession&)>> calls;
  auto random = std::make_shared<Random>(seed);
  for (int i = 0; i <= 300; ++i) {
    const double s = i / 300.0, wave = std::sin(9 * s);
    const Pose pose = at(1 + 4 * i, {-0.02 + 0.12 * s, 0.03 + 0.015 * wave, 0}, i % 110 != 109);
    const Pose other = at(1 + 4 * i, {0.04 + 0.02 * wave, 0.08 - 0.1 * s, 0});
    calls.emplace_back([=](CutSession& session) { session.push(0, pose), session.push(1, other); });
    if (i % 3 == 1) {
      calls.emplace_back([=](CutSession& session) { session.deform(swayed(session, 0.02 * i)); });
    }
    if (i % 17 == 5) {
      // Wild ones in between, and late ones.
      const double d = random->uniform(0, 0.02);
      const std::uint64_t noise = random->next();
      calls.emplace_back([=](CutSession& session) {
        Random some_noise(noise);
        auto sent = all(session, [&](VertexId, const Vec3& p) {
          return p +
                 (some_noise.below(9) == 0 ? some_noise.in_box({-d, -d, -d}, {d, d, d}) : Vec3{1e-5, 0, 0});
        });
        sent->revision = session.revision() - std::min<std::uint64_t>(session.revision(), i % 4);
        session.deform(sent);
      });
    }
  }
  calls.emplace_back([](CutSession& session) { session.end_stroke(0), session.end_stroke(1); });
  return calls;
}

// The same calls give the same bits with any budget, and in a session that is saved and restored all the time; the mesh
// is valid after each step, and the deltas say all.
TEST(VertexMover, CutsInAMovingBodyAreValidAndDeterministic) {
  for (const std::uint64_t seed : {1u, 2u}) {
    std::vector<std::uint64_t> hashes;
    std::size_t deformations = 0, held = 0, passed_over = 0;
    {
      CutSession session(body(), config());
      PlainModel model(session.mesh());
      for (const auto& call : happenings(seed)) {
        call(session);
        for (const Delta& delta : run_all(session)) {
          hashes.push_back(delta.state_hash);
          model.apply(delta);
          ASSERT_EQ(model.hash(), delta.state_hash) << "seed " << seed << ", revision " << delta.revision;
          if (delta.stroke != 0) {
            ASSERT_EQ(delta.moved_rest.size(), session.mesh().deformed() ? delta.moved.size() : 0);
            continue;
          }
          ++deformations;
          held += delta.deformation.held.size();
          passed_over += delta.deformation.passed_over;
        }
        ASSERT_EQ(validate(session.mesh()), "") << "seed " << seed << ", revision " << session.revision();
      }
      model.expect_equals(session.mesh());
      EXPECT_GT(measure(session.mesh()).cut_faces, 100u);
    }
    EXPECT_GT(deformations, 100u);
    EXPECT_GT(held, 500u);
    EXPECT_GT(passed_over, 10u);
    auto session = std::make_unique<CutSession>(body(), config());
    std::vector<std::uint64_t> again;
    int calls = 0;
    for (const auto& call : happenings(seed)) {
      call(*session);
      for (const Delta& delta : run_all(*session, 1 + calls % 40)) again.push_back(delta.state_hash);
      if (++calls % 11 != 0) continue;
      std::string error;
      session = restore_session(save_session(*session), session->config(), error);
      ASSERT_TRUE(session) << error;
    }
    EXPECT_EQ(again, hashes) << "seed " << seed;
  }
}

// A session that is told what gave way in another looks at no tetrahedron again, and is the same to the last byte that is saved, its grid
// included.
TEST(VertexMover, WhatIsKnownIsNotLookedForAgain) {
  for (const std::uint64_t seed : {1u, 2u}) {
    CutSession session(body(), config());
    CutSession other(body(), config());
    std::size_t whole = 0, half = 0, stayed = 0, unhindered = 0, calls = 0;
    for (const auto& call : happenings(seed)) {
      call(session);
      call(other);
      for (Delta delta;;) {
        auto budget = WorkBudget::unlimited();
        if (session.advance(budget, delta) != CutSession::Progress::kCommitted) break;
        const std::vector<GaveWay> known = session.gave_way();
        const std::uint64_t before = other.tets_checked();
        Delta again;
        ASSERT_EQ(other.advance(budget, again, &known), CutSession::Progress::kCommitted);
        ASSERT_EQ(again.state_hash, delta.state_hash) << "seed " << seed << ", revision " << delta.revision;
        ASSERT_EQ(again.deformation.held, delta.deformation.held);
        ASSERT_EQ(again.moved, delta.moved);
        if (delta.stroke != 0) continue;
        ASSERT_EQ(other.gave_way(), known);
        if (delta.moved.size() <= session.mesh().tet_slots() / 16) continue;
        ++whole;
        unhindered += known.empty();
        for (const GaveWay& gave : known) (gave.stays ? stayed : half) += 1;
        EXPECT_EQ(other.tets_checked(), before);
      }
      if (++calls % 7 == 0) {
        ASSERT_EQ(save_session(other), save_session(session)) << "seed " << seed;
      }
    }
    EXPECT_GT(whole, 50u);
    EXPECT_GT(unhindered, 10u);
    EXPECT_GT(half, 20u);
    EXPECT_GT(stayed, 20u);
    EXPECT_GT(session.tets_checked(), 0u);
    EXPECT_EQ(save_session(other), save_session(session)) << "seed " << seed;
  }
}

// A blade that goes right through separates a body that moves while it is cut: none of it slips past the blade. It moves when
// the blade is in: tissue that moves over the blade's line from ahead, where the blade has not entered yet, is not cut. Tissue that
// sways back over the cut may be cut off a second time.
TEST(VertexMover, AThroughCutSeparatesAMovingBody) {
  constexpr std::uint64_t kSeed = 11;
  constexpr int kIn = 20;
  Random random(kSeed);
  int with_crumbs = 0;
  for (int round = 0; round < 60; ++round) {
    CutSession session(body(), config());
    const double y = random.uniform(0.02, 0.04), phase = random.uniform(0, 6), rate = random.uniform(0, 0.15);
    for (int i = 0; i <= 60; ++i) {
      if (round > 0) session.deform(swayed(session, phase + rate * std::max(i - kIn, 0)));
      if (i == 0) run_all(session);
      session.push(0, at(1 + 8 * i, {-0.04 + 0.17 * i / 60, y + 0.0002 * i, 0}));
      run_all(session);
    }
    session.end_stroke(0);
    run_all(session);
    std::uint32_t count = 0;
    const auto pieces = label_pieces(session.mesh(), &count);
    std::vector<std::uint32_t> sizes(count, 0);
    for (const std::uint32_t piece : pieces) {
      if (piece != kNone) ++sizes[piece];
    }
    ASSERT_GE(count, 2u) << "seed " << kSeed << ", round " << round;
    // Two bodies, and crumbs at most.
    std::ranges::sort(sizes, std::greater<>());
    EXPECT_GE(20 * (sizes[0] + sizes[1]), 19 * session.mesh().live_tets());
    with_crumbs += count > 2;
    EXPECT_EQ(validate(session.mesh()), "");
  }
  EXPECT_LE(with_crumbs, 6);
}

// A blade that stands in moving tissue cuts nothing and holds what it is in, from the second step on; when it leaves, that is free.
TEST(VertexMover, TissueClingsToABladeThatStands) {
  CutSession session(body(), config());
  for (int i = 0; i <= 20; ++i) session.push(0, at(1 + 8 * i, {-0.01 + 0.05 * i / 20, 0.03, 0}));
  run_all(session);
  ASSERT_TRUE(session.in_stroke(0));
  const std::uint32_t faces = measure(session.mesh()).cut_faces;
  ASSERT_GT(faces, 10u);
  const auto drift = [](VertexId, const Vec3& p) { return p + Vec3{0, 1e-4, 0}; };
  EXPECT_TRUE(deform(session, all(session, drift)).deformation.held.empty());
  std::vector<VertexId> held;
  for (int i = 1; i <= 30; ++i) {
    session.push(0, at(1 + 8 * (20 + i), {0.04, 0.03, 0}));
    const Delta delta = deform(session, all(session, drift));
    EXPECT_TRUE(i == 1 || delta.deformation.held == held) << i;
    held = delta.deformation.held;
    ASSERT_GT(held.size(), 10u);
    ASSERT_LT(held.size(), session.mesh().vertex_slots() / 2);
  }
  EXPECT_EQ(measure(session.mesh()).cut_faces, faces);
  EXPECT_EQ(validate(session.mesh()), "");
  session.end_stroke(0);
  run_all(session);
  EXPECT_TRUE(deform(session, all(session, drift)).deformation.held.empty());
}

// A blade that has left the body by so little that its last lines are not cut yet goes along with the body as that goes, not as the simulation wanted it to.
TEST(VertexMover, AStepThatIsRefusedMovesNoBlade) {
  for (const int last : {55, 60, 65}) {
    std::uint32_t faces[2];
    for (const bool refused : {false, true}) {
      CutSession session(body(), config());
      for (int i = 0; i <= 75; ++i) {
        session.push(0, at(1 + 8 * i, {-0.02 + 0.12 * i / 50, 0.03, 0}));
        run_all(session);
        if (!refused || i != last) continue;
        // Where the body does not go, for some of its vertices are not named: the blade would come from there back through all of it.
        std::vector<VertexId> ids;
        std::vector<Vec3> places;
        for (VertexId v = 0; v < session.mesh().vertex_slots(); ++v) {
          if (v % 10 == 0) continue;
          ids.push_back(v);
          places.push_back(session.mesh().position(v) + Vec3{-0.3, 0.02, 0});
        }
        const Delta delta = deform(session, some(session.revision(), ids, places));
        EXPECT_GT(delta.deformation.held.size(), session.mesh().vertex_slots() / 2);
      }
      session.end_stroke(0);
      run_all(session);
      EXPECT_EQ(validate(session.mesh()), "");
      faces[refused ? 1 : 0] = measure(session.mesh()).cut_faces;
    }
    EXPECT_EQ(faces[0], faces[1]) << last;
  }
}

// While the blade cuts, what it is in goes along with a body that drifts, and is cut as at rest.
TEST(VertexMover, TissueGoesAlongWhileABladeCuts) {
  CutReport at_rest;
  for (const bool moves : {false, true}) {
    CutSession session(body(), config());
    Vec3 drift{};
    for (int i = 0; i <= 60; ++i) {
      session.push(0, at(1 + 8 * i, Vec3{-0.01 + 0.1 * i / 60, 0.03, 0} + drift));
      run_all(session);
      if (!moves) continue;
      drift += Vec3{2e-4, 1e-3, 0};
      const Delta delta = deform(session, all(session, [](VertexId, const Vec3& p) {
                                   return p + Vec3{2e-4, 1e-3, 0};
                                 }));
      EXPECT_TRUE(delta.deformation.held.empty()) << i;
    }
    session.end_stroke(0);
    run_all(session);
    EXPECT_EQ(validate(session.mesh()), "");
    const CutReport report = measure(session.mesh());
    if (!moves) at_rest = report;
    EXPECT_EQ(report.cut_faces, at_rest.cut_faces);
    EXPECT_EQ(report.tets, at_rest.tets);
    EXPECT_NEAR(report.min_dihedral_deg, at_rest.min_dihedral_deg, 1e-6);
  }
}

// The policy `croll` turns tetrahedra inside out: those hold nothing back.
TEST(VertexMover, WhatIsInsideOutHoldsNothingBack) {
  CutConfig croll = config();
  croll.policy = Policy::kCroll;
  CutSession session(body(), croll);
  for (int i = 0; i <= 100; ++i)
    session.push(0, at(1 + 8 * i, {-0.02 + 0.12 * i / 100, 0.02 + 0.02 * std::sin(0.1 * i), 0}, i < 100));
  run_all(session);
  EXPECT_NE(validate(session.mesh()), "");
  for (int i = 0; i < 10; ++i) {
    const Delta delta = deform(session, all(session, [](VertexId, const Vec3& p) {
                                 return p + Vec3{1e-3, 5e-4, 0};
                               }));
    EXPECT_TRUE(delta.deformation.held.empty()) << i << ": " << delta.deformation.held.size();
  }
}

// What was swept goes along in portions, however much it is.
TEST(VertexMover, WhatWasSweptIsTakenAlongInPortions) {
  std::uint64_t hash = 0;
  for (const std::int64_t units : {INT64_MAX, std::int64_t{200}}) {
    CutSession session(body(), config());
    // Across the body and back, a little farther on each time, in the air as well.
    for (int i = 0; i < 2000; ++i)
      session.push(
          0, at(1 + 8 * i, {0.04 + 0.06 * std::sin(0.2 * i), 0.02 + 1e-5 * i, 0.02 * std::cos(0.31 * i)},
                i < 1999));
    run_all(session);
    deform(session, all(session, [](VertexId, const Vec3& p) { return p + Vec3{1e-4, 0, 0}; }));
    // One vertex moves: nearly all of the work is for what was swept.
    session.deform(some(session.revision(), {0}, {session.mesh().position(0) - Vec3{1e-4, 0, 0}}));
    int portions = 0;
    Delta delta;
    for (CutSession::Progress progress = CutSession::Progress::kSpent;
         progress == CutSession::Progress::kSpent; ++portions) {
      WorkBudget budget{units};
      progress = session.advance(budget, delta);
    }
    EXPECT_EQ(delta.moved.size(), 1u);
    EXPECT_EQ(portions > 50, units == 200) << portions;
    if (units == INT64_MAX) hash = session.mesh().state_hash();
    EXPECT_EQ(session.mesh().state_hash(), hash);
  }
}

// In a body that is deformed by one matrix all over, rest positions follow from places by its inverse, whatever a cut
// has moved and made.
TEST(VertexMover, RestPositionsAreThoseOfTheMaterial) {
  const auto deformed = [](const Vec3& p) {
    return Vec3{1.1 * p.x + 0.3 * p.y + 1, p.y + 0.2 * p.z, 0.9 * p.z - 0.1 * p.x};
  };
  CutSession session(body(), config());
  for (int i = 1; i <= 10; ++i) {  // in steps, so that none inverts anything
    deform(session, all(session, [&](VertexId v, const Vec3&) {
             const Vec3 rest = session.mesh().rest_position(v);
             return lerp(rest, deformed(rest), 0.1 * i);
           }));
  }
  for (int i = 0; i <= 80; ++i) {
    const double s = i / 80.0;
    session.push(0, at(1 + 8 * i, deformed({-0.02 + 0.12 * s, 0.03 + 0.01 * std::sin(9 * s), 0}), i < 80));
  }
  std::size_t moved = 0, added = 0;
  for (const Delta& delta : run_all(session)) {
    ASSERT_EQ(delta.moved_rest.size(), delta.moved.size());
    ASSERT_EQ(delta.added_rest.size(), delta.added_positions.size());
    moved += delta.moved.size();
    added += delta.added_positions.size();
    for (std::size_t i = 0; i < delta.moved.size(); ++i)
      EXPECT_LT(distance(deformed(delta.moved_rest[i]), delta.moved_positions[i]), 1e-12);
    for (std::size_t i = 0; i < delta.added_positions.size(); ++i)
      EXPECT_LT(distance(deformed(delta.added_rest[i]), delta.added_positions[i]), 1e-12);
  }
  EXPECT_GT(moved, 30u);
  EXPECT_GT(added, 30u);
  for (VertexId v = 0; v < session.mesh().vertex_slots(); ++v) {
    EXPECT_LT(distance(deformed(session.mesh().rest_position(v)), session.mesh().position(v)), 1e-12) << v;
  }
}

// ---- The grid

// A body that has gone far away, out of the grid that it was loaded with, is found where it is.
TEST(VertexMover, ABodyIsFoundWhereItWent) {
  constexpr std::uint64_t kSeed = 3;
  Random random(kSeed);
  CutSession session(body(), config());
  const Vec3 step = 0.004 * random.direction();
  Vec3 gone{};
  for (int i = 0; i < 200; ++i) {
    gone += step;
    deform(session, all(session, [&](VertexId v, const Vec3&) {
             return sway(session.mesh().rest_position(v), 0.05 * i) + gone;
           }));
    if (i % 20 != 19) continue;
    const TetMesh& mesh = session.mesh();
    int inside = 0;
    for (int k = 0; k < 50; ++k) {
      const auto t = static_cast<TetId>(random.below(mesh.tet_slots()));
      const TetId found = session.boundary().locate(mesh, mesh.barycentre(t));
      inside += found == t;
    }
    EXPECT_EQ(inside, 50) << "seed " << kSeed << ", step " << i;
    // Every boundary tetrahedron is listed in the cells of each of its corners.
    for (TetId t = 0; t < mesh.tet_slots(); ++t) {
      if (mesh.boundary_mask(t) == 0) continue;
      for (const VertexId v : mesh.vertices(t)) {
        bool listed = false;
        session.boundary().visit_box(mesh.position(v), mesh.position(v), [&](TetId n) { listed |= n == t; });
        ASSERT_TRUE(listed) << "tetrahedron " << t << ", step " << i;
      }
    }
  }
  EXPECT_LT(session.boundary().entries(), 400'000u);
  for (int i = 0; i <= 50; ++i) {
    session.push(0, at(1 + 8 * i, gone + Vec3{-0.04 + 0.17 * i / 50, 0.03, 0}, i < 50));
  }
  run_all(session);
  EXPECT_EQ(measure(session.mesh()).pieces, 2u);
}

// A few vertices that go far, so that stars are looked at and not all tetrahedra: the grid follows them as well, and enters each
// boundary tetrahedron once a step however many of its vertices have left their places.
TEST(VertexMover, APartThatMovesIsFoundWhereItWent) {
  CutSession session(body(), config());
  const TetMesh& mesh = session.mesh();
  std::vector<VertexId> corner;
  for (VertexId v = 0; v < mesh.vertex_slots(); ++v)
    if (length(mesh.position(v) - mesh.position(0)) < 2.1 * kCell) corner.push_back(v);
  ASSERT_LT(16 * corner.size(), 4 * mesh.tet_slots());
  std::vector<TetId> touched;
  for (TetId t = 0; t < mesh.tet_slots(); ++t) {
    const auto& v = mesh.vertices(t);
    const bool moves = std::any_of(
        v.begin(), v.end(), [&](VertexId w) { return std::binary_search(corner.begin(), corner.end(), w); });
    if (moves && mesh.boundary_mask(t) != 0) touched.push_back(t);
  }
  for (int i = 0; i < 12; ++i) {
    std::vector<Vec3> places;
    for (const VertexId v : corner) {
      const Vec3& rest = mesh.rest_position(v);
      const double share = 1 - length(rest - mesh.rest_position(0)) / (2.2 * kCell);
      places.push_back(rest + 0.1 * kCell * i * share * Vec3{-1, -1, -1});
    }
    const std::size_t before = session.boundary().entries();
    const bool anchored = session.boundary().anchored();
    const Delta delta = deform(session, some(session.revision(), corner, places));
    EXPECT_TRUE(delta.deformation.held.empty()) << i;
    if (anchored) {
      EXPECT_LE(session.boundary().entries(), before + 8 * touched.size()) << i;
    }
    for (const TetId t : touched) {
      for (const VertexId v : mesh.vertices(t)) {
        bool listed = false;
        session.boundary().visit_box(mesh.position(v), mesh.position(v), [&](TetId n) { listed |= n == t; });
        ASSERT_TRUE(listed) << "tetrahedron " << t << ", step " << i;
      }
    }
  }
}

// A new grid has each vertex's anchor where the step takes it, whether it moves or not: the tetrahedra are entered there.
TEST(GridFollower, ANewGridHasItsAnchorsWhereTheVerticesGo) {
  const TetMesh mesh(body());
  CutWorkspace workspace(mesh);
  GridFollower follower(mesh, workspace);
  std::vector<VertexId> moved;
  std::vector<Vec3> positions, targets;
  for (VertexId v = 0; v < mesh.vertex_slots(); ++v) {
    targets.push_back(mesh.position(v));
    if (v % 3 == 0) continue;
    targets.back() += Vec3{3 * kCell, -2 * kCell, kCell};
    moved.push_back(v);
    positions.push_back(targets.back());
  }
  const std::vector<TetId> boundary;  // not needed for a new grid
  const GridFollower::Step step{moved, targets, boundary};
  follower.begin();
  Vec3 low = positions[0], high = low;
  for (const Vec3& p : positions) extend(p, low, high);
  follower.look_at(moved, positions, low, high);
  follower.settle(step);
  WorkBudget budget{20};
  EXPECT_FALSE(follower.advance(step, budget)) << "it is more work than that";
  budget = WorkBudget::unlimited();
  ASSERT_TRUE(follower.advance(step, budget));
  EXPECT_FALSE(workspace.grid.anchored()) << "the old one stays in use until then";
  follower.commit();
  BoundaryGrid& grid = workspace.grid;
  ASSERT_TRUE(grid.anchored());
  for (VertexId v = 0; v < mesh.vertex_slots(); ++v) {
    EXPECT_FALSE(grid.leaves_anchor(mesh, v, targets[v] + Vec3{0, 0.09 * grid.cell(), 0})) << v;
    EXPECT_TRUE(grid.leaves_anchor(mesh, v, targets[v] + Vec3{0, 0.11 * grid.cell(), 0})) << v;
  }
}

}  // namespace
}  // namespace incise::core
